// An instrument that is not there: how it stands, what it is told, what it has kept. Tests change it as they like.
import { ENDS, others, reposition } from "./script.mjs";

const SCALE = { "10x": 1.0, "20x": 0.5, "40x": 0.25 };
const STEP_MS = 110;
/** So long one can look at a step of a way back. */
const LOOK_MS = 700;
const HOLD_MS = 300;

export class Refusal extends Error {
  constructor(status, code, message, kind = "refusal") {
    super(message);
    Object.assign(this, { status, code, kind });
  }
}

export class World {
  constructor(more = {}) {
    Object.assign(this, {
      me: { user: "anna", role: "admin", here: true, may_move: true },
      loggedIn: true,
      name: "bench 3",
      simulated: true,
      left: null,
      at: { x_um: 0, y_um: 0, z_um: 0, rz_deg: 0 },
      objective: "40x",
      exposure_ms: 10,
      light: 0.5,
      owner: null,
      asked_by: null,
      slide: null,
      trouble: null,
      cameraTrouble: null,
      homed: true,
      demo: "in",
      /** How the slide lies beside where it lay, um and degrees. */
      offset: { x: 0, y: 0, deg: 0 },
      /** How the next way back ends. */
      verdict: "arrived",
      question: null,
      jobs: [],
      targets: [],
      runs: [],
      records: [],
      revision: 0,
      /** Whether frames come, whether anything is said at all, whether a lasting connection may be made. */
      frames: true,
      silent: false,
      blocked: false,
      down: false,
      /** What browsers said, the oldest first. */
      said: [],
      asked: [],
      began: performance.now(),
      ...more,
    });
  }

  get time_s() {
    return (performance.now() - this.began) / 1000;
  }

  get job() {
    return this.jobs.find((job) => job.state.state !== "ended");
  }

  instrument() {
    const objectives = Object.entries(SCALE).map(([id, um_per_px]) => ({ id, magnification: parseInt(id), na: 0.65, immersion: "air", um_per_px, calibrated: true }));
    const axes = ["x", "y", "z", "rz"].map((axis) => ({ axis, unit: axis === "rz" ? "deg" : "um", least: -8000, most: 8000 }));
    return { name: this.name, simulated: this.simulated, version: "0.1.0", objectives, axes, camera: { name: "made up", width: 320, height: 240 }, nearer_z: 1, has_light: true, demo: this.demo !== null, left: this.left };
  }

  state() {
    const age_s = this.frames ? 0.03 : 9;
    return {
      time_s: this.time_s, at: { ...this.at }, at_age_s: 0.05, homed: this.homed, moving: Boolean(this.job), trouble: this.trouble, objective: this.objective, exposure_ms: this.exposure_ms, light: this.light,
      owner: this.owner, mine: this.owner === this.me.user, asked_by: this.asked_by, there: this.there ?? [this.me.user], may_not_start: this.whyNot(), slide: this.slide, elsewhere_s: null, revision: this.revision,
      jobs: this.jobs.slice(0, 5).map(({ id, kind, owner, about, state }) => ({ id, kind, owner, about, state })),
      questions: this.question ? [this.question] : [],
      camera: { age_s, trouble: this.cameraTrouble },
      demo: this.demo === null ? null : { slide: this.demo },
    };
  }

  frame(seq) {
    const um_per_px = SCALE[this.objective];
    return { seq, time_s: this.time_s, age_ms: 8, width: 320, height: 240, full_width: 320, full_height: 240, um_per_px, objective: this.objective, at: { ...this.at }, role: "live", sharpness: 100 + 20 * Math.sin(seq / 9), saturated: 0.001, dark: 0 };
  }

  where() {
    return { x_um: this.at.x_um + this.offset.x, y_um: this.at.y_um + this.offset.y, deg: this.at.rz_deg + this.offset.deg, umPerPx: SCALE[this.objective], bright: this.exposure_ms / 10 };
  }

  /** Why whoever looks could start nothing now. */
  whyNot() {
    const refusal = (code, message) => ({ code, kind: "refusal", message });
    if (this.me.role === "viewer") return refusal("role", `${this.me.user} may look and stop; this needs the role operator`);
    if (!this.me.may_move) return refusal("not_here", "from another machine nothing may be moved: allow it at the microscope first");
    if (this.job) return refusal("busy", `${this.job.kind} by ${this.job.owner} is under way: wait, or stop it`);
    if (this.owner && this.owner !== this.me.user) return refusal("held", `${this.owner} drives this instrument: ask for it, or wait`);
    if (this.left) return refusal("unfinished", `${this.left}. Resume it or abandon it first`);
    return null;
  }

  may(what) {
    if (this.me.role === "viewer" || !this.me.may_move) throw new Refusal(403, "role", `a viewer may not ${what}: ask an operator`);
    if (this.owner && this.owner !== this.me.user) throw new Refusal(409, "held", `${this.owner} drives this instrument: ask for it`);
  }

  start(body) {
    this.may("move");
    if (this.job) throw new Refusal(409, "busy", `${this.job.kind} is under way: wait for its end, or stop it`);
    this.owner = this.me.user;
    const job = { id: this.jobs.length + 1, kind: body.job, owner: this.me.user, about: body.name ?? body.target ?? null, state: { state: "running" }, answer: null, error: null, run: null, body };
    this.jobs.unshift(job);
    const events = body.job === "reposition" ? reposition(this.verdict) : others(body.job);
    void this.work(job, events);
    return job;
  }

  async work(job, events) {
    for (const event of events) {
      await new Promise((done) => setTimeout(done, STEP_MS));
      while (job.state.state === "paused") await new Promise((done) => setTimeout(done, 20));
      if (job.state.state === "ended") return;
      const { x_um, y_um, rz_deg } = this.at;
      const seenFrom = event.event === "iteration" && { stage: { x: x_um * 1e-6, y: y_um * 1e-6, z: 0, rz: (rz_deg * Math.PI) / 180 } };
      this.tell(job.id, { ...event, ...seenFrom });
      if (event.event === "phase_started") this.objective = event.objective;
      if (event.event !== "iteration") continue;
      await new Promise((done) => setTimeout(done, LOOK_MS));
      if (!event.converged) this.at = { ...this.at, x_um: this.at.x_um + 3 };
    }
    if (job.kind === "jog") return;
    await new Promise((done) => setTimeout(done, STEP_MS));
    if (job.state.state === "ended") return;
    this.end(job);
  }

  tell(job, event) {
    this.records.push({ number: this.records.length, time_s: this.time_s, job, from: "procedure", ...event });
  }

  end(job) {
    const { body } = job;
    job.state = { state: "ended", how: "answered" };
    if (job.kind === "reposition") this.wentBack(job, body);
    else if (job.kind === "save_target") this.saved(job, body);
    else if (job.kind === "objective") this.objective = body.objective;
    else if (job.kind === "focus") job.answer = { result: { z_um: 2.1, sigma_um: 0.16 } };
    else if (job.kind === "move" && Math.abs(body.to?.x_um ?? 0) > 8000) {
      job.state = { state: "ended", how: "failed" };
      job.error = { code: "outside", kind: "refusal", message: `x to ${body.to.x_um}.0 um is beyond its limit of 8000.0 um; nothing moved` };
    } else if (job.kind === "move") for (const [axis, by] of Object.entries(body.by ?? {})) this.at[axis] += by;
    else if (job.kind === "centre") {
      this.at.x_um += (body.x - 0.5) * 320 * SCALE[this.objective];
      this.at.y_um += (body.y - 0.5) * 240 * SCALE[this.objective];
    }
    this.revision += 1;
  }

  wentBack(job, body) {
    if (this.verdict === "arrived") this.offset = { x: -this.at.x_um, y: -this.at.y_um, deg: 0 };
    job.answer = { verdict: this.verdict, ...ENDS[this.verdict], moves: 26, frames: 20, seconds: 10.1, magnifications: [], remarks: [] };
    job.run = `${String(this.runs.length + 1).padStart(6, "0")}_reposition`;
    const { message } = ENDS[this.verdict];
    this.runs.unshift({ id: job.run, job: "reposition", began: new Date().toISOString(), user: job.owner, slide: this.slide, target: body.target, verdict: this.verdict, message, seconds: 10.1, ended: true, report: true });
  }

  saved(job, body) {
    const quality = { word: "good", text: "can be told from its surroundings: found in 24 of 24 with 10x, 8 of 8 with 40x of the views made of it", chance: 0.98 };
    const { instrument, slide, objective } = { instrument: this.name, slide: this.slide, objective: this.objective };
    this.targets.unshift({ name: body.name, saved: new Date().toISOString(), instrument, slide, note: body.note ?? "", objective, um_per_px: SCALE[objective], width: 320, height: 240, features: 812, quality, at: { ...this.at }, where: this.where() });
    job.answer = { features: 812, quality };
  }

  stop() {
    for (const job of this.jobs) {
      if (job.state.state === "ended") continue;
      job.state = { state: "ended", how: "stopped" };
      job.error = { code: "stopped", kind: "interruption", message: "stopped; nothing moves" };
    }
    this.question = null;
  }

  jog({ x = 0, y = 0, z = 0, rz = 0 }) {
    let job = this.job;
    if (job && job.kind !== "jog") throw new Refusal(409, "busy", `${job.kind} is under way`);
    job ??= this.start({ job: "jog" });
    this.at = { x_um: this.at.x_um + 2 * x, y_um: this.at.y_um + 2 * y, z_um: this.at.z_um + z, rz_deg: this.at.rz_deg + 0.2 * rz };
    clearTimeout(this.hold);
    this.hold = setTimeout(() => this.jogEnd(), HOLD_MS);
  }

  jogEnd() {
    clearTimeout(this.hold);
    if (this.job?.kind === "jog") this.end(this.job);
  }
}

// What a job does now and why; and when it has ended, what it came to, the verdict first.

import { useState } from "preact/hooks";
import { useDrives } from "../act.ts";
import { address, attempt } from "../api.ts";
import { turnDeg } from "../geometry.ts";
import { duration, fixed, length, spaced, withUnits } from "../format.ts";
import { set, use } from "../store.ts";
import type { Job, WholeJob } from "../types.ts";
import { words } from "../words.ts";
import { Compare } from "./compare.tsx";
import { Steps } from "./steps.tsx";

const BY_HAND = new Set(["move", "centre", "objective", "home", "jog"]);

export function RunCard() {
  const job = use((m) => m.state?.jobs.find((j) => j.state.state !== "ended" && !BY_HAND.has(j.kind)) ?? null);
  const last = use((m) => m.last);
  if (job) return <UnderWay job={job} />;
  if (last) return <Came last={last} />;
  return null;
}

function what(job: Job): string {
  const doing = words.jobs[job.kind] ?? spaced(job.kind);
  return job.about ? `${doing} ${job.about}` : doing;
}

function UnderWay({ job }: { job: Job }) {
  const trace = use((m) => m.trace);
  const may = use((m) => m.me?.may_move ?? false);
  const drives = useDrives();
  const isOf = trace.job === job.id;
  const step = isOf ? trace.steps.at(-1) : undefined;
  const paused = job.state.state === "paused";
  return (
    <section class="card run" aria-live="polite">
      <h2>
        {what(job)} <span class="soft">by {job.owner}</span>
      </h2>
      <p>
        {paused ? (job.state.why === "lease_lost" ? "waits: whoever drove is gone" : "waits") : isOf && trace.outcome ? words.keeping : isOf && trace.now ? trace.now : words.begins}
        {isOf && trace.views > 0 && trace.steps.length === 0 && `: view ${trace.views}`}
        {isOf && trace.began_s !== null && trace.last_s !== null && <span class="soft">, {duration(trace.last_s - trace.began_s)}</span>}
      </p>
      {step && (
        <p class="big">
          {length(step.errorUm)} away, {fixed(step.errorDeg, 2)}° turned
          <span class="soft">
            {" "}
            {step.inliers} of {step.matches} {words.agree[step.by]}
          </span>
        </p>
      )}
      {job.kind === "reposition" && job.about && <Wanted name={job.about} deg={step ? -turnDeg(step.targetFromView) : 0} />}
      {isOf && <Steps steps={trace.steps} />}
      {isOf && trace.focus.length > 2 && <Sweep points={trace.focus} />}
      <div class="row">
        {may && !paused && (
          <button type="button" disabled={!drives} onClick={() => void attempt("POST", `jobs/${job.id}/pause`)}>
            Pause
          </button>
        )}
        {may && paused && (
          <button type="button" class="primary" disabled={!drives} onClick={() => void attempt("POST", `jobs/${job.id}/resume`)}>
            Go on
          </button>
        )}
      </div>
    </section>
  );
}

/** The saved view, turned as the specimen lies now. */
function Wanted({ name, deg }: { name: string; deg: number }) {
  return (
    <figure class="wanted">
      <img alt={`the saved view ${name}`} src={address(`targets/${encodeURIComponent(name)}/thumb.jpg`)} style={{ rotate: `${deg}deg` }} />
      <figcaption>what is looked for{Math.abs(deg) >= 0.5 && `, turned by ${fixed(Math.abs(deg), 1)}° as it lies now`}</figcaption>
    </figure>
  );
}

/** A focus sweep: sharpness over height. */
function Sweep({ points }: { points: { z: number; sharpness: number }[] }) {
  const z = points.map((p) => p.z);
  const [least, most] = [Math.min(...z), Math.max(...z)];
  const top = Math.max(1e-9, ...points.map((p) => p.sharpness));
  const width = Math.max(1e-9, most - least);
  return (
    <svg class="sweep" viewBox="0 0 100 40" role="img" aria-label="sharpness over the height of the stage">
      {points.map((p, k) => (
        <circle key={k} cx={3 + (94 * (p.z - least)) / width} cy={37 - (34 * p.sharpness) / top} r="1.5" />
      ))}
    </svg>
  );
}

function Came({ last }: { last: WholeJob }) {
  const [compare, setCompare] = useState(false);
  const close = () => set({ last: null });
  const answer = last.answer ?? {};
  const verdict = answer.verdict as string | undefined;
  const um = answer.estimated_error_um as number | null | undefined;
  const tone = last.error ? "bad" : verdict === undefined || verdict === "arrived" ? "good" : "unsure";
  const title = last.error
    ? last.error.code === "stopped"
      ? "Stopped"
      : "It did not work"
    : verdict
      ? (words.verdicts[verdict] ?? spaced(verdict))
      : "Done";
  return (
    <section class={`card run came ${tone}`} aria-live="polite">
      <h2 class="verdict">
        {title}
        <span class="soft">
          {" "}
          {what(last)}
        </span>
      </h2>
      <p class={verdict === "arrived" ? "big" : ""}>{withUnits(last.error?.message ?? (answer.message as string | undefined) ?? told(last))}</p>
      {verdict === "arrived" && um != null && <p class="soft">With the doubt of the measurement {length(um)} at the most.</p>}
      {verdict && words.doubt[verdict] && <p class="soft">{words.doubt[verdict]}</p>}
      {typeof answer.moves === "number" && (
        <p class="soft">
          {answer.moves as number} moves, {answer.frames as number} images, {duration(answer.seconds as number)}
        </p>
      )}
      {Array.isArray(answer.warnings) && (answer.warnings as string[]).map((w) => <p class="bad">{w}</p>)}
      <div class="row">
        {verdict === "arrived" && last.about && (
          <button type="button" aria-pressed={compare} onClick={() => setCompare(!compare)}>
            Before and after
          </button>
        )}
        {last.run && last.kind !== "save_target" && (
          <a class="button" target="_blank" rel="noreferrer" href={address(`runs/${encodeURIComponent(last.run)}/report.html`)}>
            Report
          </a>
        )}
        <button type="button" onClick={close}>
          Close
        </button>
      </div>
      {compare && last.about && <Compare name={last.about} />}
    </section>
  );
}

/** What came of jobs that have no verdict. */
function told(last: WholeJob): string {
  const answer = last.answer ?? {};
  if (last.kind === "save_target") {
    const quality = answer.quality as { chance: number } | null | undefined;
    const chance = quality ? ` It is expected to be found again in ${fixed(100 * quality.chance, 0)} % of the cases.` : "";
    return `Saved with ${answer.features} features.${chance}`;
  }
  if (last.kind === "focus") {
    const result = answer.result as { z_um: number | null; sigma_um: number | null } | undefined;
    if (result?.z_um != null) return `In focus at z = ${fixed(result.z_um, 2)} ± ${fixed(result.sigma_um ?? 0, 2)} µm.`;
  }
  if (last.kind === "calibrate") {
    const made = (answer.made as { calibration: { objective: string } }[] | undefined) ?? [];
    return `Calibrated: ${made.map((m) => m.calibration.objective).join(", ")}.`;
  }
  if (last.kind === "check") {
    type Checked = { told?: { objective: string; verdict: string }; unclear?: { objective: string; message: string } };
    const all = (answer.checked as Checked[] | undefined) ?? [];
    return all.map((c) => (c.told ? `${c.told.objective} is ${spaced(c.told.verdict)}.` : `${c.unclear?.objective}: ${c.unclear?.message}.`)).join(" ");
  }
  if (last.kind === "doctor") {
    const all = (answer.findings as { trouble: unknown }[] | undefined) ?? [];
    const wrong = all.filter((f) => f.trouble !== null && f.trouble !== undefined);
    return wrong.length === 0 ? `All ${all.length} things that were looked at are well.` : `${wrong.length} of ${all.length} things are not well: scopeservo doctor tells which.`;
  }
  return "";
}

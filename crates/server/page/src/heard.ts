// What the server tells, taken into the model.

import { ask } from "./api.ts";
import { follow } from "./run/trace.ts";
import { get, set } from "./store.ts";
import type { EventRecord, Instrument, Job, State, Target, WholeJob } from "./types.ts";

/** Jobs whose end is worth a look at their answer. */
const TELLING = new Set(["reposition", "calibrate", "focus", "check", "doctor", "save_target", "objective", "home", "move", "centre", "jog", "resume"]);

/** So many of the saved views are at hand on every page. */
const NEWEST = 50;

/** The last job whose answer was asked for. */
let asked: number | null = null;

export function onState(state: State): void {
  const before = get().state;
  set({ state, stateAt: performance.now(), questions: state.questions });
  if (before && before.revision !== state.revision) void refresh();
  const ended = state.jobs.filter((job) => job.state.state === "ended" && TELLING.has(job.kind));
  const newest = ended[0];
  const was = before?.jobs.find((job) => job.id === newest?.id);
  if (newest && newest.id !== asked && (was?.state.state !== "ended" || before === null)) {
    asked = newest.id;
    void cameOf(newest, before === null);
  }
}

async function cameOf(job: Job, isOld: boolean): Promise<void> {
  const whole = await ask<WholeJob>("GET", `jobs/${job.id}`).catch(() => null);
  if (!whole) return;
  const isMotion = ["move", "centre", "jog", "objective", "home"].includes(job.kind);
  if (!isMotion) {
    set({ last: whole });
    void refresh();
  }
  if (whole.error && !isOld && (isMotion || whole.error.code !== "stopped")) set({ refused: whole.error.code === "stopped" ? null : whole.error });
}

export function onEvent(record: EventRecord): void {
  const trace = follow(get().trace, record);
  if (trace !== get().trace) set({ trace });
}

/** What is kept, and what the instrument is: asked again when a job has ended. */
export async function refresh(): Promise<void> {
  const [targets, instrument] = await Promise.all([
    ask<Target[]>("GET", `targets?limit=${NEWEST}`).catch(() => get().targets),
    ask<Instrument>("GET", "instrument").catch(() => get().instrument),
  ]);
  const wanted = get().chosen;
  let found = targets.find((t) => t.name === wanted) ?? null;
  // Only of more than are at hand it may be another one; else it is not kept, or not yet.
  if (wanted !== null && !found && targets.length >= NEWEST) found = await ask<Target>("GET", `targets/${encodeURIComponent(wanted)}`).catch(() => null);
  // Somebody may have chosen another meanwhile.
  const now = get().chosen;
  const is = now !== wanted ? {} : { chosen: found?.name ?? targets[0]?.name ?? null, chosenTarget: found };
  set({ targets, instrument, ...is });
}

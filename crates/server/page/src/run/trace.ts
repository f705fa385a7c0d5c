// What a run has shown so far: made of its events, one after the other.

import type { Affine, EventRecord, Place } from "../types.ts";

export type LocatedBy = "features" | "arrangement" | "correlation";

export type Step = {
  objective: string;
  iteration: number;
  sequence: number;
  errorUm: number;
  errorDeg: number;
  sigmaPx: number;
  targetFromView: Affine;
  /** By what it was located; older logs do not tell, and those were by features. */
  by: LocatedBy;
  inliers: number;
  matches: number;
  pairs: [number, number, number, number][];
  converged: boolean;
  /** What the move before was to lead to: the error then, um, and its standard deviation; null where none was made with this objective. */
  promised: { um: [number, number]; sigmaUm: number } | null;
  /** Where the stage stood; null where an older log does not tell. */
  seenFrom: Place | null;
};

export type Trace = {
  job: number | null;
  /** What it does now, for people. */
  now: string;
  objectives: string[];
  /** The objective of the saved view. */
  wanted: string | null;
  steps: Step[];
  lost: number;
  views: number;
  focus: { z: number; sharpness: number }[];
  /** The verdict with its sentence, when it has come. */
  outcome: Record<string, unknown> | null;
  began_s: number | null;
  last_s: number | null;
};

export const EMPTY: Trace = {
  job: null,
  now: "",
  objectives: [],
  wanted: null,
  steps: [],
  lost: 0,
  views: 0,
  focus: [],
  outcome: null,
  began_s: null,
  last_s: null,
};

const PHASES: Record<string, string> = {
  switch: "changing the objective to",
  focus: "focusing with",
  identify: "looking whether it is",
  calibrate: "measuring how the camera sees the stage with",
  servo: "looking for the saved view with",
};

type Sweep = { end: string; um_per_s: number; frames: number; counted: number; near_um: number | null };

/** A coarse scan in motion, and why it was none. */
function swept(sweep: Sweep): string {
  const way = `swept at ${Math.round(sweep.um_per_s)} µm/s, ${sweep.counted} of ${sweep.frames} images count`;
  switch (sweep.end) {
    case "found":
      return sweep.near_um === null ? way : `${way}: looking closer at ${sweep.near_um.toFixed(0)} µm`;
    case "no_faster":
      return "a sweep in motion would save no time: looking at rest";
    case "refused":
      return "the stage does not move as slowly as it is told: looking at rest";
    case "unknown":
      return `${way}, too few: looking at rest`;
    default:
      return `${way}, no peak: looking at rest`;
  }
}

/** So many steps are remembered. */
const STEPS = 200;

type Pose = { x?: number; y?: number; rz?: number };

/** A pose in m and rad, as people read it. */
function place(pose: Pose | undefined): Place | null {
  if (!pose) return null;
  const by = (v: number | undefined, unit: number) => (v === undefined ? undefined : v * unit);
  return { x_um: by(pose.x, 1e6), y_um: by(pose.y, 1e6), rz_deg: by(pose.rz, 180 / Math.PI) };
}

type Motion = { t_m: [number, number]; theta_rad: number };

type Promised = { error: Motion; sigma_m: number };

function promised(told: Promised | null | undefined): Step["promised"] {
  if (!told) return null;
  const [x, y] = told.error.t_m;
  return { um: [1e6 * x, 1e6 * y], sigmaUm: 1e6 * told.sigma_m };
}

function step(record: EventRecord): Step {
  const error = record.error as Motion;
  return {
    objective: record.objective as string,
    iteration: record.iteration as number,
    sequence: record.sequence as number,
    errorUm: 1e6 * Math.hypot(error.t_m[0], error.t_m[1]),
    errorDeg: (error.theta_rad * 180) / Math.PI,
    sigmaPx: record.sigma_px as number,
    targetFromView: record.target_from_view as Affine,
    by: (record.by as LocatedBy | undefined) ?? "features",
    inliers: record.inliers as number,
    matches: record.matches as number,
    pairs: record.pairs as Step["pairs"],
    converged: record.converged as boolean,
    promised: promised(record.promised as Promised | null | undefined),
    seenFrom: place(record.stage as Pose | undefined),
  };
}

/** The trace after one more event. A new job begins a new one. */
export function follow(trace: Trace, record: EventRecord): Trace {
  const of = record.job !== null && record.job !== trace.job && record.from === "procedure";
  const before: Trace = of ? { ...EMPTY, job: record.job, began_s: record.time_s } : trace;
  if (record.from !== "procedure") return trace;
  const after = { ...before, last_s: record.time_s };
  switch (record.event) {
    case "started":
      return { ...after, objectives: record.objectives as string[], wanted: (record.target_objective as string | undefined) ?? null };
    case "phase_started": {
      const phase = PHASES[record.phase as string] ?? record.phase;
      return { ...after, now: `${phase} ${record.objective}`, focus: [], views: 0 };
    }
    case "focus_sample":
      return { ...after, focus: [...after.focus, { z: record.z_um as number, sharpness: record.sharpness as number }].slice(-60) };
    case "focus_swept":
      return { ...after, now: `${after.now}; ${swept(record.sweep as Sweep)}` };
    case "calibration_view":
      return { ...after, views: (record.index as number) + 1 };
    case "iteration": {
      const seen = step(record);
      // Where another objective looks lies beside what it handed over: its promise is none for this view.
      const isHandedOver = after.steps.at(-1)?.objective !== seen.objective;
      const next = isHandedOver ? { ...seen, promised: null } : seen;
      const now = next.converged ? `${next.objective}: within the tolerance, looking once more` : `${next.objective}: going there`;
      return { ...after, now, steps: [...after.steps, next].slice(-STEPS) };
    }
    case "lost":
      return { ...after, lost: after.lost + 1, now: "the saved view is not found here" };
    case "finished":
      return { ...after, outcome: record.outcome as Record<string, unknown>, now: "" };
    default:
      return after;
  }
}

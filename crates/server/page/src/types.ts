// What the server says (docs/server.md).

export type Place = { x_um?: number; y_um?: number; z_um?: number; rx_deg?: number; ry_deg?: number; rz_deg?: number };

export type Me = { user: string; role: "viewer" | "operator" | "admin"; here: boolean; may_move: boolean };

export type Objective = { id: string; magnification: number; na: number; immersion: string; um_per_px: number; calibrated: boolean };

export type Instrument = {
  name: string;
  simulated: boolean;
  version: string;
  objectives: Objective[];
  axes: { axis: string; unit: string; least: number; most: number }[];
  camera: { name: string; width: number; height: number };
  /** Which way z goes towards the specimen, 1 or -1. */
  nearer_z: number;
  has_light: boolean;
  demo: boolean;
  left: string | null;
};

export type JobState = { state: "queued" | "running" | "paused" | "asking" | "ended"; why?: string; how?: string; message?: string };

export type Job = { id: number; kind: string; owner: string; about: string | null; state: JobState };

export type Failure = { code: string; kind: string; message: string };

export type WholeJob = Job & { answer: Record<string, unknown> | null; error: Failure | null; run: string | null };

export type Question = { id: number; text: string };

export type State = {
  time_s: number;
  at: Place | null;
  at_age_s: number;
  homed: boolean;
  moving: boolean;
  trouble: string | null;
  objective: string | null;
  exposure_ms: number | null;
  light: number | null;
  owner: string | null;
  mine: boolean;
  asked_by: string | null;
  slide: string | null;
  /** Who has the page open, or a program that listens. */
  there: string[];
  /** Why this one could start nothing now; null: they could. */
  may_not_start: Failure | null;
  jobs: Job[];
  questions: Question[];
  camera: { age_s: number | null; trouble: string | null };
  demo: { slide: "in" | "moved"; picture: string | null } | null;
  /** Counts what changed of what is kept. */
  revision: number;
  /** For so long somebody may move the instrument from elsewhere, s; null: not at all. */
  elsewhere_s: number | null;
};

export type FrameHead = {
  seq: number;
  time_s: number;
  age_ms: number;
  width: number;
  height: number;
  full_width: number;
  full_height: number;
  um_per_px: number | null;
  objective: string | null;
  at: Place | null;
  role: string;
  sharpness: number;
  saturated: number;
  dark: number;
};

export type Target = {
  /** What tells it from others, also of its name. */
  number: number;
  name: string;
  saved: string;
  instrument?: string;
  slide?: string | null;
  note?: string;
  objective?: string;
  um_per_px?: number | null;
  width?: number | null;
  height?: number | null;
  features?: number;
  quality?: { word: "good" | "fair" | "poor" | "unknown"; text: string; chance: number | null };
  at?: Place;
  damaged?: string;
  /** When it went into the bin. */
  binned?: string;
};

/** One that somebody brought to the demonstration. */
export type Picture = { name: string; um_per_px: number; size_px: [number, number]; bytes: number; user: string; brought: string; lies: boolean };

export type Run = {
  id: string;
  job: string;
  began: string;
  user: string | null;
  slide: string | null;
  target: string | null;
  verdict: string | null;
  message: string | null;
  seconds: number | null;
  ended: boolean;
  report: boolean;
  /** Whether there is a picture of the view at arrival. */
  arrival: boolean;
  pinned: boolean;
};

/** Rows of a map of pixels: a b t. */
export type Affine = [[number, number, number], [number, number, number]];

/** One thing that happened; what it has beside depends on what it is. */
export type EventRecord = { number: number; time_s: number; job: number | null; from: string; event?: string; [key: string]: unknown };

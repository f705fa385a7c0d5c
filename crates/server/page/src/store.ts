// What the page knows, in one place; parts are drawn anew when what they look at has changed.

import { useEffect, useState } from "preact/hooks";
import type { Failure, FrameHead, Instrument, Me, Question, State, Target, WholeJob } from "./types.ts";
import { EMPTY, type Trace } from "./run/trace.ts";

export type Page = "live" | "targets" | "runs" | "people";

export type Link = "opening" | "live" | "polling" | "lost";

export type Model = {
  page: Page;
  /** undefined: not asked yet; null: nobody is logged in. */
  me: Me | null | undefined;
  /** The terminal's key, where somebody is to say who is the first user. */
  claim: string | null;
  instrument: Instrument | null;
  state: State | null;
  /** When the state came, by this computer's clock, ms. */
  stateAt: number;
  link: Link;
  frame: FrameHead | null;
  frameAt: number;
  /** The last sharpnesses, the newest last. */
  sharpness: number[];
  /** The newest; the page of targets asks for others. */
  targets: Target[];
  /** The saved view that one goes back to. */
  chosen: string | null;
  /** What is known of it, where it is none of the newest. */
  chosenTarget: Target | null;
  trace: Trace;
  /** What came of the last job that was worth telling. */
  last: WholeJob | null;
  refused: Failure | null;
  help: boolean;
  saving: boolean;
  questions: Question[];
};

let model: Model = {
  page: "live",
  me: undefined,
  claim: null,
  instrument: null,
  state: null,
  stateAt: 0,
  link: "opening",
  frame: null,
  frameAt: 0,
  sharpness: [],
  targets: [],
  chosen: null,
  chosenTarget: null,
  trace: EMPTY,
  last: null,
  refused: null,
  help: false,
  saving: false,
  questions: [],
};

const ears = new Set<() => void>();

export function get(): Model {
  return model;
}

export function set(change: Partial<Model>): void {
  model = { ...model, ...change };
  for (const ear of [...ears]) ear();
}

/** What a part looks at. */
export function use<T>(look: (model: Model) => T): T {
  const [seen, show] = useState(() => look(model));
  useEffect(() => {
    const ear = () => show(() => look(model));
    ears.add(ear);
    ear();
    return () => void ears.delete(ear);
  }, []);
  return seen;
}

/** The moment, anew so many times a second: what has an age is drawn by it. */
export function useNow(ms = 500): number {
  const [now, tick] = useState(() => performance.now());
  useEffect(() => {
    const timer = setInterval(() => tick(performance.now()), ms);
    return () => clearInterval(timer);
  }, [ms]);
  return now;
}

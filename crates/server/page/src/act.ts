// What people do.

import { attempt } from "./api.ts";
import { refresh } from "./heard.ts";
import { releaseAll, type Way } from "./live/hold.ts";
import { say } from "./socket.ts";
import { get, type Model, set, use } from "./store.ts";
import type { Instrument } from "./types.ts";

/** Everything stands still: by every way there is, and never asking. What is held is held no more. */
export function stop(): void {
  releaseAll();
  say({ type: "stop" });
  void attempt("POST", "stop");
}

/** Whether this one may move, nobody else drives, and the computer at the microscope answers. */
function drives(m: Model): boolean {
  const owner = m.state?.owner ?? null;
  return (m.me?.may_move ?? false) && (owner === null || owner === m.me?.user || (m.state?.mine ?? false)) && m.link !== "lost" && m.state !== null;
}

function underWay(m: Model): string[] {
  return (m.state?.jobs ?? []).filter((job) => job.state.state !== "ended").map((job) => job.kind);
}

function canStep(m: Model): boolean {
  return drives(m) && underWay(m).length === 0;
}

function canStart(m: Model): boolean {
  return canStep(m) && m.state?.may_not_start === null;
}

/** Whether a job that is asked for now would be begun. */
export function mayStart(): boolean {
  return canStart(get());
}

/** The same, for what is drawn. */
export function useMayStart(): boolean {
  return use(canStart);
}

/** Whether a single step by hand would be: what a killed program left does not bar it. */
export function mayStep(): boolean {
  return canStep(get());
}

export function useMayStep(): boolean {
  return use(canStep);
}

/** Jobs that a card tells of, or that are over in a moment. */
const TOLD = new Set(["reposition", "calibrate", "focus", "check", "doctor", "save_target", "move", "centre", "jog"]);

/** Why nothing can be started now, where nothing else on the page tells. */
export function useWhyNot(): string | null {
  return use((m) => {
    const why = m.state?.may_not_start ?? null;
    if (why === null || m.link === "lost") return null;
    // The live page has a card for what was left.
    if (why.code === "unfinished" && m.page === "live") return null;
    if (why.code === "busy" && underWay(m).every((kind) => TOLD.has(kind))) return null;
    return why.message;
  });
}

/** Moves by hand end within a moment, of which this page hears a moment later. */
const BRIEF = new Set(["move", "centre", "jog"]);

function canPoint(m: Model): boolean {
  return drives(m) && underWay(m).every((kind) => BRIEF.has(kind));
}

/** Whether a press in the view counts: also just after a move, where the server says whether it has ended. */
export function mayPoint(): boolean {
  return canPoint(get());
}

export function useMayPoint(): boolean {
  return use(canPoint);
}

/** For what may be set while something is under way. */
export function useDrives(): boolean {
  return use(drives);
}

function canHold(m: Model): boolean {
  return drives(m) && underWay(m).every((kind) => kind === "jog");
}

/** Whether one may begin to hold: nothing but what is held already is under way. */
export function mayHold(): boolean {
  return canHold(get());
}

export function useMayHold(): boolean {
  return use(canHold);
}

/** Whether the instrument has the axes for that: nothing is asked that it cannot do. */
export function moves(instrument: Instrument | null, way: Way): boolean {
  const has = new Set(instrument?.axes.map((one) => one.axis));
  return instrument === null || Object.keys(way).every((axis) => has.has(axis));
}

export async function start(job: Record<string, unknown>): Promise<number | null> {
  const told = await attempt<{ id: number }>("POST", "jobs", job);
  return told?.id ?? null;
}

export async function goBack(name: string | null): Promise<void> {
  if (!name) return;
  set({ chosen: name, page: "live", last: null });
  await start({ job: "reposition", target: name });
}

export async function save(name: string, focus: boolean): Promise<boolean> {
  const id = await start({ job: "save_target", name, focus });
  if (id !== null) set({ saving: false, chosen: name, last: null });
  return id !== null;
}

/** Says something else of a saved view: its name, its slide, what was noted. */
export async function edit(name: string, to: { name?: string; slide?: string | null; note?: string }): Promise<void> {
  if (await attempt("PATCH", `targets/${encodeURIComponent(name)}`, to)) {
    if (to.name !== undefined && get().chosen === name) set({ chosen: to.name });
    await refresh();
  }
}

export async function restore(name: string): Promise<void> {
  if (await attempt("PATCH", `targets/${encodeURIComponent(name)}`, { restore: true })) await refresh();
}

/** For good. */
export async function purge(name: string): Promise<void> {
  if (await attempt("DELETE", `bin/${encodeURIComponent(name)}`)) await refresh();
}

/** Takes all of them out; those that could not be stay, with what was refused. */
export async function removeAll(names: string[]): Promise<string[]> {
  const left: string[] = [];
  for (const name of names) {
    // What is refused once is refused for the rest as well: it is said once.
    if (left.length > 0 || !(await attempt("DELETE", `targets/${encodeURIComponent(name)}`))) left.push(name);
  }
  await refresh();
  return left;
}

export async function remove(name: string): Promise<void> {
  if (await attempt("DELETE", `targets/${encodeURIComponent(name)}`)) await refresh();
}

/** Lays a picture under the demonstration's microscope; null: what lay there at first. */
export async function layPicture(name: string | null): Promise<void> {
  // What is told of the former slide is no news of this one.
  if (await attempt("POST", "demo", { picture: name })) set({ last: null });
}

export function by(axis: "z_um" | "rz_deg" | "x_um" | "y_um", amount: number): void {
  void start({ job: "move", by: { [axis]: amount } });
}

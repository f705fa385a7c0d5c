// What people do.

import { attempt } from "./api.ts";
import { refresh } from "./heard.ts";
import { say } from "./socket.ts";
import { get, set } from "./store.ts";

/** Everything stands still: by every way there is, and never asking. */
export function stop(): void {
  say({ type: "stop" });
  void attempt("POST", "stop");
}

export function mayMove(): boolean {
  return get().me?.may_move ?? false;
}

/** The job that works, and is no step by hand. */
export function busy(): boolean {
  return get().state?.jobs.some((job) => job.state.state !== "ended") ?? false;
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

export async function rename(name: string, to: string): Promise<void> {
  if (await attempt("PATCH", `targets/${encodeURIComponent(name)}`, { name: to })) {
    if (get().chosen === name) set({ chosen: to });
    await refresh();
  }
}

export async function remove(name: string): Promise<void> {
  if (await attempt("DELETE", `targets/${encodeURIComponent(name)}`)) await refresh();
}

export function by(axis: "z_um" | "rz_deg" | "x_um" | "y_um", amount: number): void {
  void start({ job: "move", by: { [axis]: amount } });
}

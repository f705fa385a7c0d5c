// Keys of the whole page. Where somebody writes, letters are letters; Escape stops everywhere.

import { goBack, mayStart, mayStep, moves, start, stop, mayHold } from "./act.ts";
import { hold, release, releaseAll, type Way } from "./live/hold.ts";
import { get, type Page, set } from "./store.ts";

const WAYS: Record<string, Way> = {
  ArrowUp: { y: -1 },
  ArrowDown: { y: 1 },
  ArrowLeft: { x: -1 },
  ArrowRight: { x: 1 },
  PageUp: { z: 1 },
  PageDown: { z: -0.5 },
  "[": { rz: -1 },
  "]": { rz: 1 },
};

const PAGES: Record<string, Page> = { l: "live", t: "targets", r: "runs" };

function isWriting(target: EventTarget | null): boolean {
  return target instanceof HTMLInputElement || target instanceof HTMLSelectElement || target instanceof HTMLTextAreaElement;
}

function down(event: KeyboardEvent): void {
  if (event.key === "Escape") {
    stop();
    return;
  }
  const model = get();
  const isShut = document.querySelector("dialog[open]") !== null;
  if (isShut || !model.me || isWriting(event.target) || event.ctrlKey || event.metaKey || event.altKey) return;
  const way = WAYS[event.key];
  if (way && model.page === "live") {
    event.preventDefault();
    // A key that is held on repeats itself: only its first word counts, so that what was stopped stays so.
    if (!event.repeat && mayHold() && moves(model.instrument, way)) hold(`key ${event.code}`, way);
    return;
  }
  if (event.repeat) return;
  const key = event.key.toLowerCase();
  if (key === "?") set({ help: true });
  else if (PAGES[key]) set({ page: PAGES[key] });
  else if (!mayStep()) return;
  else if (Number(key) > 0) {
    const objective = model.instrument?.objectives[Number(key) - 1];
    if (objective) void start({ job: "objective", objective: objective.id });
  } else if (!mayStart()) return;
  else if (key === "s") {
    event.preventDefault();
    set({ saving: true });
  } else if (key === "g") void goBack(model.chosen);
  else if (key === "f") void start({ job: "focus" });
}

export function listen(): void {
  window.addEventListener("keydown", down);
  // By its place, not its name: a key has another name when Shift comes along.
  window.addEventListener("keyup", (event) => {
    release(`key ${event.code}`);
    // Some systems tell nothing of keys that are let go of while this one is held.
    if (event.key === "Meta") releaseAll();
  });
}

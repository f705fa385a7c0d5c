// Held to move: said again ten times a second while it is held, and ended whenever it may not be held any more.
// What was ended otherwise than by letting go, by Stop or because nobody looks, begins again only when it is pressed anew.

import { onLost, say } from "../socket.ts";
import { get, set } from "../store.ts";
import { words } from "../words.ts";

export type Way = { x?: number; y?: number; z?: number; rz?: number };

const AGAIN_MS = 100;

let timer: number | null = null;
let ways = new Map<string, Way>();

function word(): void {
  const sum = { x: 0, y: 0, z: 0, rz: 0 };
  for (const way of ways.values()) {
    sum.x += way.x ?? 0;
    sum.y += way.y ?? 0;
    sum.z += way.z ?? 0;
    sum.rz += way.rz ?? 0;
  }
  say({ type: "jog", ...sum });
}

/** Begins to hold; `by` is the key or the button. */
export function hold(by: string, way: Way): void {
  if (ways.has(by)) return;
  if (get().link !== "live") {
    set({ refused: { code: "no_connection", kind: "refusal", message: words.noHold } });
    return;
  }
  ways.set(by, way);
  word();
  timer ??= window.setInterval(word, AGAIN_MS);
}

export function release(by: string): void {
  if (!ways.delete(by) || ways.size > 0) return;
  end();
}

export function releaseAll(): void {
  if (ways.size === 0) return;
  ways = new Map();
  end();
}

function end(): void {
  if (timer !== null) clearInterval(timer);
  timer = null;
  say({ type: "jog_end" });
}

window.addEventListener("blur", releaseAll);
window.addEventListener("pagehide", releaseAll);
// Also where the button that was pressed is gone or disabled meanwhile.
window.addEventListener("pointerup", releaseAll);
window.addEventListener("pointercancel", releaseAll);
onLost(releaseAll);
document.addEventListener("visibilitychange", releaseAll);

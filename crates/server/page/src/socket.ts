// The connection that lasts: frames, how things stand, what happens. Where it is blocked, the same by asking again and again.

import { address, ask, Refused } from "./api.ts";
import { onEvent, onState } from "./heard.ts";
import { get, set } from "./store.ts";
import type { EventRecord, FrameHead, State } from "./types.ts";

/** The server says how things stand every second: who says nothing for so long is gone, ms. */
const SILENT_MS = 4000;

/** Draws a picture; called with each frame. */
type Painter = (picture: ImageBitmap, head: FrameHead) => void;

const FPS = 30;
/** So often it is tried again, ms; after each failure twice as long. */
const FIRST_MS = 500;
const LONGEST_MS = 8000;
/** After so many failures the rest is asked for. */
const BLOCKED = 3;
const ALIVE_MS = 2000;
const POLL_MS = 700;

let socket: WebSocket | null = null;
let failures = 0;
let next: number | null = null;
let painter: Painter | null = null;
let polling = false;
let isWatching = false;
let heardAt = 0;
const ears: (() => void)[] = [];

/** What is to be done when the connection is gone. */
export function onLost(ear: () => void): void {
  ears.push(ear);
}

export function paintWith(paint: Painter | null): void {
  painter = paint;
  watch();
}

function watch(): void {
  const wanted = painter !== null && !document.hidden;
  if (wanted === isWatching && wanted) return;
  isWatching = wanted;
  say({ type: "watch", fps: wanted ? FPS : 0 });
}

/** Says something; whether it could be said. */
export function say(what: unknown): boolean {
  if (socket?.readyState !== WebSocket.OPEN) return false;
  socket.send(JSON.stringify(what));
  return true;
}

export function connect(): void {
  if (socket) return;
  const url = new URL(address("live"), document.baseURI);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  const opening = new WebSocket(url);
  opening.binaryType = "arraybuffer";
  socket = opening;
  opening.onopen = () => {
    failures = 0;
    heardAt = performance.now();
    isWatching = false;
    set({ link: "live" });
    if (next !== null) say({ type: "from", number: next });
    watch();
  };
  opening.onmessage = (message) => {
    heardAt = performance.now();
    if (typeof message.data === "string") told(JSON.parse(message.data));
    else void shown(message.data as ArrayBuffer);
  };
  opening.onclose = closed;
}

function closed(): void {
  socket = null;
  isWatching = false;
  failures += 1;
  for (const ear of ears) ear();
  if (get().me === null) return;
  if (get().link === "live") set({ link: "lost" });
  const wait = Math.min(FIRST_MS * 2 ** (failures - 1), LONGEST_MS);
  setTimeout(connect, wait);
  if (failures >= BLOCKED) void poll();
}

/** A connection may die without a word, as when a network goes: then it is closed from here. */
function listenForSilence(): void {
  const silent = socket;
  if (silent?.readyState !== WebSocket.OPEN || performance.now() - heardAt < SILENT_MS) return;
  silent.onclose = null;
  silent.onmessage = null;
  silent.close();
  closed();
}

export function disconnect(): void {
  const closing = socket;
  socket = null;
  if (closing) {
    closing.onclose = null;
    closing.close();
  }
}

type Told =
  | { type: "hello"; next: number }
  | { type: "state"; state: State }
  | { type: "event"; record: EventRecord }
  | { type: "missed"; events: number }
  | { type: "refused"; code: string; message: string }
  | { type: "pong" };

function told(message: Told): void {
  switch (message.type) {
    case "hello":
      next ??= message.next;
      break;
    case "state":
      onState(message.state);
      break;
    case "event":
      next = message.record.number + 1;
      onEvent(message.record);
      break;
    case "refused":
      if (message.code === "not_logged_in") {
        disconnect();
        set({ me: null });
      }
      set({ refused: { code: message.code, kind: "refusal", message: message.message } });
      break;
    default:
      break;
  }
}

async function shown(data: ArrayBuffer): Promise<void> {
  const length = new DataView(data).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length))) as FrameHead;
  const jpeg = new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" });
  await paint(jpeg, head);
  say({ type: "ack", seq: head.seq });
}

async function paint(jpeg: Blob, head: FrameHead): Promise<void> {
  try {
    const picture = await createImageBitmap(jpeg);
    painter?.(picture, head);
    picture.close();
  } catch {
    // A picture that cannot be read is not shown; its age is told.
    return;
  }
  const sharpness = [...get().sharpness, head.sharpness].slice(-90);
  set({ frame: head, frameAt: performance.now() - head.age_ms, sharpness });
}

/** By single questions, while there is no other way. */
async function poll(): Promise<void> {
  if (polling) return;
  polling = true;
  while (socket?.readyState !== WebSocket.OPEN && get().me) {
    try {
      onState(await ask<State>("GET", "state"));
      if (get().link !== "live") set({ link: "polling" });
      if (painter && !document.hidden) {
        const answer = await fetch(address("frame.jpg"), { credentials: "same-origin", cache: "no-store" });
        if (answer.ok) await paint(await answer.blob(), polled(get().frame));
      }
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      set({ link: "lost" });
    }
    await new Promise((resolve) => setTimeout(resolve, POLL_MS));
  }
  polling = false;
}

/** Of a frame that came alone nothing is told: what is known of the instrument stands for it. */
function polled(before: FrameHead | null): FrameHead {
  const { state, instrument } = get();
  const camera = instrument?.camera ?? { width: 640, height: 480 };
  const objective = instrument?.objectives.find((o) => o.id === state?.objective);
  return {
    seq: (before?.seq ?? 0) + 1,
    time_s: state?.time_s ?? 0,
    age_ms: 0,
    width: camera.width,
    height: camera.height,
    full_width: camera.width,
    full_height: camera.height,
    um_per_px: objective?.um_per_px ?? null,
    objective: state?.objective ?? null,
    at: state?.at ?? null,
    role: "live",
    sharpness: 0,
    saturated: 0,
    dark: 0,
  };
}

/** Whoever drives says that they are there, over whatever there is. */
function alive(): void {
  if (!get().state?.mine || say({ type: "alive" })) return;
  if (get().link === "polling") void ask("POST", "lease").catch(() => null);
}

setInterval(alive, ALIVE_MS);
setInterval(listenForSilence, 1000);
document.addEventListener("visibilitychange", watch);

// A microscope of nothing but time, in the driver protocol: each stop is written down with when it came and whether the stage moved, for `stops.mjs`.
import { appendFileSync } from "node:fs";
import { createInterface } from "node:readline";

const file = process.argv[2];
const now = () => Number(process.hrtime.bigint()) / 1e6;
const SPEED = 1; // um in a millisecond
const [WIDTH, HEIGHT] = [640, 480];
const at = { x: 0, y: 0 };
let move = null;
let frames = 0;
let exposure = 10;

/** Where it is now. */
function place() {
  if (move) {
    const share = Math.min(1, (now() - move.since) / move.lasts);
    for (const axis of ["x", "y"]) at[axis] = move.from[axis] + share * (move.to[axis] - move.from[axis]);
    if (share === 1) move = null;
  }
  return { x_um: at.x, y_um: at.y };
}

const axis = (name) => ({ axis: name, min_um: -60000, max_um: 60000, repeatability_um: 1 });
const calls = {
  hello: () => ({
    protocol: 1,
    name: "stopwatch",
    stage: { name: "stopwatch", moves: "specimen_xy_on_top", axes: [axis("x"), axis("y")] },
    camera: { name: "stopwatch", width_px: WIDTH, height_px: HEIGHT, channels: 1, bits: 8, min_exposure_ms: 1, max_exposure_ms: 100 },
    nosepiece: { name: "stopwatch", objectives: [{ id: "10x", magnification: 100, numerical_aperture: 0.25, um_per_px: 2.2 }] },
  }),
  position: place,
  motion: () => (place(), { motion: move ? "moving" : "settled" }),
  move: (asked) => {
    const from = { ...place(), ...{} };
    const to = { x: asked.x_um ?? at.x, y: asked.y_um ?? at.y };
    move = { since: now(), from: { x: from.x_um, y: from.y_um }, to, lasts: Math.max(1, Math.hypot(to.x - at.x, to.y - at.y) / SPEED) };
    appendFileSync(file, `move ${now()}\n`);
    return {};
  },
  stop: () => {
    const came = now();
    place();
    appendFileSync(file, `stop ${came} ${move ? "moving" : "standing"}\n`);
    move = null;
    return {};
  },
  objective: () => ({ objective: "10x", motion: "settled" }),
  exposure: (asked) => ({ exposure_ms: (exposure = asked.exposure_ms ?? exposure) }),
  bye: () => ({}),
};

function say(message, bytes) {
  process.stdout.write(`${JSON.stringify(message)}\n`);
  if (bytes) process.stdout.write(bytes);
}

/** Grey that runs through the view, with something in it. */
function grab(id) {
  const since = now();
  setTimeout(() => {
    const bytes = Buffer.alloc(WIDTH * HEIGHT);
    frames += 1;
    for (let y = 0; y < HEIGHT; y++) bytes.fill((y + 3 * frames) & 255, y * WIDTH, (y + 1) * WIDTH);
    const frame = { width_px: WIDTH, height_px: HEIGHT, channels: 1, bits: 8, exposure_ms: exposure, sequence: frames, age_ms: now() - since, bytes: bytes.length };
    say({ id, ok: true, ...frame }, bytes);
  }, exposure);
}

createInterface({ input: process.stdin }).on("line", (line) => {
  const asked = JSON.parse(line);
  if (asked.call === "grab") return void grab(asked.id);
  const call = calls[asked.call];
  say(call ? { id: asked.id, ok: true, ...call(asked) } : { id: asked.id, error: "unsupported", message: `there is no ${asked.call}` });
  if (asked.call === "bye") process.exit(0);
}).on("close", () => process.exit(0));

#!/usr/bin/env node
// A simulated microscope that speaks the scopeservo driver protocol, version 1, on standard input and output:
// a stage (x, y, z), a grey camera and a nosepiece with two objectives. Nothing real moves. To try it:
//
//     scopeservo driver check -- node simulated-driver.mjs
//
// The simulated devices compute from the clock where they are when they are asked. So nothing here ever waits, and a
// `stop` is answered at once, also while a frame is being exposed.

const PROTOCOL = 1;
const LINE_LIMIT = 65536; // bytes, the line feed included
const SETTLING_MS = 50;
const TURNING_MS = 1000;
const DEFAULT_EXPOSURE_MS = 10;

const AXES = [
  { axis: 'x', min_um: -10000, max_um: 10000, repeatability_um: 0.1 },
  { axis: 'y', min_um: -10000, max_um: 10000, repeatability_um: 0.1 },
  { axis: 'z', min_um: -3000, max_um: 3000, repeatability_um: 0.05 },
];
const SPEED_UM_PER_MS = { x: 10, y: 10, z: 2 };
const MISSING_AXES = ['rx_deg', 'ry_deg', 'rz_deg']; // the other goals in the protocol; any other field is ignored
const OBJECTIVES = [
  { id: '10x', magnification: 100, numerical_aperture: 0.25, um_per_px: 2.0 },
  { id: '40x', magnification: 400, numerical_aperture: 0.65, um_per_px: 0.5 },
];
const FRAME = { width_px: 320, height_px: 240, channels: 1, bits: 8 };
const EXPOSURES = { min_exposure_ms: 1, max_exposure_ms: 200 };
const DEVICES = {
  stage: { name: 'Simulated stage', moves: 'specimen_xy_on_top', positive_z: 'closer', axes: AXES },
  camera: { name: 'Simulated camera', ...FRAME, ...EXPOSURES },
  nosepiece: { name: 'Simulated nosepiece', objectives: OBJECTIVES },
};

const now = () => performance.now(); // unlike the time of day, this clock never jumps

/** An error that goes to the program, with one of the codes of the protocol. */
class Refusal extends Error {
  constructor(code, message) {
    super(message);
    this.code = code;
  }
}

// ---- Stage and nosepiece ----

/** Something that takes its time, unless it is stopped before. */
class Run {
  #began = 0;
  #end = 0;
  #stopped = false;

  start(duration_ms) {
    this.#began = now();
    this.#end = this.#began + duration_ms;
    this.#stopped = false;
  }

  /** Stopped while it settles also counts as stopped: nobody has seen it settle. */
  stop() {
    if (this.motion !== 'moving') return;
    this.#end = now();
    this.#stopped = true;
  }

  get motion() {
    if (now() < this.#end) return 'moving';
    return this.#stopped ? 'stopped' : 'settled';
  }

  /** How long it has run; no longer grows after its end. */
  get elapsed_ms() {
    return Math.min(now(), this.#end) - this.#began;
  }
}

const stage = {
  run: new Run(),
  from: { x: 0, y: 0, z: 0 },
  to: { x: 0, y: 0, z: 0 },
  travel_ms: 0,

  /** Where it is at this moment: on a straight line while it moves. */
  place() {
    const part = this.travel_ms > 0 ? Math.min(1, this.run.elapsed_ms / this.travel_ms) : 1;
    return Object.fromEntries(AXES.map(({ axis }) => [axis, this.from[axis] + part * (this.to[axis] - this.from[axis])]));
  },

  /** Starts a move; `goals` has a place in micrometres for one or more axes. All are judged before anything moves. */
  move(goals) {
    const named = AXES.filter(({ axis }) => goals[axis] !== undefined);
    for (const { axis, min_um, max_um } of named) {
      if (goals[axis] >= min_um && goals[axis] <= max_um) continue;
      throw new Refusal('outside_limits', `${axis} goes from ${min_um} to ${max_um} um; choose a place between.`);
    }
    if (this.run.motion === 'moving') throw new Refusal('busy', 'The stage still moves; wait for its end or stop it.');

    this.from = this.place();
    this.to = { ...this.from };
    this.travel_ms = 0;
    for (const { axis, min_um, max_um, repeatability_um } of named) {
      // No stage arrives exactly. This one ends anywhere within its repeatability, but not beyond the end of travel.
      const arrival = goals[axis] + (2 * Math.random() - 1) * repeatability_um;
      this.to[axis] = Math.min(max_um, Math.max(min_um, arrival));
      this.travel_ms = Math.max(this.travel_ms, Math.abs(this.to[axis] - this.from[axis]) / SPEED_UM_PER_MS[axis]);
    }
    this.run.start(this.travel_ms + SETTLING_MS);
  },
};

const nosepiece = {
  run: new Run(),
  chosen: OBJECTIVES[0],

  /** The objective in the beam; null while it turns, and after it was stopped between two. */
  inBeam() {
    return this.run.motion === 'settled' ? this.chosen : null;
  },

  change(id) {
    const objective = OBJECTIVES.find((one) => one.id === id);
    if (!objective) throw new Refusal('no_such_objective', `Choose one of ${OBJECTIVES.map((one) => one.id).join(', ')}.`);
    if (this.run.motion === 'moving') throw new Refusal('busy', 'The nosepiece still turns; wait for its end or stop it.');
    if (objective === this.inBeam()) return; // nothing to turn
    this.chosen = objective;
    this.run.start(TURNING_MS);
  },
};

function stopEverything() {
  stage.run.stop();
  nosepiece.run.stop();
}

// ---- Picture ----

// Layers of value noise: the size of a lattice cell on the specimen, and its share of the contrast. The coarse ones are
// seen through both objectives, the finest only through the strong one.
const LAYERS = [
  { cell_um: 200, weight: 0.15 },
  { cell_um: 50, weight: 0.3 },
  { cell_um: 16, weight: 0.25 },
  { cell_um: 5, weight: 0.2 },
  { cell_um: 1.5, weight: 0.1 },
];

/** A fixed value from -1 to 1 for each lattice point: the same place looks the same in every run. */
function latticeValue(i, j, layer) {
  let h = Math.imul(i, 0x27d4eb2d) ^ Math.imul(j, 0x165667b1) ^ Math.imul(layer + 1, 0x9e3779b1);
  h = Math.imul(h ^ (h >>> 15), 0x85ebca6b);
  h = Math.imul(h ^ (h >>> 13), 0xc2b2ae35);
  return ((h ^ (h >>> 16)) >>> 0) / 0x7fffffff - 1;
}

/** For each pixel in one direction: the lattice point before it, and how far it is towards the next, smoothed. */
function latticeSteps(pixels, first_um, step_um, cell_um) {
  const cells = Float64Array.from({ length: pixels }, (_, k) => (first_um + k * step_um) / cell_um);
  const base = Math.floor(Math.min(cells[0], cells[pixels - 1]));
  const points = Math.floor(Math.max(cells[0], cells[pixels - 1])) - base + 2;
  const index = Int32Array.from(cells, (cell) => Math.floor(cell) - base);
  const part = Float32Array.from(cells, (cell) => cell - Math.floor(cell)).map((t) => t * t * (3 - 2 * t));
  return { base, points, index, part };
}

/** Adds one layer to the texture, row by row. Each lattice point is hashed once, instead of four times per pixel. */
function addLayer(texture, layer, left_um, top_um, um_per_px) {
  const { cell_um, weight } = LAYERS[layer];
  const across = latticeSteps(FRAME.width_px, left_um, um_per_px, cell_um);
  const down = latticeSteps(FRAME.height_px, top_um, -um_per_px, cell_um);
  const lattice = new Float32Array(across.points * down.points);
  for (let j = 0, n = 0; j < down.points; j++) {
    for (let i = 0; i < across.points; i++) lattice[n++] = weight * latticeValue(across.base + i, down.base + j, layer);
  }
  const line = new Float32Array(across.points); // the lattice, blended along y for one row of pixels
  for (let row = 0, n = 0; row < FRAME.height_px; row++) {
    const from = down.index[row] * across.points;
    for (let i = 0; i < across.points; i++) {
      line[i] = lattice[from + i] + down.part[row] * (lattice[from + across.points + i] - lattice[from + i]);
    }
    for (let column = 0; column < FRAME.width_px; column++) {
      const i = across.index[column];
      texture[n++] += line[i] + across.part[column] * (line[i + 1] - line[i]);
    }
  }
}

/** The samples of a frame of the specimen. Without an objective in the beam (null) it is dark. */
function render(place, objective, exposure_ms) {
  const texture = new Float32Array(FRAME.width_px * FRAME.height_px);
  const samples = Buffer.alloc(texture.length);
  if (!objective) return samples;

  // The stage carries the specimen: in the middle of the picture is the point of the specimen at minus the place of
  // the stage, and what is seen shifts with the stage. x goes to the right and y up, so against the rows.
  const scale = objective.um_per_px;
  const left_um = -place.x - ((FRAME.width_px - 1) / 2) * scale;
  const top_um = -place.y + ((FRAME.height_px - 1) / 2) * scale;
  for (let layer = 0; layer < LAYERS.length; layer++) {
    if (LAYERS[layer].cell_um >= 2 * scale) addLayer(texture, layer, left_um, top_um, scale); // pixels show no finer one
  }

  // A little brighter near z = 0. Longer exposures are brighter too, but less so than with a real camera: none that is
  // on offer shall give a picture that is all black or all white.
  const gain = (0.8 + 0.2 / (1 + (place.z / 100) ** 2)) * (exposure_ms / DEFAULT_EXPOSURE_MS) ** 0.25;
  for (let n = 0; n < samples.length; n++) samples[n] = Math.max(0, Math.min(255, gain * (90 + 100 * texture[n])));
  return samples;
}

// ---- Camera ----

const camera = {
  exposure_ms: DEFAULT_EXPOSURE_MS,
  sequence: 0,
  pending: null, // the timer of the frame that is being exposed, and the id of the request for it

  /** Begins an exposure now; the reply goes out by itself when the frame is there. */
  grab(id) {
    if (this.pending) throw new Refusal('refused', 'A frame is being exposed already; wait for it.');
    const began = { time: now(), place: stage.place(), objective: nosepiece.inBeam() };
    const { exposure_ms } = this; // a new exposure is for the next frame
    const finish = () => {
      this.pending = null;
      // A stage that moves is shown, without blur, halfway between the beginning and the end of the exposure.
      const end = stage.place();
      const middle = Object.fromEntries(AXES.map(({ axis }) => [axis, (began.place[axis] + end[axis]) / 2]));
      const objective = nosepiece.inBeam() === began.objective ? began.objective : null;
      const samples = render(middle, objective, exposure_ms);
      const sequence = ++this.sequence;
      reply(id, { ...FRAME, exposure_ms, sequence, age_ms: now() - began.time, bytes: samples.length }, samples);
    };
    this.pending = { id, timer: setTimeout(() => answering(id, finish), Math.ceil(exposure_ms)) };
  },

  /** Gives up the frame that is being exposed, if any; its request gets an answer all the same. */
  abandon() {
    if (!this.pending) return;
    clearTimeout(this.pending.timer);
    replyError(this.pending.id, 'refused', 'The connection ended before the frame was there; connect and grab again.');
    this.pending = null;
  },
};

// ---- Calls ----

let greeted = false;
let ending = false;
let lastId = 0;

/** The value of a field that must be a number. JSON.parse makes Infinity of 1e999, which is none. */
function numberIn(request, field) {
  if (Number.isFinite(request[field])) return request[field];
  throw new Refusal('bad_request', `${field} must be a finite number; send one.`);
}

/** Each call returns the fields of its reply, or nothing when it sees to the reply itself. */
const CALLS = {
  hello(request) {
    if (greeted) throw new Refusal('bad_request', 'hello comes once per connection; go on with the other calls.');
    if (numberIn(request, 'protocol') !== PROTOCOL) {
      throw new Refusal('unsupported', `This driver speaks version ${PROTOCOL} of the protocol; use a program that does, too.`);
    }
    greeted = true;
    return { protocol: PROTOCOL, name: 'Simulated microscope', ...DEVICES };
  },

  position() {
    return Object.fromEntries(Object.entries(stage.place()).map(([axis, um]) => [`${axis}_um`, um]));
  },

  move(request) {
    const named = AXES.map(({ axis }) => axis).filter((axis) => Object.hasOwn(request, `${axis}_um`));
    const missing = MISSING_AXES.filter((field) => Object.hasOwn(request, field));
    const goals = Object.fromEntries(named.map((axis) => [axis, numberIn(request, `${axis}_um`)]));
    for (const field of missing) numberIn(request, field);
    if (missing.length) throw new Refusal('no_such_axis', `This stage does not rotate; leave out ${missing.join(', ')}.`);
    if (!named.length) throw new Refusal('bad_request', 'A move needs a goal; name x_um, y_um or z_um.');
    stage.move(goals);
    return {};
  },

  home() {
    stage.move({ x: 0, y: 0, z: 0 }); // it always knows where it is; its reference is the middle of its travel
    return {};
  },

  motion: () => ({ motion: stage.run.motion }),

  stop() {
    stopEverything();
    return {};
  },

  objective: () => ({ objective: nosepiece.inBeam()?.id ?? null, motion: nosepiece.run.motion }),

  change(request) {
    if (typeof request.objective !== 'string') throw new Refusal('bad_request', 'objective must be an id; send it as text.');
    nosepiece.change(request.objective);
    return {};
  },

  exposure(request) {
    if (Object.hasOwn(request, 'exposure_ms')) {
      const wanted = numberIn(request, 'exposure_ms');
      const { min_exposure_ms: min, max_exposure_ms: max } = EXPOSURES;
      if (wanted < min || wanted > max) throw new Refusal('outside_limits', `Choose an exposure from ${min} to ${max} ms.`);
      camera.exposure_ms = wanted;
    }
    return { exposure_ms: camera.exposure_ms };
  },

  grab: (request) => camera.grab(request.id),

  bye(request) {
    stopEverything();
    camera.abandon();
    reply(request.id, {});
    end();
  },
};

function handle(request) {
  const { id, call } = request;
  if (id <= lastId) throw new Refusal('bad_request', `The id must rise; send one above ${lastId}.`);
  lastId = id;
  if (typeof call !== 'string') throw new Refusal('bad_request', 'A request needs a call; name one.');
  if (!greeted && call !== 'hello') throw new Refusal('bad_request', 'The first call must be hello; send it.');
  // hasOwn, because every object has more names than those written above ("constructor", for one)
  if (!Object.hasOwn(CALLS, call)) throw new Refusal('unsupported', 'This driver has no such call or device; do without it.');
  const fields = CALLS[call](request);
  if (fields) reply(id, fields);
}

// ---- Replies ----

/** Line and samples go out in one piece, so that no other reply can come between them. */
function reply(id, fields, samples = Buffer.alloc(0)) {
  process.stdout.write(Buffer.concat([Buffer.from(`${JSON.stringify({ id, ok: true, ...fields })}\n`), samples]));
}

function replyError(id, error, message) {
  process.stdout.write(`${JSON.stringify({ id, error, message })}\n`);
}

/** Does something for a request; when that fails, the error is the answer. */
function answering(id, action) {
  try {
    action();
  } catch (problem) {
    if (problem instanceof Refusal) return replyError(id, problem.code, problem.message);
    stopEverything();
    console.error(problem);
    replyError(id, 'fault', 'The simulation failed; start it again.');
  }
}

// ---- Input ----

const utf8 = new TextDecoder('utf-8', { fatal: true, ignoreBOM: true });
let kept = []; // pieces of the line that is not complete yet
let keptBytes = 0;
let skipping = false; // within a line that is too long, up to its line feed

function readLine(bytes) {
  let request = null;
  try {
    request = JSON.parse(utf8.decode(bytes)); // to JSON, a carriage return at the end is blank space
  } catch {} // no message, like one without an id
  const id = request?.id;
  if (Number.isInteger(id) && id >= 1 && id <= 2 ** 53) return answering(id, () => handle(request));
  replyError(null, 'bad_request', 'A line must be a JSON object in UTF-8 with an id from 1 to 2^53; send one.');
}

function keep(piece) {
  if (skipping) return;
  kept.push(piece);
  keptBytes += piece.length;
  if (keptBytes < LINE_LIMIT) return; // there is still room for the line feed
  skipping = true;
  kept = [];
  replyError(null, 'bad_request', `A line has at most ${LINE_LIMIT} bytes; send shorter ones.`);
}

function read(chunk) {
  let from = 0;
  for (let feed; !ending && (feed = chunk.indexOf('\n', from)) >= 0; from = feed + 1) {
    keep(chunk.subarray(from, feed));
    if (!skipping) readLine(Buffer.concat(kept));
    kept = [];
    keptBytes = 0;
    skipping = false;
  }
  if (!ending) keep(chunk.subarray(from));
}

/** Stops what moves and ends: after the replies already written have gone out, or soon if nobody reads them. */
function end() {
  stopEverything();
  ending = true;
  setTimeout(() => process.exit(0), 500);
  process.stdout.write('', () => process.exit(0));
}

// The first picture takes some 50 ms longer than the others, until its code is compiled. Nobody waits for this one.
render(stage.place(), OBJECTIVES[1], DEFAULT_EXPOSURE_MS);

process.stdin.on('data', read);
process.stdin.on('end', end); // the program may have been killed; half a line that is left over is no request
process.stdin.on('error', end);
process.stdout.on('error', () => process.exit(0)); // nobody listens any more
for (const signal of ['SIGTERM', 'SIGINT', 'SIGHUP']) process.on(signal, end);

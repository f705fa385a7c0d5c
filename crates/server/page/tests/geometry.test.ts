import { strict as assert } from "node:assert";
import { test } from "node:test";
import { apply, ellipse, inverse, isAway, outline, promisedMiddle, scaleBar, turnDeg, type Point } from "../src/geometry.ts";
import { age, duration, fineStep, fixed, freeName, length } from "../src/format.ts";
import { follow, EMPTY } from "../src/run/trace.ts";
import type { Affine, EventRecord } from "../src/types.ts";

const near = (a: number, b: number) => assert.ok(Math.abs(a - b) < 1e-9, `${a} is not ${b}`);

test("a saved view at four times the scale, turned by 30 degrees, lies where it was found", () => {
  const [c, s] = [4 * Math.cos(Math.PI / 6), 4 * Math.sin(Math.PI / 6)];
  const map: Affine = [
    [c, -s, 7],
    [s, c, -11],
  ];
  near(turnDeg(map), 30);
  const corners = outline(map, 640, 480) ?? assert.fail("no outline");
  const back = corners.map((corner) => apply(map, corner));
  const expected: Point[] = [
    [0, 0],
    [640, 0],
    [640, 480],
    [0, 480],
  ];
  back.forEach((corner, k) => {
    near(corner[0], expected[k][0]);
    near(corner[1], expected[k][1]);
  });
  near(Math.hypot(corners[1][0] - corners[0][0], corners[1][1] - corners[0][1]), 160);
  assert.equal(
    inverse([
      [1, 2, 0],
      [2, 4, 0],
    ]),
    null,
  );
});

test("a promise that was kept lies where the view is seen, and another as far away as it was off", () => {
  const [c, s] = [4 * Math.cos(Math.PI / 6), 4 * Math.sin(Math.PI / 6)];
  const map: Affine = [
    [c, -s, 900],
    [s, c, -1100],
  ];
  const [own, wanted]: Point[] = [
    [319.5, 239.5],
    [159.5, 119.5],
  ];
  // What is off: where the middle of the present view lies in the saved one, less its own middle.
  const at = apply(map, own);
  const off: Point = [at[0] - wanted[0], at[1] - wanted[1]];
  const seen = apply(inverse(map) ?? assert.fail("flat"), wanted);
  const kept = promisedMiddle(map, off, own) ?? assert.fail("flat");
  near(kept[0], seen[0]);
  near(kept[1], seen[1]);
  // Off by 8 pixels of the saved view: 2 of the present one, as that shows four times as much.
  const other = promisedMiddle(map, [off[0] + 8, off[1]], own) ?? assert.fail("flat");
  near(Math.hypot(other[0] - seen[0], other[1] - seen[1]), 2);
});

test("a doubt of the saved view is an ellipse where the map is no similarity", () => {
  const circle = ellipse([[2, 0, 5], [0, 2, 7]], 3) ?? assert.fail("flat");
  near(circle.rx, 1.5);
  near(circle.ry, 1.5);
  // Twice as fine along the first axis, turned by 30 degrees: long where it is fine, and along that axis.
  const [c, s] = [Math.cos(Math.PI / 6), Math.sin(Math.PI / 6)];
  const turned = ellipse([[0.5 * c, 0.5 * s, 0], [-s, c, 0]], 3) ?? assert.fail("flat");
  near(turned.rx, 6);
  near(turned.ry, 3);
  near(turned.deg, 30);
  assert.equal(ellipse([[1, 2, 0], [2, 4, 0]], 1), null);
});

test("a scale bar is a round length that fits", () => {
  assert.deepEqual(scaleBar(0.5, 640), { um: 50, px: 100 });
  assert.deepEqual(scaleBar(2.2, 640), { um: 200, px: 200 / 2.2 });
  assert.equal(scaleBar(null, 640), null);
  assert.equal(scaleBar(0, 640), null);
});

test("numbers are said with their unit, and nothing is minus nothing", () => {
  assert.equal(fixed(-0.001, 2), "0.00");
  assert.equal(fixed(-0.01, 2), "-0.01");
  assert.equal(length(0.354), "0.35 µm");
  assert.equal(length(0.0012), "less than 0.01 µm");
  assert.equal(length(-0.0012), "less than 0.01 µm");
  assert.equal(length(78.84), "78.8 µm");
  assert.equal(length(12_960), "13.0 mm");
  assert.equal(duration(7.26), "7.3 s");
  assert.equal(duration(125), "2 min 5 s");
  assert.deepEqual([1.9, 5, 300, 8000].map(age), ["", "5 s old", "5 min old", "2 h old"]);
});

test("a name is free whatever its letters' case", () => {
  assert.equal(freeName("view", []), "view-1");
  assert.equal(freeName("view", ["View-1", "view-3"]), "view-2");
});

const record = (job: number | null, event: Record<string, unknown>, from = "procedure"): EventRecord =>
  ({ number: 0, time_s: 10, job, from, ...event }) as EventRecord;

const iteration = {
  event: "iteration",
  objective: "10x",
  iteration: 0,
  sequence: 5,
  error: { t_m: [3e-6, -4e-6], theta_rad: Math.PI / 180 },
  sigma_px: 0.1,
  target_from_view: [
    [1, 0, 0],
    [0, 1, 0],
  ],
  inliers: 60,
  matches: 80,
  pairs: [],
  converged: false,
};

test("a run is what its events told, and another job begins another", () => {
  let trace = follow(EMPTY, record(3, { event: "started", objectives: ["10x", "40x"] }));
  trace = follow(trace, record(3, { event: "phase_started", phase: "servo", objective: "10x" }));
  trace = follow(trace, record(3, iteration));
  near(trace.steps[0].errorUm, 5);
  near(trace.steps[0].errorDeg, 1);
  assert.equal(trace.steps[0].by, "features", "a log of before does not tell");
  assert.equal(follow(trace, record(3, { ...iteration, by: "correlation" })).steps.at(-1)?.by, "correlation");
  assert.deepEqual(trace.objectives, ["10x", "40x"]);
  trace = follow(trace, record(3, { event: "lost" }));
  assert.equal(trace.lost, 1);
  trace = follow(trace, record(3, { event: "job_ended" }, "station"));
  assert.equal(trace.steps.length, 1);
  trace = follow(trace, record(4, { event: "phase_started", phase: "focus", objective: "40x" }));
  assert.deepEqual([trace.job, trace.steps.length, trace.lost], [4, 0, 0]);
});

test("a sweep in motion is told with what came of it", () => {
  const sweep = { range_um: [-200, 0], um_per_s: 858.6, frames: 22, counted: 17 };
  const begun = follow(EMPTY, record(3, { event: "phase_started", phase: "focus", objective: "40x" }));
  const now = (end: string, near_um: number | null = null) => follow(begun, record(3, { event: "focus_swept", sweep: { ...sweep, end, near_um } })).now;
  assert.equal(now("found", -7.6), "focusing with 40x; swept at 859 µm/s, 17 of 22 images count: looking closer at -8 µm");
  assert.match(now("refused"), /^focusing with 40x; the stage does not move as slowly/);
  assert.match(now("no_faster"), /would save no time/);
  assert.match(now("unknown"), /17 of 22 images count, too few: looking at rest$/);
  assert.match(now("no_peak"), /no peak: looking at rest$/);
});

test("a stage that scatters stands where it stood, and one that moved does not", () => {
  const from = { x_um: 100, y_um: -20, rz_deg: 3 };
  assert.equal(isAway(from, { x_um: 100.6, y_um: -20.6, rz_deg: 3.04 }), false);
  assert.equal(isAway(from, { x_um: 101.1, y_um: -20, rz_deg: 3 }), true);
  assert.equal(isAway(from, { x_um: 100, y_um: -20, rz_deg: 3.06 }), true);
  assert.equal(isAway(from, { x_um: 100, y_um: -20 }), false, "a stage without rotation");
});

test("a fine step of the focus goes with the scale, and is never nothing", () => {
  assert.deepEqual([0.05, 0.25, 0.5, 2.2].map(fineStep), [0.5, 1, 2, 9]);
});

test("a step of a run knows where the stage stood, in the units that people read", () => {
  const error = { t_m: [3e-6, 4e-6], theta_rad: Math.PI / 180 };
  const record = { number: 1, time_s: 2, job: 7, from: "procedure", event: "iteration", objective: "10x", error, target_from_view: [[1, 0, 0], [0, 1, 0]], pairs: [], converged: false };
  const seen = (stage: unknown) => follow(EMPTY, { ...record, stage } as EventRecord).steps[0].seenFrom;
  const from = seen({ x: 1e-4, y: -2e-5, z: 0, rz: Math.PI / 60 }) ?? assert.fail("nothing");
  near(from.x_um ?? 0, 100);
  near(from.y_um ?? 0, -20);
  near(from.rz_deg ?? 0, 3);
  assert.equal(seen({ x: 0, y: 0 })?.rz_deg, undefined);
  assert.equal(seen(undefined), null);
});

test("a promise counts in the view of the objective that it was made with", () => {
  const iteration = (objective: string, k: number, promised: unknown): EventRecord => ({
    number: k, time_s: k, job: 1, from: "procedure", event: "iteration", objective, iteration: k, sequence: k, error: { t_m: [1e-6, 0], theta_rad: 0 },
    sigma_px: 0.1, target_from_view: [[1, 0, 0], [0, 1, 0]], inliers: 9, matches: 9, pairs: [], converged: false, promised,
  });
  const promised = { error: { t_m: [2e-6, -3e-6], theta_rad: 0 }, sigma_m: 0.5e-6, sigma_rad: 0 };
  const all = [iteration("10x", 0, null), iteration("10x", 1, promised), iteration("40x", 2, promised), iteration("40x", 3, promised), iteration("40x", 4, null)];
  const { steps } = all.reduce(follow, EMPTY);
  assert.deepEqual(steps.map((s) => s.promised !== null), [false, true, false, true, false]);
  const [x, y] = steps[1].promised?.um ?? [0, 0];
  near(x, 2);
  near(y, -3);
  near(steps[1].promised?.sigmaUm ?? 0, 0.5);
});

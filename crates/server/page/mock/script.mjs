// What a job tells while it works, in the shapes of the program's own events.

const MAP = (scale, deg, tx, ty) => {
  const [c, s] = [scale * Math.cos((deg * Math.PI) / 180), scale * Math.sin((deg * Math.PI) / 180)];
  return [
    [c, -s, tx],
    [s, c, ty],
  ];
};

function iteration(objective, k, { um, deg, map, inliers, matches, sigma_px, converged = false, promised }) {
  const pairs = Array.from({ length: 40 }, (_, n) => [90 + ((n * 37) % 140), 70 + ((n * 53) % 100), (n * 97) % 320, (n * 61) % 240]);
  const error = { t_m: [um * 0.6e-6, um * 0.8e-6], theta_rad: (deg * Math.PI) / 180 };
  const velocity = { t_m: error.t_m.map((v) => -v), theta_rad: -error.theta_rad };
  return { event: "iteration", objective, iteration: k, sequence: 100 + k, error, velocity, target_from_view: map, inliers, matches, sigma_px, pairs, converged, promised };
}

const focus = (objective) => [
  { event: "phase_started", phase: "focus", objective },
  ...[-8, -5, -2, 1, 4, 7].map((z_um) => ({ event: "focus_sample", z_um, sharpness: 0.033 * Math.exp(-((z_um - 2) ** 2) / 18) })),
  { event: "focused", objective, result: { z_um: 2.1, sigma_um: 0.16, sharpness: 0.033, contrast: 36, samples: 6 } },
];

/** Messages and what else the answer says, for each way that a reposition ends. */
export const ENDS = {
  arrived: { reason: "converged", message: "the saved view is back, 0.10 um and 0.0002 deg off by its own measurement", estimated_error_um: 0.097, estimated_error_deg: 0.0002 },
  ambiguous: { reason: "another_place", message: "two places look the same: the other one is 412 um to the left. Bring the right one near by hand, and go back again" },
  not_found: { reason: "not_on_this_slide", message: "the saved view is not on this slide (97 %): 14 views were looked at, none agrees with it" },
  refused: { reason: "out_of_reach", message: "nothing moved: x would have to go to 8412.0 um, and 8000.0 um is the farthest. Put the slide 0.5 mm to the left" },
};

/** Events of a way back. */
export function reposition(verdict) {
  const begin = [{ event: "started", objectives: ["10x", "40x"], target_objective: "40x", engine: "scopeservo-sift 0.1.0", cpu_level: "avx2" }];
  const end = [{ event: "finished", outcome: { verdict, ...ENDS[verdict] } }];
  if (verdict === "refused") return [...begin, ...end];
  const look = [...begin, { event: "phase_started", phase: "switch", objective: "10x" }, ...focus("10x"), { event: "phase_started", phase: "servo", objective: "10x" }];
  if (verdict === "not_found") return [...look, { event: "lost", objective: "10x", iteration: 0, sequence: 100, reason: { code: "too_few" } }, ...end];
  const coarse = iteration("10x", 0, { um: 228, deg: 4.28, map: MAP(4.35, 4.28, -560, -430), inliers: 69, matches: 121, sigma_px: 0.12 });
  if (verdict === "ambiguous") return [...look, coarse, ...end];
  return [
    ...look,
    coarse,
    { event: "phase_started", phase: "switch", objective: "40x" },
    { event: "phase_started", phase: "servo", objective: "40x" },
    iteration("40x", 0, { um: 17.8, deg: 0.005, map: MAP(1, 0, -21, -27), inliers: 1888, matches: 2207, sigma_px: 0.0011 }),
    iteration("40x", 1, { um: 3.8, deg: 0.002, map: MAP(1, 0, 12, 9), inliers: 1902, matches: 2210, sigma_px: 2.5, promised: { error: { t_m: [-4e-6, 1e-6], theta_rad: 0 }, sigma_m: 2e-6, sigma_rad: 0.001 } }),
    iteration("40x", 2, { um: 0.1, deg: 0.0003, map: MAP(1, 0, 0.1, 0.1), inliers: 2151, matches: 2582, sigma_px: 0.001, converged: true, promised: { error: { t_m: [0.4e-6, -0.2e-6], theta_rad: 0 }, sigma_m: 0.5e-6, sigma_rad: 0.0002 } }),
    ...end,
  ];
}

/** Events of other jobs. */
export function others(kind) {
  if (kind === "focus") return focus("40x");
  if (kind === "save_target") return [{ event: "frame_grabbed", sequence: 7, role: "target", objective: "40x" }, { event: "stepped_aside", objective: "40x", step_px: 60, seen_px: 60.1, fixed: 3 }];
  return [];
}

// Where things lie in an image. Pixels are those of the full frame, x to the right and y down.

import type { Affine, Place } from "./types.ts";

export type Point = [number, number];

export function apply(map: Affine, [x, y]: Point): Point {
  return [map[0][0] * x + map[0][1] * y + map[0][2], map[1][0] * x + map[1][1] * y + map[1][2]];
}

/** The inverse; null where the map is flat. */
export function inverse(map: Affine): Affine | null {
  const [[a, b, p], [c, d, q]] = map;
  const det = a * d - b * c;
  if (!(Math.abs(det) > 1e-12)) return null;
  const [ia, ib, ic, id] = [d / det, -b / det, -c / det, a / det];
  return [
    [ia, ib, -(ia * p + ib * q)],
    [ic, id, -(ic * p + id * q)],
  ];
}

/** Corners of a saved view of that size where they lie in the present one. */
export function outline(targetFromView: Affine, width: number, height: number): Point[] | null {
  const viewFromTarget = inverse(targetFromView);
  if (!viewFromTarget) return null;
  const corners: Point[] = [
    [0, 0],
    [width, 0],
    [width, height],
    [0, height],
  ];
  return corners.map((corner) => apply(viewFromTarget, corner));
}

/** Where the middle of a saved view was to come to lie in the present one, by what a move promised: the error that was to be left, pixels of the saved view. */
export function promisedMiddle(targetFromView: Affine, errorPx: Point, viewMiddle: Point): Point | null {
  const viewFromTarget = inverse(targetFromView);
  if (!viewFromTarget) return null;
  const [[a, b], [c, d]] = viewFromTarget;
  return [viewMiddle[0] - a * errorPx[0] - b * errorPx[1], viewMiddle[1] - c * errorPx[0] - d * errorPx[1]];
}

/** Half axes and angle, degrees, of what a circle of the saved view is in the present one: the doubt of a place. */
export function ellipse(targetFromView: Affine, radiusPx: number): { rx: number; ry: number; deg: number } | null {
  const map = inverse(targetFromView);
  if (!map) return null;
  const [[a, b], [c, d]] = map;
  // The covariance of what is mapped, and its principal axes.
  const [xx, xy, yy] = [a * a + b * b, a * c + b * d, c * c + d * d];
  const [middle, half] = [(xx + yy) / 2, Math.hypot((xx - yy) / 2, xy)];
  return {
    rx: radiusPx * Math.sqrt(middle + half),
    ry: radiusPx * Math.sqrt(Math.max(0, middle - half)),
    deg: (Math.atan2(2 * xy, xx - yy) / 2 / Math.PI) * 180,
  };
}

/** How far the map turns, degrees. */
export function turnDeg(map: Affine): number {
  return (Math.atan2(map[1][0] - map[0][1], map[0][0] + map[1][1]) * 180) / Math.PI;
}

/** Whether the stage stands elsewhere: by more than it scatters, 1 um or 0.05 degrees. */
export function isAway(from: Place, at: Place): boolean {
  const by = (a?: number, b?: number) => (a === undefined || b === undefined ? 0 : Math.abs(a - b));
  return Math.hypot(by(from.x_um, at.x_um), by(from.y_um, at.y_um)) > 1 || by(from.rz_deg, at.rz_deg) > 0.05;
}

/** A round length of 1, 2 or 5 that takes about a fifth of the width, um; null where the scale is not known. */
export function scaleBar(umPerPx: number | null, widthPx: number): { um: number; px: number } | null {
  if (!umPerPx || !(umPerPx > 0)) return null;
  const most = (umPerPx * widthPx) / 4;
  const power = 10 ** Math.floor(Math.log10(most));
  const um = [5, 2, 1].map((n) => n * power).find((n) => n <= most) ?? power;
  return { um, px: um / umPerPx };
}

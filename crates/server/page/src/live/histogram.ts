// How bright the image is: how many pixels have which level.

export type Histogram = number[];

const BINS = 64;

/** Shares of the green samples in 64 bins; of every fourth pixel. */
export function histogram(rgba: Uint8ClampedArray): Histogram {
  const bins = new Array<number>(BINS).fill(0);
  let count = 0;
  for (let k = 1; k < rgba.length; k += 16) {
    bins[(rgba[k] * BINS) >> 8] += 1;
    count += 1;
  }
  return bins.map((n) => n / Math.max(1, count));
}

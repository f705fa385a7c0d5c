//! Rows of differences, and the samples in them that beat their 26 neighbours.

use std::ops::Range;

use fearless_simd::{Simd, f32x4, f32x16, prelude::*};

/// Samples that are tested at once.
pub(super) const RUN: usize = 16;

/// Samples whose outcome fits a word.
const WORD: usize = 64;

/// Three rows of the differences of one tile, the finest first: row y of number k begins at `(3 k + y % 3) * stride`.
pub(super) struct Differences<'a> {
    pub(super) data: &'a [f32],
    pub(super) stride: usize,
}

impl<'a> Differences<'a> {
    #[inline(always)]
    pub(super) fn row(&self, layer: usize, y: usize) -> &'a [f32] {
        &self.data[(3 * layer + y % 3) * self.stride..][..self.stride]
    }
}

/// Columns of the extrema in row `y` of the differences `layer` with |DoG| of at least `threshold`, one by one to `hit`.
#[inline(always)]
pub(super) fn scan_row<S: Simd>(
    s: S,
    differences: &Differences<'_>,
    layer: usize,
    y: usize,
    threshold: f32,
    columns: Range<usize>,
    mut hit: impl FnMut(usize),
) {
    let row = |layer: usize, y: usize| differences.row(layer, y);
    let here = row(layer, y);
    let (above, below) = (row(layer, y - 1), row(layer, y + 1));
    let (finer, coarser) = (row(layer - 1, y), row(layer + 1, y));
    let limit = f32x16::splat(s, threshold);
    for first in columns.clone().step_by(WORD) {
        // Most of an image is weak all over or strong here and there; which samples are candidates cannot be foretold, so they
        // are found without a branch.
        let mut strong = run(s, here, first).abs();
        for k in 1..WORD / RUN {
            strong = strong.max(run(s, here, first + k * RUN).abs());
        }
        if !strong.simd_ge(limit).any_true() {
            continue;
        }
        // Strength and the six nearest neighbours: little remains for the rest of the test.
        let mut candidates = 0;
        for k in 0..WORD / RUN {
            let start = first + k * RUN;
            let v = run(s, here, start);
            let sides = (run(s, here, start - 1), run(s, here, start + 1));
            let ends = (run(s, above, start), run(s, below, start));
            let scales = (run(s, finer, start), run(s, coarser, start));
            let most = (sides.0.max(sides.1)).max(ends.0.max(ends.1).max(scales.0.max(scales.1)));
            let least = (sides.0.min(sides.1)).min(ends.0.min(ends.1).min(scales.0.min(scales.1)));
            let candidate = v.abs().simd_ge(limit) & (v.simd_ge(most) | v.simd_le(least));
            candidates |= candidate.to_bitmask() << (k * RUN);
        }
        if columns.end - first < WORD {
            candidates &= (1 << (columns.end - first)) - 1;
        }
        while candidates != 0 {
            let x = first + candidates.trailing_zeros() as usize;
            candidates &= candidates - 1;
            if is_extremum(s, differences, layer, x, y) {
                hit(x);
            }
        }
    }
}

#[inline(always)]
pub(super) fn run<S: Simd>(s: S, row: &[f32], at: usize) -> f32x16<S> {
    f32x16::from_slice(s, &row[at..at + RUN])
}

/// Whether a sample, which is not 0, beats its 26 neighbours; of equal ones the first in scan order does.
#[inline(always)]
fn is_extremum<S: Simd>(
    s: S,
    differences: &Differences<'_>,
    layer: usize,
    x: usize,
    y: usize,
) -> bool {
    // A minimum is a maximum of the negative values. Of four columns the last is none of the neighbours.
    let [left, v, right, _] = cut(differences, layer, y, x);
    let sign = 1.0_f32.copysign(*v);
    let signs = f32x4::from_slice(s, &[sign, sign, sign, 0.0]);
    // The strongest in the row and the layer before, and in those after.
    let mut sides = [f32x4::splat(s, 0.0); 2];
    for (side, (row, beside)) in [(y - 1, layer - 1), (y + 1, layer + 1)]
        .into_iter()
        .enumerate()
    {
        sides[side] = f32x4::from_slice(s, cut(differences, layer, row, x)) * signs;
        for row in y - 1..=y + 1 {
            let values = f32x4::from_slice(s, cut(differences, beside, row, x)) * signs;
            sides[side] = sides[side].max(values);
        }
    }
    let [earlier, later] = sides;
    let v = v.abs();
    let beaten = earlier.simd_lt(f32x4::splat(s, v)) & later.simd_le(f32x4::splat(s, v));
    beaten.all_true() && left * sign < v && right * sign <= v
}

/// The values from column x - 1 to x + 2.
#[inline(always)]
fn cut<'a>(differences: &Differences<'a>, layer: usize, y: usize, x: usize) -> &'a [f32; 4] {
    let row = differences.row(layer, y);
    row[x - 1..x + 3].try_into().expect("four values")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Simd as Token;
    use crate::simd::at_level;

    /// Random rows with many equal values, so that ties come up.
    #[test]
    fn the_scan_finds_what_the_definition_does() {
        let (stride, layers) = (160, 3);
        let mut state = 1_u64;
        let mut next = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            ((state >> 60) as f32 - 7.5) / 8.0
        };
        let mut total = 0;
        for round in 0..200 {
            let mut data: Vec<f32> = (0..layers * 3 * stride).map(|_| 0.4 * next()).collect();
            // Some that stand out.
            for _ in 0..8 {
                let x = 1 + (next().abs() * 80.0) as usize;
                data[(3 + 1) * stride + x] = next().signum();
            }
            let rows = Differences {
                data: &data,
                stride,
            };
            let at = |layer: usize, y: usize, x: usize| data[(3 * layer + y) * stride + x];
            let (begin, end) = (1 + round % 7, 60 + round % 19);
            let expected: Vec<usize> = (begin..end)
                .filter(|&x| {
                    let v = at(1, 1, x);
                    let beats = |layer: usize, y: usize, i: usize| {
                        // The sample itself, earlier ones strictly, later ones not; the order is that of `is_extremum`.
                        let n = at(layer, y, x + i - 1);
                        let earlier = layer == 0 || (layer == 1 && (y == 0 || (y == 1 && i == 0)));
                        match (layer, y, i) {
                            (1, 1, 1) => true,
                            _ if v > 0.0 => v > n || (!earlier && v == n),
                            _ => v < n || (!earlier && v == n),
                        }
                    };
                    v.abs() >= 0.25 && (0..27).all(|k| beats(k / 9, k / 3 % 3, k % 3))
                })
                .collect();
            total += expected.len();
            for simd in Token::available() {
                let mut found = Vec::new();
                at_level!(simd, s => scan_row(s, &rows, 1, 1, 0.25, begin..end, |x| found.push(x)));
                assert_eq!(found, expected, "{round}");
            }
        }
        assert!(total > 100, "{total}");
    }
}

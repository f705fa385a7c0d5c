//! Gaussian blur of rows: one pass down the columns, one along the row.
//!
//! Both passes work on [`BLOCK`] columns at a time with their sums in registers. Cost for a radius r, per pixel: `2 r + 1`
//! multiply-adds down and `r + 1` multiply-adds and r additions along.

use fearless_simd::{Simd, f32x16, prelude::*};

/// Columns per step of a pass: rows are computed in whole blocks, so buffers have this much room at their end.
pub(crate) const BLOCK: usize = 32;

/// A symmetric kernel with sum 1.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Kernel {
    /// `weights[radius + i]` is the weight at distance i.
    weights: Vec<f32>,
}

impl Kernel {
    /// Gaussian, cut at 4 sigma (what is cut away is 6e-5 of the whole).
    pub(crate) fn gaussian(sigma: f64) -> Self {
        let radius = (4.0 * sigma).ceil().max(1.0) as isize;
        let weights: Vec<f64> = (-radius..=radius)
            .map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp())
            .collect();
        let sum: f64 = weights.iter().sum();
        Self {
            weights: weights.into_iter().map(|v| (v / sum) as f32).collect(),
        }
    }

    pub(crate) fn radius(&self) -> usize {
        self.weights.len() / 2
    }
}

/// Index in `0..n` of position `i` in a line of n pixels mirrored about its end pixels (`d c b | a b c d | c b a`).
pub(crate) fn mirrored(i: isize, n: usize) -> usize {
    if n == 1 {
        return 0;
    }
    let period = 2 * (n as isize - 1);
    let i = i.rem_euclid(period);
    i.min(period - i) as usize
}

/// [`BLOCK`] values from `at` on.
#[inline(always)]
fn block<S: Simd>(s: S, data: &[f32], at: usize) -> [f32x16<S>; 2] {
    let block = &data[at..][..BLOCK];
    [
        f32x16::from_slice(s, &block[..16]),
        f32x16::from_slice(s, &block[16..]),
    ]
}

#[inline(always)]
fn store<S: Simd>(values: [f32x16<S>; 2], out: &mut [f32], at: usize) {
    let out = &mut out[at..][..BLOCK];
    values[0].store_slice(&mut out[..16]);
    values[1].store_slice(&mut out[16..]);
}

/// Two rows blurred down the columns, `width` columns rounded up to whole blocks.
///
/// `starts[i]` is where in `data` the row at distance `i - radius` from the first one begins; there are `2 radius + 2` of them,
/// the last one only used by the second row. Each row that is loaded serves both sums.
#[inline(always)]
pub(crate) fn down<S: Simd>(
    s: S,
    kernel: &Kernel,
    data: &[f32],
    starts: &[usize],
    width: usize,
    first: &mut [f32],
    second: &mut [f32],
) {
    let weights = &kernel.weights[..];
    let taps = weights.len();
    let starts = &starts[..=taps];
    for x in (0..width).step_by(BLOCK) {
        let v = block(s, data, starts[0] + x);
        let weight = f32x16::splat(s, weights[0]);
        let mut a = [v[0] * weight, v[1] * weight];
        let mut b = [f32x16::splat(s, 0.0); 2];
        for i in 1..taps {
            let v = block(s, data, starts[i] + x);
            let (wa, wb) = (
                f32x16::splat(s, weights[i]),
                f32x16::splat(s, weights[i - 1]),
            );
            for k in 0..2 {
                a[k] = v[k].mul_add(wa, a[k]);
                b[k] = v[k].mul_add(wb, b[k]);
            }
        }
        let v = block(s, data, starts[taps] + x);
        let last = f32x16::splat(s, weights[taps - 1]);
        for k in 0..2 {
            b[k] = v[k].mul_add(last, b[k]);
        }
        store(a, first, x);
        store(b, second, x);
    }
}

/// A row blurred along itself: `out[x]` from `padded[x..=x + 2 radius]`, `width` columns rounded up to whole blocks.
#[inline(always)]
pub(crate) fn along<S: Simd>(s: S, kernel: &Kernel, padded: &[f32], width: usize, out: &mut [f32]) {
    let r = kernel.radius();
    let half = &kernel.weights[r..];
    for x in (0..width).step_by(BLOCK) {
        let centre = block(s, padded, x + r);
        let weight = f32x16::splat(s, half[0]);
        let mut sum = [centre[0] * weight, centre[1] * weight];
        for i in 1..=r {
            let (left, right) = (block(s, padded, x + r - i), block(s, padded, x + r + i));
            let w = f32x16::splat(s, half[i]);
            for k in 0..2 {
                sum[k] = (left[k] + right[k]).mul_add(w, sum[k]);
            }
        }
        store(sum, out, x);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirror_repeats_no_border_pixel() {
        let line: Vec<usize> = (-4..8).map(|i| mirrored(i, 4)).collect();
        assert_eq!(line, [2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1]);
        assert_eq!(mirrored(-3, 1), 0);
    }

    #[test]
    fn a_kernel_is_symmetric_with_sum_1() {
        for sigma in [0.2, 1.2, 3.1, 20.0] {
            let k = Kernel::gaussian(sigma);
            assert_eq!(k.weights.len(), 2 * k.radius() + 1);
            assert!((k.weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
            assert!(k.weights.iter().eq(k.weights.iter().rev()));
        }
    }
}

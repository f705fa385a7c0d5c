//! Differences around a place, at samples and between them.

use fearless_simd::{Simd, f32x8, prelude::*};

use super::quadratic::Cube;
use crate::scale_space::Levels;
use crate::simd::sum;

/// Differences around a sample, from the Gaussian levels of a tile.
pub(super) struct Neighbourhood<'a> {
    pub(super) levels: &'a Levels<'a>,
    pub(super) base: usize,
}

impl Neighbourhood<'_> {
    /// Row `y` of a level of the chain, from column `x` on.
    #[inline(always)]
    fn gaussian(&self, level: usize, x: usize, y: usize) -> &[f32] {
        &self.levels.row(level, y)[x - self.levels.origin..]
    }

    /// The neighbourhood of a sample.
    #[inline(always)]
    pub(super) fn cube_at(&self, layer: usize, x: usize, y: usize) -> Cube {
        let mut cube = [[[0.0; 3]; 3]; 3];
        for j in 0..3 {
            let row = |k: usize| &self.gaussian(self.base + layer + k - 1, x - 1, y + j - 1)[..3];
            let mut fine = row(0);
            for (k, cube) in cube.iter_mut().enumerate() {
                let coarse = row(k + 1);
                for i in 0..3 {
                    cube[j][i] = f64::from(coarse[i] - fine[i]);
                }
                fine = coarse;
            }
        }
        cube
    }

    /// The neighbourhood of a place between samples, at least 4 pixels from the border.
    #[inline(always)]
    pub(super) fn cube_between<S: Simd>(&self, s: S, layer: usize, x: f64, y: f64) -> Cube {
        let (x0, y0) = (x.floor(), y.floor());
        let (wx, wy) = (lagrange(x - x0), lagrange(y - y0));
        let (left, top) = (x0 as usize - 3, y0 as usize - 3);
        // Weights of the eight columns for the values at x - 1, x, x + 1.
        let mut columns = [f32x8::splat(s, 0.0); 3];
        for (i, column) in columns.iter_mut().enumerate() {
            let mut shifted = [0.0; 8];
            shifted[i..i + 6].copy_from_slice(&wx);
            *column = f32x8::from_slice(s, &shifted);
        }
        // Each Gaussian interpolated down the columns at y - 1, y, y + 1, eight columns wide.
        let mut finer = [f32x8::splat(s, 0.0); 3];
        let mut cube = [[[0.0; 3]; 3]; 3];
        for k in 0..4 {
            let mut values = [f32x8::splat(s, 0.0); 3];
            for j in 0..8 {
                let row = f32x8::from_slice(
                    s,
                    &self.gaussian(self.base + layer + k - 1, left, top + j)[..8],
                );
                for (i, value) in values.iter_mut().enumerate() {
                    if (i..i + 6).contains(&j) {
                        *value = row.mul_add(f32x8::splat(s, wy[j - i]), *value);
                    }
                }
            }
            if k > 0 {
                for j in 0..3 {
                    let difference = values[j] - finer[j];
                    for i in 0..3 {
                        cube[k - 1][j][i] = f64::from(sum(difference * columns[i]));
                    }
                }
            }
            finer = values;
        }
        cube
    }
}

/// Weights of the six samples -2..=3 for the value at `t` in 0..1 (Lagrange, exact for polynomials of degree 5).
#[inline(always)]
fn lagrange(t: f64) -> [f32; 6] {
    const DENOMINATORS: [f64; 6] = [-120.0, 24.0, -12.0, 12.0, -24.0, 120.0];
    // Products of the distances to all samples before, then to all after.
    let mut weights = [1.0; 6];
    let mut before = 1.0;
    for (i, weight) in weights.iter_mut().enumerate() {
        *weight = before;
        before *= t + 2.0 - i as f64;
    }
    let (mut after, mut out) = (1.0, [0.0; 6]);
    for i in (0..6).rev() {
        out[i] = (weights[i] * after / DENOMINATORS[i]) as f32;
        after *= t + 2.0 - i as f64;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lagrange_reproduces_polynomials_of_degree_5() {
        let p = |x: f64| 1.0 + x * (2.0 + x * (-1.0 + x * (0.5 + x * (0.25 - 0.125 * x))));
        for t in [0.0, 0.25, 0.5, 0.999] {
            let value: f64 = lagrange(t)
                .iter()
                .enumerate()
                .map(|(i, w)| f64::from(*w) * p(i as f64 - 2.0))
                .sum();
            assert!((value - p(t)).abs() < 1e-5);
        }
    }
}

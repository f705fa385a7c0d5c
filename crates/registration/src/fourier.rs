//! Transforms of planes of complex numbers, with buffers that the caller keeps: nothing is allocated after the plan is made.

use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// What planes are made of.
pub(crate) type C32 = Complex<f32>;

/// Tiles of this side are turned over at a time, so that both sides of a transposition stay in the cache.
const TILE: usize = 16;

/// The least number from `n` on that has no prime factor but 2, 3 and 5, which transforms are fastest at.
pub(crate) fn smooth_size(n: usize) -> usize {
    let smooth = |mut k: usize| {
        for factor in [2, 3, 5] {
            while k.is_multiple_of(factor) {
                k /= factor;
            }
        }
        k == 1
    };
    (n.max(1)..).find(|&k| smooth(k)).unwrap_or(n)
}

/// Transforms of planes of one size.
pub(crate) struct Fourier {
    /// Columns and rows.
    pub(crate) size: [usize; 2],
    rows: [Arc<dyn Fft<f32>>; 2],
    columns: [Arc<dyn Fft<f32>>; 2],
}

impl Fourier {
    pub(crate) fn new(size: [usize; 2]) -> Self {
        let mut planner = FftPlanner::new();
        let mut both = |n| [planner.plan_fft_forward(n), planner.plan_fft_inverse(n)];
        Self {
            size,
            rows: both(size[0]),
            columns: both(size[1]),
        }
    }

    /// Numbers in a plane.
    pub(crate) fn len(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// A plane of zeros.
    pub(crate) fn plane(&self) -> Vec<C32> {
        vec![C32::default(); self.len()]
    }

    /// What a transform needs beside both planes.
    pub(crate) fn scratch(&self) -> Vec<C32> {
        let all = self.rows.iter().chain(&self.columns);
        let most = all.map(|f| f.get_inplace_scratch_len()).max();
        vec![C32::default(); most.unwrap_or(0)]
    }

    /// From a plane, row by row, to its spectrum, column by column. The plane is used up.
    pub(crate) fn forward(&self, plane: &mut [C32], spectrum: &mut [C32], scratch: &mut [C32]) {
        let [width, height] = self.size;
        for row in plane.chunks_exact_mut(width) {
            // A row of nothing stays one.
            if row.iter().any(|v| *v != C32::default()) {
                self.rows[0].process_with_scratch(row, scratch);
            }
        }
        transpose(plane, spectrum, width, height);
        self.columns[0].process_with_scratch(spectrum, scratch);
    }

    /// Back; the spectrum is used up. Not divided by the number of values.
    pub(crate) fn inverse(&self, spectrum: &mut [C32], plane: &mut [C32], scratch: &mut [C32]) {
        let [width, height] = self.size;
        self.columns[1].process_with_scratch(spectrum, scratch);
        transpose(spectrum, plane, height, width);
        self.rows[1].process_with_scratch(plane, scratch);
    }
}

/// Rows of `from`, `width` long, become columns of `to`.
fn transpose(from: &[C32], to: &mut [C32], width: usize, height: usize) {
    for y0 in (0..height).step_by(TILE) {
        for x0 in (0..width).step_by(TILE) {
            for x in x0..(x0 + TILE).min(width) {
                for y in y0..(y0 + TILE).min(height) {
                    to[x * height + y] = from[y * width + x];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::SplitMix64;

    #[test]
    fn sizes_are_the_next_smooth_ones() {
        let sizes: Vec<usize> = [0, 1, 7, 11, 121, 290, 361].map(smooth_size).into();
        assert_eq!(sizes, [1, 1, 8, 12, 125, 300, 375]);
    }

    #[test]
    fn a_plane_comes_back_and_its_spectrum_is_the_sum_of_waves() {
        let fourier = Fourier::new([20, 18]);
        let mut rng = SplitMix64::new(3);
        let given: Vec<C32> = (0..360)
            .map(|_| C32::new(rng.normal() as f32, rng.normal() as f32))
            .collect();
        let (mut plane, mut spectrum) = (given.clone(), fourier.plane());
        let mut scratch = fourier.scratch();
        fourier.forward(&mut plane, &mut spectrum, &mut scratch);
        let [u, v] = [3, 5];
        let wave = |i: usize| {
            let (x, y) = ((i % 20) as f32, (i / 20) as f32);
            let turns = u as f32 * x / 20.0 + v as f32 * y / 18.0;
            C32::from_polar(1.0, -std::f32::consts::TAU * turns)
        };
        let sum: C32 = given.iter().enumerate().map(|(i, g)| g * wave(i)).sum();
        assert!((spectrum[u * 18 + v] - sum).norm() < 1e-3);
        fourier.inverse(&mut spectrum, &mut plane, &mut scratch);
        for (a, b) in plane.iter().zip(&given) {
            assert!((a / 360.0 - b).norm() < 1e-5);
        }
    }
}

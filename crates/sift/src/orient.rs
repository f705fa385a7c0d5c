//! Dominant gradient directions of a keypoint (Lowe, IJCV 2004, section 5).
//!
//! A histogram of 36 directions over a disc of radius 4.5 sigma, weighted by gradient magnitude and a Gaussian of 1.5 sigma
//! around the refined position, in the layer after the keypoint's own (see [`crate::describe`]). Votes are shared between the two nearest bins; the histogram is smoothed, and each peak of at
//! least 0.8 of the highest gives an orientation, interpolated by a parabola.

use std::f32::consts::{PI, TAU};

use fearless_simd::{Simd, f32x8, i32x8, prelude::*};

use crate::gradient::{angle, exp};
use crate::scale_space::Plane;

const BINS: usize = 36;

/// Standard deviation of the window in units of the keypoint's sigma.
const WINDOW: f32 = 1.5;

/// Radius of the disc in units of the window.
const RADIUS: f32 = 3.0;

/// Least height of a further peak, relative to the highest.
const PEAK: f32 = 0.8;

/// Most peaks that 36 bins can have.
const MAX_PEAKS: usize = BINS / 2;

/// Orientations of one keypoint, the most pronounced first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Orientations {
    angles: [f32; MAX_PEAKS],
    count: usize,
}

impl std::ops::Deref for Orientations {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.angles[..self.count]
    }
}

/// Orientations of the keypoint at (x, y) with scale sigma, all in pixels of `plane`: radians from +x towards +y in
/// `(-pi, pi]`; none when there is no gradient at all.
#[inline(always)]
pub(crate) fn orientations<S: Simd>(s: S, plane: &Plane, [x, y, sigma]: [f32; 3]) -> Orientations {
    peaks(&smoothed(&histogram(s, plane, x, y, sigma)))
}

/// Copies of the histogram, so that neighbouring pixels, which point the same way, need not wait for each other.
const COPIES: usize = 4;

/// Room for the bins of a copy and the neighbour of the last one.
const SLOTS: usize = 64;

/// Gradients that are kept until they vote together.
const GATHERED: usize = 128;

/// Gradients in the disc: their magnitudes, as they count, and directions in bins.
struct Gradients {
    magnitudes: [f32; GATHERED + 8],
    places: [f32; GATHERED + 8],
    count: usize,
}

impl Gradients {
    /// Adds the first `count` of eight.
    #[inline(always)]
    fn add<S: Simd>(&mut self, magnitudes: f32x8<S>, places: f32x8<S>, count: usize) {
        // The rest is overwritten by the next ones: rows of a disc are short, and seldom a multiple of eight.
        magnitudes.store_slice(&mut self.magnitudes[self.count..self.count + 8]);
        places.store_slice(&mut self.places[self.count..self.count + 8]);
        self.count += count;
    }

    /// Each votes for its two nearest bins; then there are none.
    #[inline(always)]
    fn vote<S: Simd>(&mut self, s: S, votes: &mut [[f32; SLOTS]; COPIES]) {
        // Up to a multiple of eight, with some that count nothing.
        self.magnitudes[self.count..self.count + 8].fill(0.0);
        self.places[self.count..self.count + 8].fill(0.0);
        for at in (0..self.count).step_by(8) {
            let magnitude = f32x8::from_slice(s, &self.magnitudes[at..at + 8]);
            let place = f32x8::from_slice(s, &self.places[at..at + 8]);
            let bin: i32x8<S> = place.to_int();
            let second = magnitude * (place - place.floor());
            let first = (magnitude - second).to_array();
            let (bin, second) = (bin.to_array(), second.to_array());
            for i in 0..8 {
                let votes = &mut votes[i % COPIES];
                let bin = bin[i] as usize % SLOTS;
                votes[bin] += first[i];
                votes[(bin + 1) % SLOTS] += second[i];
            }
        }
        self.count = 0;
    }
}

/// Bin k holds the votes for direction `2 pi k / 36`.
#[inline(always)]
fn histogram<S: Simd>(s: S, plane: &Plane, x: f32, y: f32, sigma: f32) -> [f32; BINS] {
    let mut votes = [[0.0_f32; SLOTS]; COPIES];
    let window = WINDOW * sigma;
    let radius = RADIUS * window;
    let falloff = -0.5 / (window * window);
    // Pixels with four neighbours in the plane, and in the square around the disc.
    let first = |p: f32| (p - radius).ceil().max(1.0) as usize;
    let last =
        |p: f32, size: usize| ((p + radius).floor().min(size as f32 - 2.0)).max(0.0) as usize;
    let (left, right) = (first(x), last(x, plane.width));
    let (top, bottom) = (first(y), last(y, plane.height));
    plane.touch(left - 1..right + 2, top - 1..bottom + 2);
    let lanes = f32x8::from_slice(s, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    let mut gradients = Gradients {
        magnitudes: [0.0; GATHERED + 8],
        places: [0.0; GATHERED + 8],
        count: 0,
    };
    for row in top..=bottom {
        let dy = row as f32 - y;
        let half = (radius * radius - dy * dy).max(0.0).sqrt();
        let begin = ((x - half).ceil().max(left as f32)) as usize;
        let end = ((x + half).floor().min(right as f32) + 1.0).max(0.0) as usize;
        let rows = [row - 1, row, row + 1].map(|y| plane.row(y));
        for start in (begin..end).step_by(8) {
            let count = (end - start).min(8);
            let (gx, gy) = if start + 9 <= plane.width {
                let [above, here, below] = rows;
                let eight = |row: &[f32], at: usize| f32x8::from_slice(s, &row[at..at + 8]);
                (
                    eight(here, start + 1) - eight(here, start - 1),
                    eight(below, start) - eight(above, start),
                )
            } else {
                let (mut gx, mut gy) = ([0.0; 8], [0.0; 8]);
                for i in 0..count {
                    let at = start + i;
                    gx[i] = rows[1][at + 1] - rows[1][at - 1];
                    gy[i] = rows[2][at] - rows[0][at];
                }
                (f32x8::from_slice(s, &gx), f32x8::from_slice(s, &gy))
            };
            let dx = lanes + (start as f32 - x);
            let distance_sq = dx
                .mul_add(dx, f32x8::splat(s, dy * dy))
                .min(f32x8::splat(s, radius * radius));
            let magnitude = (gx * gx + gy * gy).sqrt() * exp(s, distance_sq * falloff);
            let place = angle(s, gx, gy) * (BINS as f32 / TAU);
            gradients.add(magnitude, place, count);
            if gradients.count > GATHERED - 8 {
                gradients.vote(s, &mut votes);
            }
        }
    }
    gradients.vote(s, &mut votes);
    let mut histogram = [0.0; BINS];
    for votes in &votes {
        // 2 pi itself is bin 36, and votes beyond it go to bin 37.
        for (i, v) in votes[..BINS + 2].iter().enumerate() {
            histogram[i % BINS] += v;
        }
    }
    histogram
}

/// A circle of bins with the last two before the first and the first two after the last.
#[inline(always)]
fn unrolled(h: &[f32; BINS]) -> [f32; BINS + 4] {
    let mut line = [0.0; BINS + 4];
    line[..2].copy_from_slice(&h[BINS - 2..]);
    line[2..BINS + 2].copy_from_slice(h);
    line[BINS + 2..].copy_from_slice(&h[..2]);
    line
}

/// Circular smoothing with (1 4 6 4 1) / 16.
#[inline(always)]
fn smoothed(h: &[f32; BINS]) -> [f32; BINS] {
    let line = unrolled(h);
    let mut smooth = [0.0; BINS];
    for (i, smooth) in smooth.iter_mut().enumerate() {
        let [a, b, c, d, e] = [line[i], line[i + 1], line[i + 2], line[i + 3], line[i + 4]];
        *smooth = (a + e) / 16.0 + (b + d) / 4.0 + c * 0.375;
    }
    smooth
}

#[inline(always)]
fn peaks(h: &[f32; BINS]) -> Orientations {
    let line = unrolled(h);
    let mut found = [(0.0, 0.0); MAX_PEAKS];
    let mut count = 0;
    let highest = h.iter().fold(0.0_f32, |a, &b| if b > a { b } else { a });
    // Few bins are high, and none when there is no gradient.
    let least = if highest > 0.0 {
        PEAK * highest
    } else {
        f32::INFINITY
    };
    for i in 0..BINS {
        let (before, here, after) = (line[i + 1], h[i], line[i + 3]);
        // Of two equal neighbours the first counts, and the parabola puts the peak between them.
        let peak = here >= least && here > before && here >= after;
        if !peak {
            continue;
        }
        let offset = 0.5 * (before - after) / (before - 2.0 * here + after);
        let angle = (i as f32 + offset) * (TAU / BINS as f32);
        let angle = if angle > PI { angle - TAU } else { angle };
        found[count] = (here, angle.clamp(-PI.next_down(), PI));
        count += 1;
    }
    found[..count].sort_by(|a, b| b.0.total_cmp(&a.0));
    Orientations {
        angles: found.map(|(_, angle)| angle),
        count,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Simd as Token;
    use crate::simd::at_level;

    /// At the best level, after a look whether the others agree.
    fn orientations(plane: &Plane, x: f32, y: f32, sigma: f32) -> Vec<f32> {
        let all: Vec<Vec<f32>> = Token::available()
            .map(|token| at_level!(token, s => super::orientations(s, plane, [x, y, sigma]).to_vec()))
            .collect();
        for found in &all {
            assert_eq!(found.len(), all[0].len());
            for (a, b) in found.iter().zip(&all[0]) {
                assert!(difference(*a, *b) < 1e-4, "{all:?}");
            }
        }
        all[all.len() - 1].clone()
    }

    fn difference(a: f32, b: f32) -> f32 {
        let d = (a - b).rem_euclid(2.0 * PI);
        d.min(2.0 * PI - d)
    }

    #[test]
    fn a_ramp_has_the_direction_of_its_slope() {
        for k in 0..50 {
            let truth = k as f32 * 0.1257 - PI + 0.01;
            let (s, c) = truth.sin_cos();
            let plane = Plane {
                width: 40,
                height: 40,
                pitch: 1,
                data: (0..1600)
                    .map(|i| c * (i % 40) as f32 + s * (i / 40) as f32)
                    .collect(),
            };
            let found = orientations(&plane, 20.3, 19.6, 1.8);
            assert_eq!(found.len(), 1, "{truth}: {found:?}");
            // A single direction is the sharpest peak and the parabola's worst case.
            assert!(difference(found[0], truth) < 0.015, "{truth} {found:?}");
            assert!(found[0] > -PI && found[0] <= PI);
        }
    }

    #[test]
    fn two_slopes_give_two_orientations() {
        let data = (0..1600)
            .map(|i| ((i % 40) as f32 - 20.0).abs() + 0.001 * (i / 40) as f32)
            .collect();
        let plane = Plane {
            width: 40,
            height: 40,
            pitch: 1,
            data,
        };
        let found = orientations(&plane, 20.0, 20.0, 1.8);
        assert_eq!(found.len(), 2, "{found:?}");
    }

    #[test]
    fn no_gradient_no_orientation() {
        let plane = Plane {
            width: 20,
            height: 20,
            pitch: 1,
            data: vec![0.5; 400],
        };
        assert!(orientations(&plane, 10.0, 10.0, 2.0).is_empty());
    }

    #[test]
    fn a_window_over_the_border_is_cut() {
        let plane = Plane {
            width: 12,
            height: 12,
            pitch: 1,
            data: (0..144).map(|i| (i % 12) as f32).collect(),
        };
        assert_eq!(orientations(&plane, 5.0, 6.9, 3.6).len(), 1);
        assert_eq!(orientations(&plane, 0.0, 11.0, 3.6).len(), 1);
    }
}

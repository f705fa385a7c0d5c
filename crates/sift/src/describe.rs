//! The descriptor: 4 x 4 places x 8 directions of gradient around a keypoint (Lowe, IJCV 2004, section 6), as RootSIFT
//! (Arandjelovic & Zisserman, CVPR 2012, section 3).
//!
//! A place is 3.4 sigma wide, the Gaussian window 6.8 sigma (half the width of the descriptor), both in the frame turned by the
//! keypoint's angle and centred on the refined position. The surroundings are sampled on a grid in that frame, 1.2 sigma apart;
//! gradients are differences on the grid. Each gradient votes trilinearly for the 8 nearest cells. On a fixed grid the shares of
//! places are constants, so that no vote needs an address: every step is the same for eight samples at once, and the cost does not
//! grow with the scale.
//!
//! Lowe takes the Gaussian layer next to the keypoint's scale. Here it is the one after that, blurred by 1.26 sigma: what is
//! sampled 1.2 sigma apart need not be sharper, and of the octave with the most pixels only layers remain that every second pixel
//! of every second row holds. Places of 3 sigma, as Lowe has them, then tell fewer pairs apart (measured on the pairs of
//! docs/sift-accuracy.md).

use std::f32::consts::TAU;

use fearless_simd::{Simd, f32x8, f64x4, i32x8, prelude::*};

use crate::descriptor::{Descriptor, finish};
use crate::gradient::angle;
use crate::scale_space::Plane;

/// Places per side.
const PLACES: usize = 4;

/// Directions per place.
const DIRECTIONS: usize = 8;

/// Width of a place in units of the keypoint's sigma.
const PLACE_WIDTH: f32 = 3.4;

/// Descriptor of the keypoint at (x, y) with scale sigma, all in pixels of `plane`, turned by `angle` radians. `patch` is
/// overwritten.
#[inline(always)]
pub(crate) fn describe<S: Simd>(
    s: S,
    weights: &Weights,
    patch: &mut Patch,
    plane: &Plane,
    [x, y, sigma]: [f32; 3],
    angle: f32,
) -> Descriptor {
    patch.sample(s, plane, x, y, sigma, angle);
    finish(s, &patch.histogram(s, weights))
}

/// Samples per side that vote.
const SAMPLES: usize = 14;

/// Samples per side, with one around for the gradients.
const SIDE: usize = SAMPLES + 2;

/// Floats per row of samples: what a vector reads beyond the last one counts nothing.
const STRIDE: usize = SIDE + 8;

/// Vectors of eight that hold a row.
const VECTORS: usize = SIDE / 8;

/// Distance of samples in places: the grid spans the four places and half a place around them.
const SPACING: f32 = (PLACES + 1) as f32 / SAMPLES as f32;

/// Position of sample i of the voting ones in places, from the centre.
fn position(i: usize) -> f32 {
    (i as f32 + 0.5) * SPACING - 0.5 * (PLACES + 1) as f32
}

/// How much a row or column of samples counts for a row or column of places: the share by distance times the Gaussian window.
#[derive(Debug, Clone)]
pub(crate) struct Weights {
    /// For each row of samples the first of the two rows of places it lies between (0 is one before the first), and the
    /// weights for both.
    rows: [(usize, f32, f32); SAMPLES],
    /// For each column of places the weights of the columns of samples.
    columns: [[f32; VECTORS * 8]; PLACES],
}

impl Weights {
    pub(crate) fn new() -> Self {
        let half = 0.5 * PLACES as f32;
        let window = |i: usize| (-0.5 * (position(i) / half).powi(2)).exp();
        let rows = std::array::from_fn(|i| {
            let place = position(i) + half + 0.5;
            let share = place.fract();
            (place as usize, window(i) * (1.0 - share), window(i) * share)
        });
        let columns = std::array::from_fn(|c| {
            std::array::from_fn(|i| {
                let distance = position(i) + half - 0.5 - c as f32;
                let share = (1.0 - distance.abs()).max(0.0);
                if i < SAMPLES { window(i) * share } else { 0.0 }
            })
        });
        Self { rows, columns }
    }
}

/// The sum of each vector's lanes: of neighbours first, all eight vectors at once.
#[inline(always)]
fn totals<S: Simd>([a, b, c, d, e, f, g, h]: [f32x8<S>; 8]) -> f32x8<S> {
    let (a, b, c, d) = (pairs(a, b), pairs(c, d), pairs(e, f), pairs(g, h));
    pairs(pairs(a, b), pairs(c, d))
}

/// The sums of neighbours in `a`, then of those in `b`.
#[inline(always)]
fn pairs<S: Simd>(a: f32x8<S>, b: f32x8<S>) -> f32x8<S> {
    let (even, odd) = a.deinterleave(b);
    even + odd
}

/// A value and the next one, side by side.
///
/// # Safety
/// `at + 2 <= data.len()`.
#[inline(always)]
#[expect(
    unsafe_code,
    reason = "a descriptor takes 512 pairs, and eight samples are tested at once"
)]
unsafe fn pair(data: &[f32], at: usize) -> f64 {
    let pair = if cfg!(debug_assertions) {
        &data[at..at + 2]
    } else {
        // SAFETY: the caller's promise.
        unsafe { data.get_unchecked(at..at + 2) }
    };
    // SAFETY: eight bytes that are there, of whatever alignment; any are a number.
    unsafe { pair.as_ptr().cast::<f64>().read_unaligned() }
}

/// The surroundings of a keypoint in its own frame: row j, column i at `SPACING * (i - 11.5, j - 11.5)` places.
#[derive(Debug)]
pub(crate) struct Patch {
    values: [[f32; STRIDE]; SIDE],
    /// Whether samples may lie outside the image, and then: 1 where one lies inside, 0 where not.
    is_cut: bool,
    inside: [[f32; STRIDE]; SIDE],
}

impl Patch {
    pub(crate) fn new() -> Self {
        Self {
            values: [[0.0; STRIDE]; SIDE],
            is_cut: false,
            inside: [[0.0; STRIDE]; SIDE],
        }
    }

    #[inline(always)]
    fn sample<S: Simd>(&mut self, s: S, plane: &Plane, x: f32, y: f32, sigma: f32, angle: f32) {
        let spacing = SPACING * PLACE_WIDTH * sigma;
        let (sin, cos) = angle.sin_cos();
        let (sin, cos) = (sin * spacing, cos * spacing);
        let centre = 0.5 * (SIDE - 1) as f32;
        let reach = centre * (sin.abs() + cos.abs()) + 1.0;
        let fits = |p: f32, size: usize| p - reach >= 0.0 && p + reach <= size as f32 - 1.0;
        self.is_cut = !(fits(x, plane.width) && fits(y, plane.height));
        if self.is_cut {
            self.rows::<S, true>(s, plane, [x, y], reach, [cos, sin]);
        } else {
            self.rows::<S, false>(s, plane, [x, y], reach, [cos, sin]);
        }
    }

    /// Bilinear samples; with `CLAMP` those outside the plane take the value at its border.
    #[inline(always)]
    #[expect(unsafe_code, reason = "see `pair`")]
    fn rows<S: Simd, const CLAMP: bool>(
        &mut self,
        s: S,
        plane: &Plane,
        [x, y]: [f32; 2],
        reach: f32,
        [cos, sin]: [f32; 2],
    ) {
        let Self { values, inside, .. } = self;
        let w = plane.width;
        let most = [w, plane.height].map(|n| f32x8::splat(s, n as f32 - 1.0));
        let least = f32x8::splat(s, 0.0);
        let centre = 0.5 * (SIDE - 1) as f32;
        let lanes = f32x8::from_slice(s, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        // Offsets from a row near the keypoint fit 32 bits in any image.
        let first_row = (y - reach).floor().clamp(0.0, plane.height as f32 - 2.0);
        let data = &plane.data[first_row as usize * w..];
        let near = |p: f32| (p - reach).max(0.0) as usize..(p + reach + 2.0).max(0.0) as usize;
        plane.touch(near(x), near(y));
        for j in 0..SIDE {
            let v = j as f32 - centre;
            let (row_x, row_y) = (x - sin * v, y + cos * v);
            for k in 0..VECTORS {
                let u = lanes + (8.0 * k as f32 - centre);
                let mut px = u.mul_add(f32x8::splat(s, cos), f32x8::splat(s, row_x));
                let mut py = u.mul_add(f32x8::splat(s, sin), f32x8::splat(s, row_y));
                if CLAMP {
                    let (cx, cy) = (px.max(least).min(most[0]), py.max(least).min(most[1]));
                    let within = px.simd_eq(cx) & py.simd_eq(cy);
                    let one = f32x8::splat(s, 1.0);
                    within
                        .select(one, least)
                        .store_slice(&mut inside[j][8 * k..8 * k + 8]);
                    (px, py) = (cx, cy);
                }
                let (mut x0, mut y0) = (px.floor(), py.floor());
                if CLAMP {
                    // The last pixel is reached from the one before.
                    (x0, y0) = (x0.min(most[0] - 1.0), y0.min(most[1] - 1.0));
                }
                let (fx, fy) = (px - x0, py - y0);
                let at: i32x8<S> = x0.to_int();
                let row: i32x8<S> = (y0 - first_row).to_int();
                let at = at + row * w as i32;
                // One test for all: no sample reads outside.
                let last = (data.len() - w - 2).min(i32::MAX as usize) as i32;
                let off = at.simd_lt(i32x8::splat(s, 0)) | at.simd_gt(i32x8::splat(s, last));
                assert!(!off.any_true(), "samples lie in the plane");
                let at = at.to_array();
                // Pairs of neighbours: pixel and right neighbour of the upper row, then of the lower one. They go through
                // registers: memory that was written in pairs cannot be read at once as vectors.
                // SAFETY: tested above: each is at most `data.len() - w - 2`.
                let pairs = |below: usize, i: usize| unsafe {
                    let pair = |i: usize| pair(data, at[i] as usize + below);
                    f64x4::simd_from(s, [pair(i), pair(i + 1), pair(i + 2), pair(i + 3)])
                };
                let [a, b, c, d] = [pairs(0, 0), pairs(0, 4), pairs(w, 0), pairs(w, 4)];
                let (a, b): (f32x8<S>, f32x8<S>) = (a.bitcast(), b.bitcast());
                let (c, d): (f32x8<S>, f32x8<S>) = (c.bitcast(), d.bitcast());
                let ((a, b), (c, d)) = (a.deinterleave(b), c.deinterleave(d));
                let top = (b - a).mul_add(fx, a);
                let bottom = (d - c).mul_add(fx, c);
                let value = (bottom - top).mul_add(fy, top);
                value.store_slice(&mut values[j][8 * k..8 * k + 8]);
            }
        }
    }

    /// Votes by (row, column, direction).
    #[inline(always)]
    fn histogram<S: Simd>(&self, s: S, weights: &Weights) -> [f32; 128] {
        let zero = f32x8::splat(s, 0.0);
        // Magnitudes, and those times the angle in steps of directions: a loop of their own, so that the long way to an angle is
        // gone with several at once.
        let mut gradients = [[[zero; 2]; VECTORS]; SAMPLES];
        for (j, gradients) in gradients.iter_mut().enumerate() {
            let [above, here, below] = [&self.values[j], &self.values[j + 1], &self.values[j + 2]];
            for k in 0..VECTORS {
                let at = 8 * k;
                let gx = f32x8::from_slice(s, &here[at + 2..at + 10])
                    - f32x8::from_slice(s, &here[at..at + 8]);
                let gy = f32x8::from_slice(s, &below[at + 1..at + 9])
                    - f32x8::from_slice(s, &above[at + 1..at + 9]);
                let mut magnitude = (gx * gx + gy * gy).sqrt();
                if self.is_cut {
                    magnitude *= f32x8::from_slice(s, &self.inside[j + 1][at + 1..at + 9]);
                }
                let turned = magnitude * (angle(s, gx, gy) * (DIRECTIONS as f32 / TAU));
                gradients[k] = [magnitude, turned];
            }
        }
        // Votes by place row, direction and column of samples.
        let mut votes = [[[zero; VECTORS]; DIRECTIONS]; PLACES];
        for (gradients, &(place, near, next)) in gradients.iter().zip(&weights.rows) {
            let (near, next) = (f32x8::splat(s, near), f32x8::splat(s, next));
            for k in 0..VECTORS {
                // Each magnitude is shared between the two nearest directions. `over` is what lies beyond direction d,
                // 0 to all of it; the vote for d is what lies beyond d - 1 but not beyond d.
                let [magnitude, turned] = gradients[k];
                let mut over = turned.min(magnitude);
                let mut shares = [magnitude - over; DIRECTIONS];
                for d in 1..DIRECTIONS {
                    let beyond = (turned - magnitude * d as f32).max(zero).min(magnitude);
                    shares[d] = over - beyond;
                    over = beyond;
                }
                shares[0] += over;
                if place > 0 {
                    for (vote, share) in votes[place - 1].iter_mut().zip(&shares) {
                        vote[k] = share.mul_add(near, vote[k]);
                    }
                }
                if place < PLACES {
                    for (vote, share) in votes[place].iter_mut().zip(&shares) {
                        vote[k] = share.mul_add(next, vote[k]);
                    }
                }
            }
        }
        let mut histogram = [0.0; 128];
        for column in 0..PLACES {
            let weights = &weights.columns[column];
            let mut shares = [zero; VECTORS];
            for (k, share) in shares.iter_mut().enumerate() {
                *share = f32x8::from_slice(s, &weights[8 * k..8 * k + 8]);
            }
            for row in 0..PLACES {
                let mut sums = [zero; DIRECTIONS];
                for (sum, votes) in sums.iter_mut().zip(&votes[row]) {
                    *sum = votes[0] * shares[0];
                    for k in 1..VECTORS {
                        *sum = votes[k].mul_add(shares[k], *sum);
                    }
                }
                let at = (row * PLACES + column) * DIRECTIONS;
                totals(sums).store_slice(&mut histogram[at..at + DIRECTIONS]);
            }
        }
        histogram
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;

    use super::*;
    use crate::Simd as Token;
    use crate::simd::at_level;

    fn describe(plane: &Plane, x: f32, y: f32, sigma: f32, angle: f32) -> Descriptor {
        let histogram = histogram(plane, x, y, sigma, angle);
        at_level!(Token::best(), s => finish(s, &histogram))
    }

    /// At the best level, after a look whether the others agree.
    fn histogram(plane: &Plane, x: f32, y: f32, sigma: f32, angle: f32) -> [f32; 128] {
        let weights = Weights::new();
        let all: Vec<[f32; 128]> = Token::available()
            .map(|token| {
                at_level!(token, s => {
                    let mut patch = Patch::new();
                    patch.sample(s, plane, x, y, sigma, angle);
                    patch.histogram(s, &weights)
                })
            })
            .collect();
        let most = all[0].iter().fold(0.0_f32, |a, b| a.max(*b));
        for found in &all {
            for (a, b) in found.iter().zip(&all[0]) {
                assert!((a - b).abs() <= 1e-4 * most, "{a} {b}");
            }
        }
        all[all.len() - 1]
    }

    fn plane(f: impl Fn(f32, f32) -> f32) -> Plane {
        let data = (0..80 * 80)
            .map(|i| f((i % 80) as f32, (i / 80) as f32))
            .collect();
        Plane {
            width: 80,
            height: 80,
            pitch: 1,
            data,
        }
    }

    #[test]
    fn unit_length_in_bytes() {
        let p = plane(|x, y| (0.3 * x).sin() * (0.23 * y).cos() + 0.1 * (0.5 * x + 0.4 * y).sin());
        let d = describe(&p, 40.2, 39.7, 1.9, 0.6);
        let norm = d
            .components()
            .iter()
            .map(|&v| f32::from(v).powi(2))
            .sum::<f32>()
            .sqrt();
        assert!((norm - 250.0).abs() < 6.0, "{norm}");
    }

    #[test]
    fn a_ramp_along_the_angle_votes_for_direction_0_only() {
        for angle in [0.0_f32, 0.9, -2.5, PI] {
            let (s, c) = angle.sin_cos();
            let h = histogram(&plane(|x, y| c * x + s * y), 40.0, 40.0, 1.6, angle);
            let (along, all) = (h.iter().step_by(8).sum::<f32>(), h.iter().sum::<f32>());
            assert!(along > 0.999 * all, "{angle}: {along} of {all}");
            // All four rows and columns of places, symmetric.
            let at = |row: usize, column: usize| h[(row * 4 + column) * 8];
            assert!(
                (at(0, 0) / at(3, 3) - 1.0).abs() < 0.03
                    && (at(0, 3) / at(3, 0) - 1.0).abs() < 0.03
            );
            assert!(at(1, 1) > at(0, 0) && at(0, 0) > 0.0);
        }
    }

    #[test]
    fn places_follow_the_keypoint_frame() {
        // Gradient only to the right of the keypoint: columns 2 and 3 at angle 0, rows 0 and 1 when the frame is turned by +90
        // degrees, where right is up (v = -dx).
        let p = plane(|x, _| (x - 42.0).max(0.0));
        let h = histogram(&p, 40.0, 40.0, 1.6, 0.0);
        let sum = |h: &[f32; 128], f: &dyn Fn(usize, usize) -> bool| -> f32 {
            (0..128)
                .filter(|i| f(i / 32, i / 8 % 4))
                .map(|i| h[i])
                .sum()
        };
        assert!(sum(&h, &|_, column| column >= 2) > 0.95 * sum(&h, &|_, _| true));
        let h = histogram(&p, 40.0, 40.0, 1.6, PI / 2.0);
        assert!(sum(&h, &|row, _| row < 2) > 0.95 * sum(&h, &|_, _| true));
    }

    #[test]
    fn nothing_to_describe_is_zero_and_borders_are_safe() {
        let flat = plane(|_, _| 0.3);
        assert_eq!(describe(&flat, 40.0, 40.0, 1.6, 1.0), Descriptor::ZERO);
        let p = plane(|x, y| (0.3 * x).sin() + (0.2 * y).cos());
        for (x, y) in [(0.0, 0.0), (79.0, 79.0), (5.0, 74.6), (0.0, 40.0)] {
            for k in 0..40 {
                let _ = describe(&p, x, y, 3.6, k as f32 * 0.16 - PI);
            }
        }
    }
}

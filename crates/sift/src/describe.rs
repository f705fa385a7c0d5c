//! The descriptor: 4 x 4 places x 8 directions of gradient around a keypoint (Lowe, IJCV 2004, section 6), as RootSIFT
//! (Arandjelovic & Zisserman, CVPR 2012, section 3).
//!
//! A place is 3 sigma wide, the Gaussian window 6 sigma (half the width of the descriptor), both in the frame turned by the
//! keypoint's angle and centred on the refined position. Each gradient votes trilinearly for the 8 nearest cells. The vector is
//! normalised, cut at 0.2, normalised, then divided by its sum and square-rooted, which gives unit length again and makes the
//! squared distance that of Hellinger; bytes are those of [`Descriptor`].
//!
//! Cost: the pixels within 15 sigma x 15 sigma, about 1000 at the finest scale; no exponential per pixel, since the Gaussian is
//! round and so a product of one factor per row and one per column.

use std::f32::consts::PI;

use crate::descriptor::{Descriptor, finish};
use crate::gradient::{RUN, gradients, split};
use crate::scale_space::Plane;

/// Places per side.
const PLACES: usize = 4;

/// Directions per place.
const DIRECTIONS: usize = 8;

/// Width of a place in units of the keypoint's sigma.
const PLACE_WIDTH: f32 = 3.0;

/// Range of whole `t` with `|a t + b| < r`, as (low, high) in reals; `low > high` when there is none.
fn span(a: f32, b: f32, r: f32) -> (f32, f32) {
    if a.abs() < 1e-6 {
        return if b.abs() < r {
            (f32::MIN, f32::MAX)
        } else {
            (f32::MAX, f32::MIN)
        };
    }
    let (p, q) = ((-r - b) / a, (r - b) / a);
    (p.min(q), p.max(q))
}

/// Descriptor of the keypoint at (x, y) with scale `sigma`, both in pixels of `plane`, turned by `angle` radians.
pub(crate) fn describe(plane: &Plane, x: f32, y: f32, sigma: f32, angle: f32) -> Descriptor {
    finish(&histogram(plane, x, y, sigma, angle))
}

/// Cells per side, with one around the grid for votes that fall half outside.
const SIDE: usize = PLACES + 2;

/// Votes by (row, column, direction), rounded up to a power of two.
const VOTES: usize = 512;

fn histogram(plane: &Plane, x: f32, y: f32, sigma: f32, angle: f32) -> [f32; 128] {
    let mut votes = [0.0_f32; VOTES];
    let width = PLACE_WIDTH * sigma;
    // Place coordinates: u = c dx + s dy, v = -s dx + c dy, in units of places; the grid is |u|, |v| < 2, and a half around it.
    let (s, c) = angle.sin_cos();
    let (s, c) = (s / width, c / width);
    let reach = 0.5 * (PLACES + 1) as f32;
    let radius = reach * width * std::f32::consts::SQRT_2;
    let window = 0.5 * PLACES as f32 * width;
    let falloff = -0.5 / (window * window);
    let weight = |d: f32| (falloff * d * d).exp();
    let left = (x - radius).ceil().max(1.0) as usize;
    let columns: Vec<f32> = (0..=(2.0 * radius) as usize + 1 + RUN)
        .map(|i| weight((left + i) as f32 - x))
        .collect();
    let last = plane.width as f32 - 2.0 - x;
    let bottom = (y + radius).floor().min(plane.height as f32 - 2.0) as usize;
    let (mut magnitude, mut direction) = ([0.0; RUN], [0.0; RUN]);
    for row in (y - radius).ceil().max(1.0) as usize..=bottom {
        let dy = row as f32 - y;
        let (u, v) = (span(c, s * dy, reach), span(-s, c * dy, reach));
        let (low, high) = (
            u.0.max(v.0).max(left as f32 - x),
            u.1.min(v.1).min(last).min(radius),
        );
        if low > high {
            continue;
        }
        let (begin, end) = ((x + low).ceil() as usize, (x + high).floor() as usize + 1);
        let row_weight = weight(dy);
        for start in (begin..end).step_by(RUN) {
            let n = (end - start).min(RUN);
            gradients(plane, start, row, n, &mut magnitude, &mut direction);
            let columns = &columns[start - left..][..RUN];
            let (mut cell, mut slot) = ([0_i32; RUN], [0_i32; RUN]);
            let (mut fu, mut fv, mut fd) = ([0.0; RUN], [0.0; RUN], [0.0; RUN]);
            for i in 0..RUN {
                let dx = (start + i) as f32 - x;
                // Margins hold what lies outside; the bounds only keep rounding from leaving them.
                let place = |p: f32| {
                    (p + (0.5 * PLACES as f32 + 0.5))
                        .max(0.0)
                        .min(SIDE as f32 - 1.001)
                };
                let (u, ru) = split(place(c * dx + s * dy));
                let (v, rv) = split(place(-s * dx + c * dy));
                // Positive after two turns; the low three bits of the whole number are the direction.
                let turned = (direction[i] - angle) * (DIRECTIONS as f32 / (2.0 * PI))
                    + 2.0 * DIRECTIONS as f32;
                let (d, rd) = split(turned);
                cell[i] = (v * SIDE as i32 + u) * DIRECTIONS as i32;
                slot[i] = d;
                (fu[i], fv[i], fd[i]) = (ru, rv, rd);
                magnitude[i] *= row_weight * columns[i];
            }
            for i in 0..n {
                let (at, d) = (cell[i] as usize, slot[i] as usize);
                let (near, next) = (at + d % DIRECTIONS, at + (d + 1) % DIRECTIONS);
                let mut vote = |place: usize, amount: f32| {
                    let second = amount * fd[i];
                    votes[(near + place * DIRECTIONS) % VOTES] += amount - second;
                    votes[(next + place * DIRECTIONS) % VOTES] += second;
                };
                let below = magnitude[i] * fv[i];
                let above = magnitude[i] - below;
                let (above_right, below_right) = (above * fu[i], below * fu[i]);
                vote(0, above - above_right);
                vote(1, above_right);
                vote(SIDE, below - below_right);
                vote(SIDE + 1, below_right);
            }
        }
    }
    let mut out = [0.0; 128];
    for (i, out) in out.chunks_exact_mut(DIRECTIONS).enumerate() {
        let at = ((i / PLACES + 1) * SIDE + i % PLACES + 1) * DIRECTIONS;
        out.copy_from_slice(&votes[at..at + DIRECTIONS]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(f: impl Fn(f32, f32) -> f32) -> Plane {
        let data = (0..80 * 80)
            .map(|i| f((i % 80) as f32, (i / 80) as f32))
            .collect();
        Plane {
            width: 80,
            height: 80,
            data,
        }
    }

    #[test]
    fn unit_length_in_bytes() {
        let p = plane(|x, y| (0.3 * x).sin() * (0.23 * y).cos() + 0.1 * (0.5 * x + 0.4 * y).sin());
        let d = describe(&p, 40.2, 39.7, 1.9, 0.6);
        let norm = (d.norm_sq() as f32).sqrt();
        assert!((norm - 250.0).abs() < 5.0, "{norm}");
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

//! Dominant gradient directions of a keypoint (Lowe, IJCV 2004, section 5).
//!
//! A histogram of 36 directions over a disc of radius 4.5 sigma, weighted by gradient magnitude and a Gaussian of 1.5 sigma
//! around the refined position. Votes are shared between the two nearest bins; the histogram is smoothed, and each peak of at
//! least 0.8 of the highest gives an orientation, interpolated by a parabola.

use std::f32::consts::PI;

use crate::gradient::{RUN, gradients, split};
use crate::scale_space::Plane;

const BINS: usize = 36;

/// Standard deviation of the window in units of the keypoint's sigma.
const WINDOW: f32 = 1.5;

/// Radius of the disc in units of the window.
const RADIUS: f32 = 3.0;

/// Least height of a further peak, relative to the highest.
const PEAK: f32 = 0.8;

/// Orientations of the keypoint at (x, y) with scale `sigma`, both in pixels of `plane`: radians from +x towards +y in
/// `(-pi, pi]`, the most pronounced first; empty when there is no gradient at all.
pub(crate) fn orientations(plane: &Plane, x: f32, y: f32, sigma: f32) -> Vec<f32> {
    peaks(&smoothed(&histogram(plane, x, y, sigma)))
}

/// Bin k holds the votes for direction `2 pi k / 36`.
fn histogram(plane: &Plane, x: f32, y: f32, sigma: f32) -> [f32; BINS] {
    // One more bin on each side of -pi..=pi, folded back at the end.
    let mut votes = [0.0_f32; 64];
    let (mut magnitude, mut angle) = ([0.0; RUN], [0.0; RUN]);
    let window = WINDOW * sigma;
    let radius = RADIUS * window;
    let falloff = -0.5 / (window * window);
    let weight = |d: f32| (falloff * d * d).exp();
    let left = (x - radius).ceil().max(1.0) as usize;
    let columns: Vec<f32> = (0..=(2.0 * radius) as usize + 1)
        .map(|i| weight((left + i) as f32 - x))
        .collect();
    let bottom = ((y + radius).floor()).min(plane.height as f32 - 2.0) as usize;
    for row in (y - radius).ceil().max(1.0) as usize..=bottom {
        let dy = row as f32 - y;
        let half = (radius * radius - dy * dy).max(0.0).sqrt();
        let begin = (x - half).ceil().max(1.0) as usize;
        let end = ((x + half).floor().min(plane.width as f32 - 2.0) + 1.0) as usize;
        let row_weight = weight(dy);
        for start in (begin..end).step_by(RUN) {
            let n = (end - start).min(RUN);
            gradients(plane, start, row, n, &mut magnitude, &mut angle);
            for ((m, a), column_weight) in magnitude[..n]
                .iter()
                .zip(&angle[..n])
                .zip(&columns[start - left..])
            {
                let (bin, rest) = split((a + PI) * (BINS as f32 / (2.0 * PI)));
                let vote = m * row_weight * column_weight;
                let bin = (bin + 1) as usize & 63;
                votes[bin] += vote * (1.0 - rest);
                votes[(bin + 1) & 63] += vote * rest;
            }
        }
    }
    // votes[i] stands for the direction 2 pi (i - 1) / 36 - pi.
    let mut histogram = [0.0; BINS];
    for (i, v) in votes[..BINS + 3].iter().enumerate() {
        histogram[(i + BINS - 1 + BINS / 2) % BINS] += v;
    }
    histogram
}

/// Circular smoothing with (1 4 6 4 1) / 16.
fn smoothed(h: &[f32; BINS]) -> [f32; BINS] {
    std::array::from_fn(|i| {
        let at = |d: usize| h[(i + d) % BINS];
        (at(BINS - 2) + at(2)) / 16.0 + (at(BINS - 1) + at(1)) / 4.0 + at(0) * 0.375
    })
}

fn peaks(h: &[f32; BINS]) -> Vec<f32> {
    let highest = h.iter().fold(0.0_f32, |a, &b| a.max(b));
    if highest <= 0.0 {
        return Vec::new();
    }
    let mut found: Vec<(f32, f32)> = (0..BINS)
        .filter_map(|i| {
            let (before, here, after) = (h[(i + BINS - 1) % BINS], h[i], h[(i + 1) % BINS]);
            // Of two equal neighbours the first counts, and the parabola puts the peak between them.
            if here < PEAK * highest || here <= before || here < after {
                return None;
            }
            let offset = 0.5 * (before - after) / (before - 2.0 * here + after);
            let angle = (i as f32 + offset) * (2.0 * PI / BINS as f32);
            Some((here, if angle > PI { angle - 2.0 * PI } else { angle }))
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found
        .into_iter()
        .map(|(_, angle)| angle.clamp(-PI.next_down(), PI))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

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
            data: vec![0.5; 400],
        };
        assert!(orientations(&plane, 10.0, 10.0, 2.0).is_empty());
    }

    #[test]
    fn a_window_over_the_border_is_cut() {
        let plane = Plane {
            width: 12,
            height: 12,
            data: (0..144).map(|i| (i % 12) as f32).collect(),
        };
        assert_eq!(orientations(&plane, 5.0, 6.9, 3.6).len(), 1);
        assert_eq!(orientations(&plane, 0.0, 11.0, 3.6).len(), 1);
    }
}

//! Where in the view the target might lie: the highest peaks of the correlation over all places and angles.

use super::matched::Matched;
use super::plane::{Plane, box_mean};
use crate::RotationPrior;
use crate::fourier::{C32, Fourier, smooth_size};
use crate::prior::wrap;
use rayon::prelude::*;
use scopeservo_geometry::{Affine2, Mat2, Vec2};
use std::f64::consts::TAU;

/// By half a step of the angle the target's pixels move so far, root mean square, samples.
const TURN_STEP_PX: f64 = 1.0;
/// Peaks of one angle that are kept, and of all angles.
const OF_EACH: usize = 3;
const MOST: usize = 12;
/// Peaks nearer than this are one, samples.
const APART: f64 = 4.0;
/// A view that has less in it than this share of the target's energy is taken for one that has.
const LEAST_ENERGY: f32 = 0.2;

/// A place and an angle at which the view correlates with the target more than around.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Peak {
    /// Where the target's centre lies, samples of the view.
    pub(super) at: [usize; 2],
    /// Rotation from view to target.
    pub(super) angle_rad: f64,
    /// 1 for what is the same.
    pub(super) height: f32,
}

/// The angles to look at: so near to each other that what lies between two of them is seen by both.
pub(super) fn angles(matched: &Matched<'_>, rotation: Option<RotationPrior>) -> Vec<f64> {
    let [w, h] = matched.target_samples();
    // The root mean square distance of a target's pixel from its centre.
    let radius = ((w * w + h * h) / 12.0).sqrt();
    let step = 2.0 * TURN_STEP_PX / radius.max(1.0);
    match rotation {
        Some(r) if 2.0 * r.tolerance_rad + step < TAU => {
            let around = (r.tolerance_rad / step).ceil();
            let step = match around > 0.0 {
                true => r.tolerance_rad / around,
                false => 0.0,
            };
            let steps = -(around as i64)..=around as i64;
            steps.map(|k| wrap(r.angle_rad + k as f64 * step)).collect()
        }
        _ => {
            let count = (TAU / step).ceil() as usize;
            (0..count)
                .map(|k| wrap(TAU * k as f64 / count as f64))
                .collect()
        }
    }
}

/// The highest peaks over these angles, the highest first.
pub(super) fn peaks(matched: &Matched<'_>, angles: &[f64]) -> Vec<Peak> {
    let view = matched.view;
    let [tw, th] = matched.target_samples();
    let across = f64::hypot(tw, th).ceil() as usize + 2;
    let size = padded(view, across);
    let fourier = Fourier::new(size);
    let mut plane = fourier.plane();
    for (row, values) in (plane.chunks_exact_mut(size[0])).zip(view.values.chunks_exact(view.width))
    {
        row.iter_mut().zip(values).for_each(|(c, v)| c.re = *v);
    }
    let mut spectrum = fourier.plane();
    fourier.forward(&mut plane, &mut spectrum, &mut fourier.scratch());
    let share = shares(matched);
    let pairs: Vec<&[f64]> = angles.chunks(2).collect();
    let found = pairs.par_iter().map_init(
        || [fourier.plane(), fourier.plane(), fourier.scratch()],
        |[plane, product, scratch], pair| {
            plane.fill(C32::default());
            for (k, angle) in pair.iter().enumerate() {
                turned(matched, *angle, across / 2, plane, size, k == 1);
            }
            fourier.forward(plane, product, scratch);
            let each = product.iter_mut().zip(&spectrum);
            each.for_each(|(p, s)| *p *= s);
            fourier.inverse(product, plane, scratch);
            let mut peaks = Vec::new();
            for (k, &angle) in pair.iter().enumerate() {
                let height = |x: usize, y: usize| {
                    let c = plane[y * size[0] + x];
                    (if k == 0 { c.re } else { c.im }) * share[y * view.width + x]
                };
                let found = local(view, &height);
                peaks.extend(found.into_iter().map(|(at, height)| Peak {
                    at,
                    angle_rad: angle,
                    height,
                }));
            }
            peaks
        },
    );
    let all: Vec<Vec<Peak>> = found.collect();
    apart(all.into_iter().flatten().collect())
}

/// What makes a correlation of a sum of products, for each place: by the energy of the target and that of the view around it, over a square as
/// large as the target.
fn shares(matched: &Matched<'_>) -> Vec<f32> {
    let (view, target) = (matched.view, matched.target);
    let [w, h] = matched.target_samples();
    let area = (w * h) as f32;
    let all: f32 = target.values.iter().map(|v| v * v).sum();
    let own = area * all / target.values.len() as f32;
    let mut energy: Vec<f32> = view.values.iter().map(|v| v * v).collect();
    let reach = (0.5 * f64::from(area).sqrt()).round() as usize;
    box_mean(&mut energy, view.width, view.height, reach);
    let across = f64::hypot(w, h).ceil() as usize + 2;
    // A transform there and back is not divided by the number of values.
    let count: usize = padded(view, across).iter().product();
    let share = |e: f32| {
        let product = own * (area * e + LEAST_ENERGY * own);
        1.0 / (count as f32 * product.sqrt().max(1e-6))
    };
    energy.into_iter().map(share).collect()
}

/// What hangs over on the right and what does on the left share one margin, where nothing is.
fn padded(view: &Plane, across: usize) -> [usize; 2] {
    [view.width, view.height].map(|side| smooth_size(side + across / 2 + 1))
}

/// Draws the target, turned and read backwards about the origin, as real or as imaginary part.
fn turned(
    matched: &Matched<'_>,
    angle_rad: f64,
    reach: usize,
    plane: &mut [C32],
    size: [usize; 2],
    imaginary: bool,
) {
    let (target, pitch) = (matched.target, matched.target_pitch());
    let linear = Mat2::rotation(angle_rad) * pitch;
    let centre = [target.width, target.height].map(|n| (n as f64 - 1.0) / 2.0);
    let reach = reach as i64;
    for y in -reach..=reach {
        let row = (-y).rem_euclid(size[1] as i64) as usize * size[0];
        for x in -reach..=reach {
            let p = linear * [x as f64, y as f64];
            let value = target.at([p[0] + centre[0], p[1] + centre[1]]);
            if value == 0.0 {
                continue;
            }
            let c = &mut plane[row + (-x).rem_euclid(size[0] as i64) as usize];
            match imaginary {
                true => c.im += value,
                false => c.re += value,
            }
        }
    }
}

/// The highest places that are higher than those around them.
fn local(view: &Plane, height: &impl Fn(usize, usize) -> f32) -> Vec<([usize; 2], f32)> {
    let mut best: Vec<([usize; 2], f32)> = Vec::new();
    for y in 0..view.height {
        for x in 0..view.width {
            let h = height(x, y);
            let least = match best.len() < OF_EACH {
                true => 0.0,
                false => best[OF_EACH - 1].1,
            };
            if h <= least {
                continue;
            }
            let rows = y.saturating_sub(1)..(y + 2).min(view.height);
            let higher = rows
                .flat_map(|j| {
                    let columns = x.saturating_sub(1)..(x + 2).min(view.width);
                    columns.map(move |i| (i, j))
                })
                .any(|(i, j)| height(i, j) > h);
            if !higher {
                best.push(([x, y], h));
                best.sort_by(|a, b| b.1.total_cmp(&a.1));
                best.truncate(OF_EACH);
            }
        }
    }
    best
}

/// The highest first, without those beside a higher one, at whatever angle.
fn apart(mut all: Vec<Peak>) -> Vec<Peak> {
    all.sort_by(|a, b| b.height.total_cmp(&a.height));
    let mut kept: Vec<Peak> = Vec::new();
    for peak in all {
        let near = |k: &Peak| {
            let turn = wrap(k.angle_rad - peak.angle_rad).abs();
            let d: Vec2 = [0, 1].map(|i| k.at[i] as f64 - peak.at[i] as f64);
            f64::hypot(d[0], d[1]) < APART && turn < 0.3
        };
        if !kept.iter().any(near) {
            kept.push(peak);
            if kept.len() == MOST {
                break;
            }
        }
    }
    kept
}

impl Peak {
    /// Target pixel from view pixel.
    pub(super) fn target_from_view(&self, matched: &Matched<'_>) -> Affine2 {
        let at = matched
            .view
            .pixel_from_sample()
            .apply(self.at.map(|v| v as f64));
        let linear = Mat2::rotation(self.angle_rad) * matched.ratio;
        let target = matched.target;
        let centre = [target.width, target.height].map(|n| (n as f64 - 1.0) / 2.0);
        let centre = target.pixel_from_sample().apply(centre);
        let moved = linear * at;
        Affine2 {
            linear,
            offset: [centre[0] - moved[0], centre[1] - moved[1]],
        }
    }
}

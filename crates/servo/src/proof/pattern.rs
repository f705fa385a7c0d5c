//! The camera's fixed pattern from a few frames between which the specimen moved.
//!
//! On a bright field whatever belongs to the specimen takes light away, and moves: the brightest that a pixel was in any of the frames is
//! the empty field there, times what lies on the camera. A smooth illumination divided out, shadows of dust are left. Where the specimen
//! is dense no pixel was ever empty; then nothing is claimed.

use super::aside::{Seen, is_free, look};
use crate::event::tell;
use crate::small_step::{directions, place};
use crate::vision::{grab, gray_of, to_gray};
use crate::{Event, FrameRole, PlanarPose, ServoError, Sink, VisionOptions};
use scopeservo_features::{Features, GrayImage};
use scopeservo_geometry::{Vec2, least_squares};
use scopeservo_scope::{FlatField, Frame, Instrument, ObjectiveId};
use std::sync::Arc;

/// So far from the first frame, and from each other, the others are taken, pixels.
const AROUND_PX: f64 = 40.0;
/// So many frames must be seen to have moved once the pattern is divided out: else it was the specimen.
const SEEN_TO_MOVE: usize = 2;

/// The illumination is a polynomial of degree four, fitted to every so many pixels.
const STRIDE: usize = 6;
const TERMS: usize = 15;
const FITS: usize = 6;
/// A pixel belongs to a shadow when it is so many standard deviations off, and is connected to one that is more than that.
const SIGMAS: [f32; 2] = [2.5, 5.0];
/// Less than this is no shadow worth dividing out.
const LEAST_DEPTH: f32 = 0.015;
/// When more of the image than this is off, the specimen was in the way.
const LARGEST_SHARE: f64 = 0.3;
/// A shadow must explain this share of the variance around it, in half of the frames.
const EXPLAINS: f64 = 0.6;
/// It is looked at with so many pixels around it.
const RIM: usize = 4;

/// A first frame without the shadows that lie on it, and what the specimen then shows when it moves.
pub(crate) struct Cleaned {
    pub(crate) image: GrayImage,
    pub(crate) features: Features,
    pub(crate) seen: Seen,
}

/// Takes frames around `home`, where the frame `first` was taken, and keeps the shadows on the camera with the instrument; stays at
/// the last place. `None` when the frames do not show any, or the stage may not go there.
pub(crate) fn look_around(
    scope: &Instrument,
    sink: &mut dyn Sink,
    (objective, um_per_px): (&ObjectiveId, f64),
    vision: &VisionOptions,
    first: &Arc<Frame>,
    home: &PlanarPose,
) -> Result<Option<Cleaned>, ServoError> {
    let step_m = AROUND_PX * um_per_px * 1e-6;
    let mut frames = vec![first.clone()];
    for way in around(scope, home, step_m) {
        let to = place(home, way, step_m, 1.0);
        scope.move_to(&to.request(&scope.gate().position()?))?;
        frames.push(grab(scope, sink, FrameRole::Aside, objective)?);
    }
    let raw = frames.iter().map(|f| to_gray(f, f.luminance()));
    let raw = raw.collect::<Result<Vec<_>, _>>()?;
    let Some(pattern) = fixed_pattern(&raw).filter(|p| p.shadows() > 0) else {
        return Ok(None);
    };
    let shadows = pattern.shadows();
    // The instrument gets them once it is known that they are not the specimen's.
    let candidate = Arc::new(pattern);
    let image = gray_of(first, Some(&candidate))?;
    let found = vision.of_target(&image)?;
    let mut moved = Vec::new();
    for frame in &frames[1..] {
        let other = gray_of(frame, Some(&candidate))?;
        moved.extend(look(vision, (&image, &found), other)?.0);
    }
    if moved.len() < SEEN_TO_MOVE {
        return Ok(None);
    }
    scope.set_flat_field(Some(candidate));
    tell(scope, sink, Event::ShadowsFound { shadows });
    Ok(Some(Cleaned {
        image,
        features: found,
        seen: moved.swap_remove(0),
    }))
}

/// Two ways that cross and the one between them, as far as the stage may go there.
fn around(scope: &Instrument, home: &PlanarPose, step_m: f64) -> Vec<Vec2> {
    let free = |way: &Vec2| is_free(scope, home, *way, step_m).is_ok();
    let ways: Vec<Vec2> = directions(scope).iter().map(|d| d.0).filter(free).collect();
    let Some(first) = ways.first() else {
        return Vec::new();
    };
    let crosses = |way: &&Vec2| way[0] * first[0] + way[1] * first[1] == 0.0;
    let Some(second) = ways.iter().find(crosses) else {
        return Vec::new();
    };
    let both = [first[0] + second[0], first[1] + second[1]];
    [*first, both, *second].into_iter().filter(free).collect()
}

/// What lies on the camera; `None` when the frames do not show it. All frames are of one size.
pub(crate) fn fixed_pattern(frames: &[GrayImage]) -> Option<FlatField> {
    let first = frames.first()?;
    let (width, height) = (first.width(), first.height());
    if frames.len() < 3 || width.min(height) < 8 * STRIDE {
        return None;
    }
    let frames: Vec<Vec<f32>> = frames.iter().map(levelled).collect();
    let mut brightest = frames[0].clone();
    for frame in &frames[1..] {
        for (b, v) in brightest.iter_mut().zip(frame) {
            *b = b.max(*v);
        }
    }
    let field = illumination(&brightest, width, height)?;
    let flat = |frame: &[f32]| {
        let ratio: Vec<f32> = frame.iter().zip(&field).map(|(v, f)| v / f).collect();
        smoothed(&ratio, width, height)
    };
    let pattern = flat(&brightest);
    let noise = deviation(&pattern);
    let off = |sigmas: f32| (sigmas * noise).max(LEAST_DEPTH);
    let (weak, strong) = (off(SIGMAS[0]), off(SIGMAS[1]));
    let depth = |i: usize| (pattern[i] - 1.0).abs();
    let shadows = FlatField::connected(width, height, |i| depth(i) > weak);
    let frames: Vec<Vec<f32>> = frames.iter().map(|f| flat(f)).collect();
    let mut transmission = vec![1.0f32; width * height];
    let mut share = 0;
    for shadow in shadows {
        if !shadow.iter().any(|&i| depth(i as usize) > strong) {
            continue;
        }
        share += shadow.len();
        if stays(&shadow, &pattern, &frames, width, height) {
            for i in shadow {
                transmission[i as usize] = pattern[i as usize].clamp(0.01, 4.0);
            }
        }
    }
    if share as f64 > LARGEST_SHARE * (width * height) as f64 {
        return None;
    }
    FlatField::new(width, height, transmission).ok()
}

/// A frame over its bright level: the lamp flickers, and a camera may choose its exposure.
fn levelled(frame: &GrayImage) -> Vec<f32> {
    let mut sorted: Vec<f32> = frame.data().iter().step_by(7).copied().collect();
    let at = sorted.len() * 4 / 5;
    let level = *sorted.select_nth_unstable_by(at, f32::total_cmp).1;
    let level = level.max(f32::MIN_POSITIVE);
    frame.data().iter().map(|v| v / level).collect()
}

fn terms(x: f64, y: f64) -> [f64; TERMS] {
    let mut all = [0.0; TERMS];
    let powers = (0..5i32).flat_map(|i| (0..5 - i).map(move |j| (i, j)));
    for (term, (i, j)) in all.iter_mut().zip(powers) {
        *term = x.powi(i) * y.powi(j);
    }
    all
}

/// The polynomial through what most pixels show, at all of them; `None` where it is dark.
fn illumination(brightest: &[f32], width: usize, height: usize) -> Option<Vec<f32>> {
    let at = |x: usize, y: usize| {
        let unit = |v: usize, side: usize| 2.0 * v as f64 / (side - 1) as f64 - 1.0;
        terms(unit(x, width), unit(y, height))
    };
    let grid: Vec<([f64; TERMS], f64)> = (0..height)
        .step_by(STRIDE)
        .flat_map(|y| (0..width).step_by(STRIDE).map(move |x| (x, y)))
        .map(|(x, y)| (at(x, y), f64::from(brightest[y * width + x])))
        .collect();
    let value = |c: &[f64; TERMS], row: &[f64; TERMS]| -> f64 {
        c.iter().zip(row).map(|(c, r)| c * r).sum()
    };
    let mut used = grid.clone();
    let mut coefficients = least_squares(&used)?.0;
    for _ in 0..FITS {
        let off = |(row, v): &([f64; TERMS], f64)| (v - value(&coefficients, row)).abs();
        let mut all: Vec<f64> = grid.iter().map(off).collect();
        let middle = all.len() / 2;
        let median = *all.select_nth_unstable_by(middle, f64::total_cmp).1;
        let near = |e: &&([f64; TERMS], f64)| off(e) <= 3.0 * 1.4826 * median + 1e-6;
        used = grid.iter().filter(near).copied().collect();
        coefficients = least_squares(&used)?.0;
    }
    let field: Vec<f32> = (0..width * height)
        .map(|i| value(&coefficients, &at(i % width, i / width)) as f32)
        .collect();
    field.iter().all(|v| *v > 0.05).then_some(field)
}

/// Binomial mean over 3 x 3 pixels.
fn smoothed(values: &[f32], width: usize, height: usize) -> Vec<f32> {
    let at = |x: usize, y: usize| values[y.min(height - 1) * width + x.min(width - 1)];
    let row =
        |x: usize, y: usize| (at(x.saturating_sub(1), y) + 2.0 * at(x, y) + at(x + 1, y)) / 4.0;
    (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            (row(x, y.saturating_sub(1)) + 2.0 * row(x, y) + row(x, y + 1)) / 4.0
        })
        .collect()
}

/// Standard deviation around 1 of most pixels.
fn deviation(pattern: &[f32]) -> f32 {
    let mut off: Vec<f32> = pattern.iter().map(|p| (p - 1.0).abs()).collect();
    let middle = off.len() / 2;
    1.4826 * *off.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// Whether a shadow is seen as it is in half of the frames: what was left of the specimen looks different in each.
fn stays(
    shadow: &[u32],
    pattern: &[f32],
    frames: &[Vec<f32>],
    width: usize,
    height: usize,
) -> bool {
    let rim = FlatField::rim(width, height, shadow, RIM, |_| true);
    let all: std::collections::BTreeSet<u32> = shadow.iter().chain(&rim).copied().collect();
    let explained = |frame: &Vec<f32>| {
        let pairs = all.iter().map(|&i| {
            let both = [pattern[i as usize], frame[i as usize]];
            both.map(|v| f64::from(v.max(0.01).ln()))
        });
        let n = all.len() as f64;
        let mut sums = [0.0; 5];
        for [p, f] in pairs {
            for (sum, v) in sums.iter_mut().zip([p, f, p * p, f * f, p * f]) {
                *sum += v;
            }
        }
        let [p, f, pp, ff, pf] = sums;
        let (vp, vf, cov) = (pp - p * p / n, ff - f * f / n, pf - p * f / n);
        // Of half or twice the depth it is another thing.
        let slope = cov / vp.max(1e-12);
        let explained = cov * cov / (vp * vf).max(1e-18);
        if (0.5..2.0).contains(&slope) {
            explained
        } else {
            0.0
        }
    };
    let mut shares: Vec<f64> = frames.iter().map(explained).collect();
    shares.sort_by(f64::total_cmp);
    shares[shares.len() / 2] >= EXPLAINS
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::SplitMix64;

    const SIZE: [usize; 2] = [200, 160];
    const NOISE: f32 = 0.01;

    /// In [0, 1).
    fn unit(rng: &mut SplitMix64) -> f64 {
        (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn lamp(x: f32, y: f32) -> f32 {
        let (u, v) = (x / 100.0 - 1.0, y / 80.0 - 1.0);
        0.8 - 0.1 * u * u - 0.08 * v * v + 0.03 * u
    }

    /// What each of these takes away: x, y, radius and depth of round spots.
    fn spots(list: &[[f32; 4]], x: f32, y: f32) -> f32 {
        let one = |s: &[f32; 4]| {
            let d = (x - s[0]).hypot(y - s[1]);
            1.0 - s[3] / (1.0 + ((d - s[2]) * 1.5).exp())
        };
        list.iter().map(one).product()
    }

    const DUST: [[f32; 4]; 4] = [
        [50.0, 40.0, 6.0, 0.5],
        [150.0, 30.0, 12.0, 0.12],
        [90.0, 120.0, 4.0, 0.8],
        [30.0, 130.0, 9.0, 0.2],
    ];

    fn frame(cells: &[[f32; 4]], dust: &[[f32; 4]], way: [f32; 2], seed: u64) -> GrayImage {
        let mut rng = SplitMix64::new(seed);
        let mut noise = || {
            let sum: f64 = (0..12).map(|_| unit(&mut rng)).sum();
            (sum - 6.0) as f32
        };
        GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| {
            let (x, y) = (x as f32, y as f32);
            let light = lamp(x, y) * spots(dust, x, y);
            light * spots(cells, x - way[0], y - way[1]) * (1.0 + NOISE * noise())
        })
        .unwrap()
    }

    fn cells(count: usize, seed: u64) -> Vec<[f32; 4]> {
        let mut rng = SplitMix64::new(seed);
        let mut within = |lo: f64, hi: f64| (lo + (hi - lo) * unit(&mut rng)) as f32;
        (0..count)
            .map(|_| {
                [
                    within(-60.0, 260.0),
                    within(-60.0, 220.0),
                    within(3.0, 10.0),
                    within(0.2, 0.7),
                ]
            })
            .collect()
    }

    fn looks(cells: &[[f32; 4]], dust: &[[f32; 4]]) -> Vec<GrayImage> {
        let ways = [[0.0, 0.0], [40.0, 0.0], [0.0, 40.0], [40.0, 40.0]];
        let seen = ways.iter().zip(1..);
        seen.map(|(way, seed)| frame(cells, dust, *way, seed))
            .collect()
    }

    #[test]
    fn dust_is_found_and_cells_are_not() {
        let pattern = fixed_pattern(&looks(&cells(40, 5), &DUST)).unwrap();
        assert_eq!(pattern.shadows(), DUST.len());
        for (i, t) in pattern.transmission().iter().enumerate() {
            let (x, y) = ((i % SIZE[0]) as f32, (i / SIZE[0]) as f32);
            let truth = spots(&DUST, x, y).max(0.25);
            // Edges are blurred by the smoothing.
            let edge = DUST
                .iter()
                .any(|d| ((x - d[0]).hypot(y - d[1]) - d[2]).abs() < 4.0);
            assert!(
                (t - truth).abs() < if edge { 0.15 } else { 0.04 },
                "{x} {y} {t} {truth}"
            );
        }
    }

    #[test]
    fn a_clean_camera_has_no_shadows() {
        for seed in 0..6 {
            let pattern = fixed_pattern(&looks(&cells(40, seed), &[])).unwrap();
            assert_eq!(pattern.shadows(), 0, "seed {seed}");
        }
    }

    #[test]
    fn where_no_pixel_was_ever_empty_nothing_is_claimed() {
        let dense = fixed_pattern(&looks(&cells(900, 5), &DUST));
        let shadows = dense.map_or(0, |d| d.shadows());
        assert!(shadows <= DUST.len(), "{shadows}");
    }
}

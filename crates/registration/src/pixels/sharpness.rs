//! How sharp a view is beside its target, over the specimen that both show.
//!
//! Each block that agrees (see [`weigh`](super::weigh)) is looked at in both images as they are, without any sampling between their pixels. The
//! power of a fine band over that of a coarser one, the noise's share taken off both, is free of light, gain and stain. What the same ratio
//! becomes when the sharper image is blurred further turns it into a variance of blur: how much softer the view is. Blocks are asked one by one,
//! and their median is the answer, so that what covers a few of them does not count. Where both images are out of focus there is nothing in a
//! fine band: the same is asked of images that are binned, and the best known answer is taken.

use super::{Pictures, weigh};
use scopeservo_features::{GrayImage, Mask};
use scopeservo_geometry::{Affine2, Vec2};
use serde::{Deserialize, Serialize};

/// The bands: differences between Gaussians of these standard deviations, pixels.
const SIGMAS_PX: [f64; 3] = [0.6, 1.2, 2.4];
/// Further blur of the sharper image: variances, squares of pixels.
const FURTHER_PX2: [f64; 6] = [0.0, 0.1, 0.25, 0.6, 1.2, 2.4];
/// More than this is asked of binned images.
const SEEN_PX2: f64 = 2.0;
/// The least logarithm of a ratio that is told.
const MOST_LOG_RATIO: f64 = 7.0;
/// Radius of the disc in which power counts, pixels, and how far the widest kernel reaches.
const RADIUS: usize = 15;
const REACH: usize = 9;
const SIDE: usize = 2 * (RADIUS + REACH) + 1;
/// Images are binned by two so often.
const LEVELS: usize = 3;
/// Of a block at most this share is at an end of what the camera tells.
const CLIPPED: f64 = 0.02;
/// Fewer blocks than this tell nothing.
const LEAST_BLOCKS: usize = 8;
/// In both bands the sharper image has so many times the power of the noise, besides that.
const ABOVE_NOISE: f64 = 2.0;
/// Images whose pixels differ by more than this share are not compared: what one does not resolve is no blur.
const SAME_SCALE: f64 = 0.05;

/// How sharp a view is beside its target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sharpness {
    /// The variance of blur that the view has more than the target, squares of pixels; negative where it is sharper.
    pub softer_px2: f64,
    /// Standard deviation of that, by the scatter of the blocks.
    pub sigma_px2: f64,
    /// Power of fine detail in the view over that in the target, beside what both have of coarser detail.
    pub ratio: f64,
    /// Blocks that tell it.
    pub blocks: usize,
}

/// How sharp the view is beside the target. `None` where too few blocks agree or stand out of the noise.
pub fn sharpness(pictures: &Pictures<'_>, target_from_view: &Affine2) -> Option<Sharpness> {
    let scale = target_from_view.linear.det().abs().sqrt();
    if scale.is_nan() || (scale - 1.0).abs() > SAME_SCALE {
        return None;
    }
    let mut places: Vec<[Vec2; 2]> = weigh(pictures, target_from_view, &[])
        .blocks
        .iter()
        .filter(|witness| witness.agrees)
        .map(|witness| [witness.in_view, target_from_view.apply(witness.in_view)])
        .collect();
    let mut view = Side::of(pictures.view, pictures.of_view);
    let mut target = Side::of(pictures.target, pictures.of_target);
    let kernels = Kernels::new();
    let mut best = None;
    for level in 0..LEVELS {
        if level > 0 {
            (view, target) = (view.binned(), target.binned());
            let halved = |p: Vec2| p.map(|v| (v - 0.5) / 2.0);
            places.iter_mut().flatten().for_each(|p| *p = halved(*p));
        }
        let blocks: Vec<Block> = places
            .iter()
            .filter_map(|&[p, q]| Block::of(&view.around(p)?, &target.around(q)?, &kernels))
            .collect();
        let unit = f64::from(1u32 << (2 * level));
        let now = judged(&blocks, unit);
        match now {
            Some((found, true)) => return Some(found),
            // Softer than this level sees; a coarser one may tell by how much.
            Some((found, false)) => best = Some(found),
            None => {}
        }
    }
    best
}

/// The median of the blocks and its standard deviation, and whether it is more than a bound. `unit`: the square of a pixel's side.
fn judged(blocks: &[Block], unit: f64) -> Option<(Sharpness, bool)> {
    if blocks.len() < LEAST_BLOCKS {
        return None;
    }
    let softer_px2 = median(blocks.iter().map(|b| b.softer_px2));
    let off = median(blocks.iter().map(|b| (b.softer_px2 - softer_px2).abs()));
    // The median's standard deviation is 1.25 times the mean's.
    let sigma = 1.25 * 1.4826 * off / (blocks.len() as f64).sqrt();
    let found = Sharpness {
        softer_px2: unit * softer_px2,
        sigma_px2: unit * sigma,
        ratio: median(blocks.iter().map(|b| b.log_ratio)).exp(),
        blocks: blocks.len(),
    };
    Some((found, softer_px2.abs() <= SEEN_PX2))
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    match values.is_empty() {
        true => f64::NAN,
        false => *values.select_nth_unstable_by(middle, f64::total_cmp).1,
    }
}

/// What a block of both images says.
#[derive(Debug, Clone, Copy)]
struct Block {
    softer_px2: f64,
    log_ratio: f64,
}

impl Block {
    /// `None` where the sharper of the two is not above its noise.
    fn of(view: &Window, target: &Window, kernels: &Kernels) -> Option<Self> {
        let (a, b) = (view.fineness(kernels, 0), target.fineness(kernels, 0));
        let is_softer = a.unwrap_or(0.0) <= b.unwrap_or(0.0);
        let (sharp, top, soft, sign) = match is_softer {
            true => (target, b?, a, 1.0),
            false => (view, a?, b, -1.0),
        };
        // What is left of the softer one may be noise: it is as soft as can be told then.
        let top = top.ln();
        let seen = soft.map_or(f64::NEG_INFINITY, f64::ln);
        let mut before = (0.0, top);
        let mut softer_px2 = None;
        for (further, px2) in FURTHER_PX2.into_iter().enumerate().skip(1) {
            let Some(now) = sharp.fineness(kernels, further) else {
                break;
            };
            let now = (px2, now.ln().min(before.1 - 1e-6));
            if now.1 <= seen {
                let share = (before.1 - seen) / (before.1 - now.1);
                softer_px2 = Some(before.0 + share * (now.0 - before.0));
                break;
            }
            before = now;
        }
        Some(Self {
            softer_px2: sign * softer_px2.unwrap_or(2.0 * SEEN_PX2),
            log_ratio: sign * (seen.max(top - MOST_LOG_RATIO) - top),
        })
    }
}

/// The Gaussians of each further blur, and what noise of a variance of one leaves in the bands.
struct Kernels {
    taps: [[Vec<f32>; 3]; FURTHER_PX2.len()],
    noise: [[f64; 2]; FURTHER_PX2.len()],
    disc: Vec<f32>,
}

impl Kernels {
    fn new() -> Self {
        let taps = FURTHER_PX2
            .map(|further| SIGMAS_PX.map(|sigma| gaussian((sigma * sigma + further).sqrt())));
        let product = |a: &[f32], b: &[f32]| -> f64 {
            let sum: f64 = std::iter::zip(a, b).map(|(x, y)| f64::from(x * y)).sum();
            (2.0 * sum - f64::from(a[0] * b[0])).powi(2)
        };
        let band = |a: &[f32], b: &[f32]| product(a, a) + product(b, b) - 2.0 * product(a, b);
        let noise = std::array::from_fn(|k| {
            let [a, b, c] = &taps[k];
            [band(a, b), band(b, c)]
        });
        let disc = (0..(2 * RADIUS + 1).pow(2)).map(|i| {
            let at = |v: usize| (v as f32 - RADIUS as f32) / (RADIUS as f32 + 1.0);
            let (x, y) = (at(i % (2 * RADIUS + 1)), at(i / (2 * RADIUS + 1)));
            (1.0 - x * x - y * y).max(0.0).powi(2)
        });
        Self {
            noise,
            disc: disc.collect(),
            taps,
        }
    }
}

/// Half of a Gaussian from its middle on, of sum one with its other half.
fn gaussian(sigma_px: f64) -> Vec<f32> {
    let reach = (4.0 * sigma_px).ceil().min(REACH as f64) as usize;
    let taps: Vec<f64> = (0..=reach)
        .map(|d| (-0.5 * (d as f64 / sigma_px).powi(2)).exp())
        .collect();
    let sum = 2.0 * taps.iter().sum::<f64>() - taps[0];
    taps.iter().map(|t| (t / sum) as f32).collect()
}

/// One image at one level.
struct Side<'a> {
    image: std::borrow::Cow<'a, [f32]>,
    size: [usize; 2],
    mask: Option<&'a Mask>,
    /// Pixels of the image as it came in one of these.
    bin: f64,
    /// Variance of the noise per light.
    noise: f64,
    /// Values at the ends of what the camera tells.
    clipped: [f32; 2],
}

impl<'a> Side<'a> {
    fn of(image: &'a GrayImage, mask: Option<&'a Mask>) -> Self {
        let (low, high) = image
            .data()
            .iter()
            .fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), &v| {
                (a.min(v), b.max(v))
            });
        Self {
            image: image.data().into(),
            size: [image.width(), image.height()],
            mask,
            bin: 1.0,
            noise: noise_per_light(image, [low, high]),
            clipped: [low, high],
        }
    }

    fn binned(&self) -> Self {
        let size = self.size.map(|side| side / 2);
        let w = self.size[0];
        let image = (0..size[0] * size[1]).map(|i| {
            let k = 2 * (i / size[0]) * w + 2 * (i % size[0]);
            0.25 * (self.image[k] + self.image[k + 1] + self.image[k + w] + self.image[k + w + 1])
        });
        Self {
            image: image.collect(),
            size,
            bin: 2.0 * self.bin,
            noise: self.noise / 4.0,
            ..*self
        }
    }

    /// What is around a place. `None` where the image ends, or something is left out or clipped.
    fn around(&self, p: Vec2) -> Option<Window> {
        const HALF: usize = RADIUS + REACH;
        let [x, y] = p.map(f64::round);
        let fits = |v: f64, side: usize| v >= HALF as f64 && v + (HALF as f64) < side as f64;
        if !(fits(x, self.size[0]) && fits(y, self.size[1]) && self.counts([x, y])) {
            return None;
        }
        let (left, top) = (x as usize - HALF, y as usize - HALF);
        let rows = (0..SIDE).map(|row| &self.image[(top + row) * self.size[0] + left..][..SIDE]);
        let values: Vec<f32> = rows.flatten().copied().collect();
        let light = f64::from(values.iter().sum::<f32>()) / values.len() as f64;
        let clipped = |v: &&f32| **v <= self.clipped[0] || **v >= self.clipped[1];
        let few = values.iter().filter(clipped).count() as f64 <= CLIPPED * values.len() as f64;
        few.then(|| Window {
            values,
            variance: self.noise * light.max(0.0),
        })
    }

    /// Whether the mask leaves all of a disc.
    fn counts(&self, [x, y]: Vec2) -> bool {
        let Some(mask) = self.mask else { return true };
        let reach = RADIUS as f64;
        let steps = || (-2..=2).map(|k| f64::from(k) * reach / 2.0);
        let at = |v: f64| (v + 0.5) * self.bin - 0.5;
        let inside = |dx: f64, dy: f64| dx * dx + dy * dy <= reach * reach;
        steps().all(|dy| steps().all(|dx| !inside(dx, dy) || mask.holds([at(x + dx), at(y + dy)])))
    }
}

/// A square of an image, and the variance of its noise.
struct Window {
    values: Vec<f32>,
    variance: f64,
}

impl Window {
    /// Power of the fine band over that of the coarse one, after a further blur; `None` where either is not above the noise.
    fn fineness(&self, kernels: &Kernels, further: usize) -> Option<f64> {
        let [a, b, c] = kernels.taps[further].each_ref().map(|t| self.blurred(t));
        let seen = [power(&a, &b, &kernels.disc), power(&b, &c, &kernels.disc)];
        let noise = kernels.noise[further].map(|gain| gain * self.variance);
        // What was above the noise before stays so for long.
        let least = if further == 0 { 1.0 + ABOVE_NOISE } else { 1.0 };
        let above = (0..2).all(|k| seen[k] > least * noise[k]);
        above.then(|| (seen[0] - noise[0]) / (seen[1] - noise[1]))
    }

    /// Its middle, blurred.
    fn blurred(&self, taps: &[f32]) -> Vec<f32> {
        const INNER: usize = 2 * RADIUS + 1;
        let mut along = vec![0.0f32; SIDE * INNER];
        for (out, row) in along
            .chunks_exact_mut(INNER)
            .zip(self.values.chunks_exact(SIDE))
        {
            for (out, v) in out.iter_mut().zip(&row[REACH..]) {
                *out = taps[0] * v;
            }
            for (d, tap) in taps.iter().enumerate().skip(1) {
                let sides = row[REACH - d..].iter().zip(&row[REACH + d..]);
                for (out, (a, b)) in out.iter_mut().zip(sides) {
                    *out += tap * (a + b);
                }
            }
        }
        let mut inner = vec![0.0f32; INNER * INNER];
        for (y, out) in inner.chunks_exact_mut(INNER).enumerate() {
            let row = |k: usize| &along[k * INNER..][..INNER];
            for (out, v) in out.iter_mut().zip(row(y + REACH)) {
                *out = taps[0] * v;
            }
            for (d, tap) in taps.iter().enumerate().skip(1) {
                let sides = row(y + REACH - d).iter().zip(row(y + REACH + d));
                for (out, (a, b)) in out.iter_mut().zip(sides) {
                    *out += tap * (a + b);
                }
            }
        }
        inner
    }
}

/// The mean square of a difference over the disc.
fn power(a: &[f32], b: &[f32], disc: &[f32]) -> f64 {
    let (mut sum, mut weight) = (0.0f64, 0.0f64);
    for ((a, b), w) in a.iter().zip(b).zip(disc) {
        sum += f64::from(w * (a - b).powi(2));
        weight += f64::from(*w);
    }
    sum / weight
}

/// Side of the blocks that are asked for noise, pixels.
const NOISE_SIDE: usize = 32;
/// Of a large image only some are asked, about so many.
const MOST_NOISE: usize = 400;
/// Of all blocks this share has less noise per light than is said: structure is rarely everywhere.
const QUIET: f64 = 0.1;

/// The variance of the noise over the light, of the quietest blocks. What is clipped has none, and tells nothing of the rest.
fn noise_per_light(image: &GrayImage, [low, high]: [f32; 2]) -> f64 {
    let (w, h, data) = (image.width(), image.height(), image.data());
    let mut all = Vec::new();
    let apart = NOISE_SIDE
        * (w * h / (MOST_NOISE * NOISE_SIDE * NOISE_SIDE))
            .isqrt()
            .max(1);
    for top in (1..h.saturating_sub(NOISE_SIDE + 1)).step_by(apart) {
        for left in (1..w.saturating_sub(NOISE_SIDE + 1)).step_by(apart) {
            let (mut sum, mut light, mut clipped) = (0.0f32, 0.0f32, 0);
            for y in top..top + NOISE_SIDE {
                for k in y * w + left..y * w + left + NOISE_SIDE {
                    let v = |k: usize| data[k];
                    // Blind to slopes and to curvature along an axis: (Immerkaer, 1996).
                    let corners = v(k - w - 1) + v(k - w + 1) + v(k + w - 1) + v(k + w + 1);
                    let sides = v(k - 1) + v(k + 1) + v(k - w) + v(k + w);
                    sum += (corners - 2.0 * sides + 4.0 * v(k)).powi(2);
                    light += v(k);
                    clipped += usize::from(v(k) <= low || v(k) >= high);
                }
            }
            let few = clipped as f64 <= CLIPPED * (NOISE_SIDE * NOISE_SIDE) as f64;
            if light > 0.0 && few {
                all.push(f64::from(sum / 36.0 / light));
            }
        }
    }
    if all.is_empty() {
        return 0.0;
    }
    let quiet = (all.len() as f64 * QUIET) as usize;
    *all.select_nth_unstable_by(quiet, f64::total_cmp).1
}

//! The height at which each block of a view is sharpest.

use crate::focus::{FocusMeasure, Peak, Point, Sample};
use serde::{Deserialize, Serialize};

/// What changes by less than this share, beyond noise, may be the lamp.
const SHAKES: f64 = 0.005;
/// A block has a focus of its own where it is sharper there than at both ends of the sweep by this factor.
const CONTRAST: f64 = 1.15;
/// A fit that explains less than this of a block's samples is none.
const GOOD: f64 = 0.8;
/// A height that is known worse than this share of the level's width says nothing.
const KNOWN: f64 = 0.5;
/// Samples farther from the sharpest one than so many widths of the level say little of where it is.
const REACH: f64 = 1.6;

/// Where one block of the view is sharpest.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BlockHeight {
    /// Its column and row among the blocks.
    pub cell: [usize; 2],
    /// Its middle, px from that of the image: to the right and down.
    pub at_px: [f64; 2],
    /// The stage's z at which it is sharpest, um.
    pub z_um: f64,
    /// Standard deviation of that, um.
    pub sigma_um: f64,
    /// Whether it counts; else it lies elsewhere than most.
    pub used: bool,
}

/// What the blocks of a sweep say.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Seen {
    /// Those with a focus of their own.
    pub(super) heights: Vec<BlockHeight>,
    /// How many blocks the view has.
    pub(super) all: usize,
    /// Blocks that are sharpest at the lower end of the sweep, and at the upper one.
    pub(super) at_ends: [usize; 2],
}

/// What is known of how a sweep was made.
pub(super) struct Sweep<'a> {
    /// Ascending.
    pub(super) samples: &'a [Sample],
    pub(super) measure: &'a dyn FocusMeasure,
    pub(super) image_px: [usize; 2],
    /// Defocus that blurs as much as the finest level does, um.
    pub(super) width_um: f64,
    /// How arrivals usually scatter, um.
    pub(super) usual_um: f64,
}

impl Sweep<'_> {
    /// The heights on a level of detail: 0 is the finest.
    pub(super) fn heights(&self, level: usize) -> Seen {
        let first = self.samples.first().and_then(|s| s.levels.get(level));
        let Some((first, shape)) = first.map(|cells| (cells, cells.shape())) else {
            return Seen::default();
        };
        let mut seen = Seen {
            all: first.len(),
            ..Seen::default()
        };
        let width_um = self.width_um * f64::from(1u32 << level);
        for k in 0..seen.all {
            let points = self.points(level, k);
            let best =
                (0..points.len()).max_by(|&a, &b| points[a].value.total_cmp(&points[b].value));
            let Some(best) = best else { continue };
            let top = points[best];
            let above = |side: &[Point]| side.iter().any(|p| top.above(p, CONTRAST));
            let falls = [above(&points[..best]), above(&points[best + 1..])];
            match falls {
                [true, true] => {}
                // It gets sharper towards an end for sure.
                [false, true] => seen.at_ends[0] += 1,
                [true, false] => seen.at_ends[1] += 1,
                [false, false] => {}
            }
            if falls != [true, true] {
                continue;
            }
            let near = |p: &&Point| (p.z_um - top.z_um).abs() <= REACH * width_um;
            let near: Vec<Point> = points.iter().filter(near).copied().collect();
            let ends = [points[0].z_um, points[points.len() - 1].z_um];
            let peak = Peak::of(&near, self.usual_um).filter(|p| {
                p.goodness >= GOOD
                    && p.sigma_um <= KNOWN * width_um
                    && (ends[0]..=ends[1]).contains(&p.z_um)
            });
            let Some(peak) = peak else { continue };
            let cell = [k % shape[0], k / shape[0]];
            let middle = |axis: usize| {
                let side = self.image_px[axis] as f64;
                side * ((cell[axis] as f64 + 0.5) / shape[axis] as f64 - 0.5)
            };
            seen.heights.push(BlockHeight {
                cell,
                at_px: [middle(0), middle(1)],
                z_um: peak.z_um,
                sigma_um: peak.sigma_um,
                used: true,
            });
        }
        seen
    }

    /// Sharpness against height in one block, the noise's share taken off.
    fn points(&self, level: usize, cell: usize) -> Vec<Point> {
        let gain = self.measure.noise_gain()[level];
        let correlation = self.measure.correlation()[level];
        let lights = self.samples.iter().map(|s| s.light);
        let light = lights.sum::<f64>() / self.samples.len() as f64;
        let noises = self.samples.iter().map(|s| s.noise);
        let noise = noises.reduce(|a, b| a.least(b, light)).unwrap_or_default();
        let at_level = self.samples.iter().filter(|s| level < s.levels.len());
        let of = |s: &Sample| s.levels[level].get(cell);
        let floor = at_level.clone().map(of).fold(f64::INFINITY, f64::min);
        at_level
            .map(|s| {
                let seen = of(s);
                let share = gain * noise.variance(s.light) / s.light.max(1e-12).powi(2);
                let independent = (s.levels[level].count / correlation).max(1.0);
                // Noise alone has the square of its power, beside a signal twice the product of both.
                let noisy = floor.min(2.0 * share);
                let of_noise = noisy * (noisy + 2.0 * (seen - noisy)) * 2.0 / independent;
                Point {
                    z_um: s.z_um,
                    value: seen - share,
                    sigma: f64::hypot(of_noise.max(0.0).sqrt(), SHAKES * seen),
                }
            })
            .collect()
    }
}

//! Sharpness against height.

use super::measure::FocusMeasure;
use super::peak::Peak;
use super::point::Point;
use super::sample::{Cells, Sample, constant};

/// What changes by less than this share, beyond noise, may be the lamp, or the room.
const SHAKES: f64 = 0.01;

/// The samples on one level, ascending.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Curve(pub(crate) Vec<Point>);

impl Curve {
    /// Of samples in ascending order. Cells that tell nothing of the focus do not count. `width_um`: defocus that blurs as much as the level.
    pub(crate) fn of(
        samples: &[Sample],
        level: usize,
        measure: &dyn FocusMeasure,
        contrast: f64,
        width_um: f64,
    ) -> Self {
        let (gain, correlation) = (measure.noise_gain()[level], measure.correlation()[level]);
        let cells: Vec<&Cells> = samples.iter().filter_map(|s| s.levels.get(level)).collect();
        let (first, last) = (samples.first(), samples.last());
        let span = first.zip(last).map_or(0.0, |(a, b)| b.z_um - a.z_um);
        let left_out = constant(&cells, contrast * contrast, correlation, span / width_um);
        let light = samples.iter().map(|s| s.light).sum::<f64>() / samples.len().max(1) as f64;
        let noises = samples.iter().map(|s| s.noise);
        let noise = noises.reduce(|a, b| a.least(b, light)).unwrap_or_default();
        let at_level = samples.iter().filter(|s| level < s.levels.len());
        let all: Vec<(&Sample, f64, usize)> = at_level
            .map(|s| {
                let (seen, counted) = s.levels[level].without(&left_out);
                (s, seen, counted)
            })
            .collect();
        // What is there in the least sharp image may all be noise, however its pixels share it.
        let floor = all
            .iter()
            .map(|(_, seen, _)| *seen)
            .fold(f64::INFINITY, f64::min);
        let point = |&(s, seen, counted): &(&Sample, f64, usize)| {
            let share = gain * noise.variance(s.light) / s.light.max(1e-12).powi(2);
            let independent = s.levels[level].count * counted as f64 / correlation;
            // Noise alone has the square of its power, beside a signal twice the product of both.
            let of_noise = floor * (floor + 2.0 * (seen - floor)) * 2.0 / independent.max(1.0);
            Point {
                z_um: s.z_um,
                value: seen - share,
                sigma: f64::hypot(of_noise.sqrt(), SHAKES * seen),
            }
        };
        Self(all.iter().map(point).collect())
    }

    /// The sharpest.
    pub(crate) fn best(&self) -> Option<usize> {
        (0..self.0.len()).max_by(|&a, &b| self.0[a].value.total_cmp(&self.0[b].value))
    }

    /// Those about a height.
    pub(crate) fn within(&self, z_um: f64, reach_um: f64) -> Vec<Point> {
        let near = |p: &&Point| (p.z_um - z_um).abs() <= reach_um;
        self.0.iter().filter(near).copied().collect()
    }

    /// Sharpest over least sharp.
    pub(crate) fn contrast(&self) -> f64 {
        let best = self.best().map_or(0.0, |i| self.0[i].value);
        let least = self.0.iter().map(|p| p.value.max(p.sigma));
        best / least.fold(f64::INFINITY, f64::min).max(1e-12)
    }

    /// The sharpest, where it is sharper for sure than some other.
    pub(crate) fn stands_out(&self, contrast: f64) -> Option<usize> {
        let best = self.best()?;
        let above = self.0.iter().any(|p| self.0[best].above(p, contrast));
        above.then_some(best)
    }

    /// The peak between samples that are less sharp for sure on both sides.
    pub(crate) fn bracketed(&self, contrast: f64) -> Option<usize> {
        let best = self.best()?;
        let falls = |side: &[Point]| side.iter().any(|p| self.0[best].above(p, contrast));
        (falls(&self.0[..best]) && falls(&self.0[best + 1..])).then_some(best)
    }

    /// Which end is the sharpest for sure: -1 the lower one, 1 the upper one.
    pub(crate) fn rises_at(&self, contrast: f64) -> Option<f64> {
        let best = self.best()?;
        let rises = self.0.iter().any(|p| self.0[best].above(p, contrast));
        match best {
            _ if !rises || self.0.len() < 2 => None,
            0 => Some(-1.0),
            last if last + 1 == self.0.len() => Some(1.0),
            _ => None,
        }
    }

    /// Whether each of the last three samples towards an end is sharper for sure than the one before.
    pub(crate) fn rises_steadily(&self, contrast: f64) -> bool {
        let n = self.0.len();
        let rises = |a: &Point, b: &Point, c: &Point| b.above(a, contrast) && c.above(b, contrast);
        let [first, last] = match n {
            0..3 => return false,
            _ => [[2, 1, 0], [n - 3, n - 2, n - 1]].map(|i| i.map(|i| &self.0[i])),
        };
        rises(first[0], first[1], first[2]) || rises(last[0], last[1], last[2])
    }

    /// How far the sharpest sample is from its farther neighbour.
    pub(crate) fn gap(&self, best: usize) -> f64 {
        let z = |i: usize| self.0.get(i).map(|p| p.z_um);
        let here = self.0[best].z_um;
        let beside = [best.checked_sub(1).and_then(z), z(best + 1)];
        let ways = beside.into_iter().flatten().map(|z| (z - here).abs());
        ways.fold(0.0, f64::max)
    }

    /// Where the top lies by the samples beside the sharpest, between them. `usual_um`: as for [`Peak::of`].
    pub(crate) fn rough_top(&self, best: usize, usual_um: f64) -> f64 {
        let around = &self.0[best.saturating_sub(1)..(best + 2).min(self.0.len())];
        let top = Peak::of(around, usual_um).map(|peak| peak.z_um);
        let (first, last) = (around[0].z_um, around[around.len() - 1].z_um);
        top.map_or(self.0[best].z_um, |z| z.clamp(first, last))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(z_um: f64, value: f64) -> Point {
        Point {
            z_um,
            value,
            sigma: 1e-3 * value,
        }
    }

    #[test]
    fn a_valley_a_slope_and_too_few_samples_have_no_peak() {
        let of = |values: &[f64]| {
            let points = (0..).zip(values).map(|(k, v)| point(f64::from(k), *v));
            Peak::of(&points.collect::<Vec<_>>(), 0.1)
        };
        assert_eq!(of(&[3.0, 2.0, 1.0, 2.0, 3.0]), None);
        assert_eq!(of(&[1.0, 2.0]), None);
        let slope = Curve(
            (0..5)
                .map(|k| point(f64::from(k), 1.0 + f64::from(k)))
                .collect(),
        );
        assert_eq!(slope.bracketed(1.04), None);
        assert_eq!(slope.rises_at(1.04), Some(1.0));
    }

    #[test]
    fn what_noise_explains_is_no_peak() {
        let points = [1.0, 1.01, 1.03, 1.005, 1.0];
        let noisy = (0..).zip(points).map(|(k, v)| Point {
            sigma: 0.01,
            ..point(f64::from(k), v)
        });
        let curve = Curve(noisy.collect());
        assert_eq!((curve.bracketed(1.04), curve.rises_at(1.04)), (None, None));
    }
}

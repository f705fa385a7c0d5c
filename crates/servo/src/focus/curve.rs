//! Sharpness against height, and its peak.

use super::measure::FocusMeasure;
use super::sample::{Cells, Sample, constant};
use scopeservo_geometry::least_squares;

/// What changes by less than this share, beyond noise, may be the lamp, or the room.
const SHAKES: f64 = 0.01;
/// One sample is sharper than another for sure beyond so many standard deviations of their difference.
const SURE_SIGMAS: f64 = 6.0;

/// A sample on one level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    pub(crate) z_um: f64,
    /// The measure over the light, the noise's share taken off.
    pub(crate) value: f64,
    pub(crate) sigma: f64,
}

impl Point {
    /// Whether it is sharper for sure, and by a factor of `contrast`.
    pub(crate) fn above(&self, other: &Self, contrast: f64) -> bool {
        let sigma = f64::hypot(self.sigma, other.sigma);
        let base = other.value.max(0.0);
        self.value - other.value > SURE_SIGMAS * sigma && self.value > contrast * base
    }
}

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

    /// Where the top lies by the samples beside the sharpest, between them.
    pub(crate) fn rough_top(&self, best: usize) -> f64 {
        let around = &self.0[best.saturating_sub(1)..(best + 2).min(self.0.len())];
        let top = Peak::of(around).map(|peak| peak.z_um);
        let (first, last) = (around[0].z_um, around[around.len() - 1].z_um);
        top.map_or(self.0[best].z_um, |z| z.clamp(first, last))
    }
}

/// A fitted peak.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Peak {
    pub(crate) z_um: f64,
    /// Standard deviation of that, by the scatter about the fit, or by the noise of the samples where that is more.
    pub(crate) sigma_um: f64,
    /// Share of the samples' variation that the fit explains.
    pub(crate) goodness: f64,
}

impl Peak {
    /// The lowest place of a curve through one over the root of the values: about a focus the blur's variance grows with the square of
    /// the height. With five points or more a cubic, as the blur on the one side is not that on the other. `None` where it does not bend
    /// so.
    pub(crate) fn of(points: &[Point]) -> Option<Self> {
        let middle = points.iter().map(|p| p.z_um).sum::<f64>() / points.len() as f64;
        let off = points.iter().map(|p| (p.z_um - middle).abs());
        let reach = off.fold(0.0, f64::max);
        if points.len() < 3 || reach <= 0.0 {
            return None;
        }
        let top = points.iter().map(|p| p.value).fold(0.0, f64::max);
        let rows: Vec<[f64; 3]> = points
            .iter()
            .map(|p| {
                let value = (p.value / top).max(p.sigma / top).max(1e-6);
                // What is far down the slope weighs little: by the change of the blur with the value.
                [(p.z_um - middle) / reach, value.powf(-0.5), value.powf(1.5)]
            })
            .collect();
        // What the noise of the samples is in these rows; few samples may scatter less by chance.
        let noises = points.iter().map(|p| (0.5 * p.sigma / top).powi(2));
        let noise = noises.sum::<f64>() / points.len() as f64;
        let (by_parabola, cubic) = (fitted::<3>(&rows, noise)?, fitted::<4>(&rows, noise));
        let fit = match cubic.filter(|_| points.len() >= 5) {
            Some(cubic) if (cubic.u - by_parabola.u).abs() < FAR_APART => cubic,
            _ => by_parabola,
        };
        Some(Self {
            z_um: middle + reach * fit.u,
            sigma_um: reach * fit.sigma,
            goodness: fit.goodness,
        })
    }
}

/// A cubic that has its lowest place this far from the parabola's, in half-widths of what was fitted, follows noise.
const FAR_APART: f64 = 0.5;

/// The lowest place of a fitted polynomial.
struct Lowest {
    u: f64,
    sigma: f64,
    goodness: f64,
}

/// A polynomial of N coefficients through rows of place, value and weight, and its lowest place within. `noise`: variance of a row.
fn fitted<const N: usize>(rows: &[[f64; 3]], noise: f64) -> Option<Lowest> {
    let powers = |u: f64| std::array::from_fn::<f64, N, _>(|k| u.powi(k as i32));
    let equations: Vec<([f64; N], f64)> = rows
        .iter()
        .map(|&[u, value, weight]| (powers(u).map(|p| weight * p), weight * value))
        .collect();
    let (c, covariance) = least_squares(&equations)?;
    let slope = |u: f64| {
        (1..N)
            .map(|k| k as f64 * c[k] * u.powi(k as i32 - 1))
            .sum::<f64>()
    };
    let bend = |u: f64| {
        let term = |k: usize| (k * (k - 1)) as f64 * c[k] * u.powi(k as i32 - 2);
        (2..N).map(term).sum::<f64>()
    };
    // Newton's steps from the parabola's part.
    let mut u = -c[1] / (2.0 * c[2]);
    for _ in 0..20 {
        let step = slope(u) / bend(u);
        u -= step;
        if step.abs() < 1e-9 {
            break;
        }
    }
    if !(bend(u) > 0.0 && u.abs() <= 3.0) {
        return None;
    }
    let squares: f64 = equations
        .iter()
        .map(|(row, seen)| (seen - (0..N).map(|k| row[k] * c[k]).sum::<f64>()).powi(2))
        .sum();
    let mean = rows.iter().map(|r| r[1]).sum::<f64>() / rows.len() as f64;
    let all: f64 = rows.iter().map(|r| (r[2] * (r[1] - mean)).powi(2)).sum();
    let scale = (squares / (rows.len() as f64 - N as f64).max(1.0)).max(noise);
    // du = -(the change of the slope at u) / bend.
    let gradient: [f64; N] = std::array::from_fn(|k| {
        if k == 0 {
            0.0
        } else {
            k as f64 * u.powi(k as i32 - 1)
        }
    });
    let mut variance = 0.0;
    for i in 0..N {
        for j in 0..N {
            variance += gradient[i] * covariance[i][j] * gradient[j];
        }
    }
    Some(Lowest {
        u,
        sigma: (scale * variance.max(0.0)).sqrt() / bend(u),
        goodness: 1.0 - squares / all.max(f64::MIN_POSITIVE),
    })
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
    fn the_peak_of_a_blurred_image_lies_between_its_samples() {
        // A band's power behind a Gaussian blur: 1 over the variance squared.
        for top in [-0.4, 0.0, 0.3] {
            let points: Vec<Point> = (-2..=2)
                .map(|k| {
                    let z = f64::from(k);
                    point(z, 3e-4 / (1.0 + 0.5 * (z - top) * (z - top)).powi(2))
                })
                .collect();
            let peak = Peak::of(&points).unwrap();
            assert!((peak.z_um - top).abs() < 0.02, "{top}: {peak:?}");
            assert!(peak.goodness > 0.99 && peak.sigma_um < 0.1, "{peak:?}");
        }
    }

    #[test]
    fn a_blur_that_is_wider_on_one_side_does_not_move_the_peak() {
        for top in [-0.3, 0.0, 0.2] {
            let points: Vec<Point> = (-2..=2)
                .map(|k| {
                    let z = f64::from(k) - top;
                    let wider = if z > 0.0 { 1.6 } else { 1.0 };
                    point(f64::from(k), 3e-4 / (1.0 + 0.5 * wider * z * z).powi(2))
                })
                .collect();
            let peak = Peak::of(&points).unwrap();
            assert!((peak.z_um - top).abs() < 0.08, "{top}: {peak:?}");
        }
    }

    #[test]
    fn a_valley_a_slope_and_too_few_samples_have_no_peak() {
        let of = |values: &[f64]| {
            let points = (0..).zip(values).map(|(k, v)| point(f64::from(k), *v));
            Peak::of(&points.collect::<Vec<_>>())
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

//! The peak of sharpness against height.

use super::point::Point;
use scopeservo_geometry::least_squares;
use serde::{Deserialize, Serialize};

/// A cubic that has its lowest place this far from the parabola's, in half-widths of what was fitted, follows noise.
const FAR_APART: f64 = 0.5;
/// So many arrivals' worth of what is usual counts beside those that were seen.
const USUAL: f64 = 2.0;
/// Rounds of weights that follow from the fit before.
const ROUNDS: usize = 4;

/// A fitted peak.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Peak {
    pub(crate) z_um: f64,
    /// Standard deviation of that, by the scatter about the fit, or by the noise of the samples where that is more.
    pub(crate) sigma_um: f64,
    /// Share of the samples' variation that the fit explains.
    pub(crate) goodness: f64,
    /// Standard deviation of an arrival about the height that was asked for.
    pub(crate) scatter_um: f64,
    /// So far off the peak one over the root of the value is twice what it is there.
    pub(crate) width_um: f64,
}

impl Peak {
    /// The lowest place of a curve through one over the root of the values: about a focus the blur's variance grows with the square of
    /// the height. With four points or more a cubic where they bear one, as the blur on the one side is not that on the other. A sample
    /// was taken where the stage arrived, not where it was sent: on the slope that counts more than noise, and so samples near the
    /// top have more weight. `usual_um`: how arrivals scatter when not enough was seen to tell. `None` where it does not bend so.
    pub(crate) fn of(points: &[Point], usual_um: f64) -> Option<Self> {
        let middle = points.iter().map(|p| p.z_um).sum::<f64>() / points.len() as f64;
        let off = points.iter().map(|p| (p.z_um - middle).abs());
        let reach = off.fold(0.0, f64::max);
        if points.len() < 3 || reach <= 0.0 {
            return None;
        }
        let top = points.iter().map(|p| p.value).fold(0.0, f64::max);
        let rows: Vec<Row> = points
            .iter()
            .map(|p| {
                let value = (p.value / top).max(p.sigma / top).max(1e-6);
                Row {
                    u: (p.z_um - middle) / reach,
                    value: value.powf(-0.5),
                    // By the change of the root with the value.
                    noise: 0.5 * p.sigma / top * value.powf(-1.5),
                }
            })
            .collect();
        let usual = usual_um / reach;
        let (by_parabola, cubic) = (settled::<3>(&rows, usual)?, settled::<4>(&rows, usual));
        let fit = match cubic.filter(|_| points.len() >= 4) {
            // What an asymmetric blur moves the parabola by is about what is usual for arrivals, too.
            Some(cubic)
                if (cubic.u - by_parabola.u).abs() < FAR_APART
                    && cubic.sigma < by_parabola.sigma.hypot(usual) =>
            {
                cubic
            }
            _ => by_parabola,
        };
        Some(Self {
            z_um: middle + reach * fit.u,
            sigma_um: reach * fit.sigma,
            goodness: fit.goodness,
            scatter_um: reach * fit.scatter,
            width_um: reach * (2.0 * fit.value / fit.bend).sqrt(),
        })
    }

    /// How far off the peak a value lies by itself, squared, where `top` is that of the peak; with the standard deviation of that.
    pub(crate) fn off_um2(&self, seen: &Point, top: f64) -> [f64; 2] {
        let share = (seen.value / top).max(seen.sigma / top).max(1e-6);
        let square = self.width_um.powi(2);
        let sigma = 0.5 * seen.sigma / top * share.powf(-1.5);
        [
            square * (share.powf(-0.5) - 1.0),
            square * std::f64::consts::SQRT_2 * sigma,
        ]
    }
}

/// Place, value, and the standard deviation of the value.
#[derive(Debug, Clone, Copy)]
struct Row {
    u: f64,
    value: f64,
    noise: f64,
}

impl Row {
    /// What is far down the slope weighs little in how good a fit is.
    fn weight(&self) -> f64 {
        self.value.powi(-3)
    }
}

/// A polynomial through rows, and its lowest place.
#[derive(Debug, Clone, Copy)]
struct Lowest {
    u: f64,
    sigma: f64,
    goodness: f64,
    /// Of the arrivals, as a standard deviation.
    scatter: f64,
    /// Value and second derivative there.
    value: f64,
    bend: f64,
}

/// Coefficients and their covariance.
type Fit<const N: usize> = ([f64; N], [[f64; N]; N]);

fn powers<const N: usize>(u: f64) -> [f64; N] {
    std::array::from_fn(|k| u.powi(k as i32))
}

fn value<const N: usize>(c: &[f64; N], u: f64) -> f64 {
    c.iter().rev().fold(0.0, |sum, c| sum * u + c)
}

fn derivative<const N: usize>(c: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|k| c.get(k + 1).map_or(0.0, |c| (k + 1) as f64 * c))
}

fn fitted<const N: usize>(rows: &[Row], sigma: impl Fn(&Row) -> f64) -> Option<Fit<N>> {
    let equations: Vec<([f64; N], f64)> = rows
        .iter()
        .map(|row| {
            let weight = 1.0 / sigma(row);
            (powers::<N>(row.u).map(|p| weight * p), weight * row.value)
        })
        .collect();
    least_squares(&equations)
}

/// A polynomial of N coefficients with its lowest place within, weighted by noise and by the scatter of the arrivals on its slope.
fn settled<const N: usize>(rows: &[Row], usual: f64) -> Option<Lowest> {
    let mut fit = fitted::<N>(rows, |row| 1.0 / row.weight())?;
    let mut scatter = usual;
    let free = (rows.len() as f64 - N as f64).max(0.0);
    for _ in 0..ROUNDS {
        let slope = derivative(&fit.0);
        let sigma = |row: &Row| row.noise.hypot(value(&slope, row.u) * scatter);
        fit = fitted::<N>(rows, sigma)?;
        let squares: f64 = rows
            .iter()
            .map(|row| ((row.value - value(&fit.0, row.u)) / sigma(row)).powi(2))
            .sum();
        scatter = ((scatter * scatter * squares + USUAL * usual * usual) / (free + USUAL)).sqrt();
    }
    let (c, covariance) = fit;
    let slope = derivative(&c);
    let bends = derivative(&slope);
    // Newton's steps from the parabola's part.
    let mut u = -c[1] / (2.0 * c[2]);
    for _ in 0..20 {
        let step = value(&slope, u) / value(&bends, u);
        u -= step;
        if step.abs() < 1e-9 {
            break;
        }
    }
    let (least, bend) = (value(&c, u), value(&bends, u));
    if !(bend > 0.0 && least > 0.0 && u.abs() <= 3.0) {
        return None;
    }
    // du = -(the change of the slope at u) / bend.
    let gradient: [f64; N] = std::array::from_fn(|k| match k {
        0 => 0.0,
        k => k as f64 * u.powi(k as i32 - 1),
    });
    let mut variance = 0.0;
    for i in 0..N {
        for j in 0..N {
            variance += gradient[i] * covariance[i][j] * gradient[j];
        }
    }
    let mean = rows.iter().map(|r| r.value).sum::<f64>() / rows.len() as f64;
    let squares = |of: &dyn Fn(&Row) -> f64| -> f64 {
        let square = |r: &Row| (r.weight() * (r.value - of(r))).powi(2);
        rows.iter().map(square).sum()
    };
    let all = squares(&|_| mean).max(f64::MIN_POSITIVE);
    Some(Lowest {
        u,
        sigma: variance.max(0.0).sqrt() / bend,
        goodness: 1.0 - squares(&|r| value(&c, r.u)) / all,
        scatter,
        value: least,
        bend,
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
            let peak = Peak::of(&points, 0.05).unwrap();
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
            let peak = Peak::of(&points, 0.05).unwrap();
            assert!((peak.z_um - top).abs() < 0.08, "{top}: {peak:?}");
        }
    }
}

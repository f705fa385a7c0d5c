//! Moves that come no nearer: how they scatter about the goal.

use crate::PoseError;
use crate::pose::wrapped;
use serde::{Deserialize, Serialize};

/// So many moves in a row tell.
const MOVES: usize = 6;
/// They come nearer where the later half is off by less than this share of the earlier one.
const NEARER: f64 = 0.6;
/// A mean that is off by more than so many of its standard deviations is no scatter, but a way.
const ONE_SIDED: f64 = 3.0;

/// What was seen after each move, the last ones.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Scatter(Vec<PoseError>);

/// How moves end.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Spread {
    /// The view's distance from the middle of all, root mean square, um.
    pub(crate) um: f64,
    /// Its angle, standard deviation, deg.
    pub(crate) deg: f64,
    /// How far that middle is from the goal, um and deg.
    pub(crate) middle: [f64; 2],
}

impl Spread {
    /// Whether the middle of all is the goal, to within a tolerance and what is not known of it. An angle that stays, as nothing `turns`, is none of it.
    pub(crate) fn is_about_the_goal(&self, tolerance: [f64; 2], turns: bool) -> bool {
        let unsure = ONE_SIDED / (MOVES as f64).sqrt();
        self.middle[0] <= tolerance[0] + unsure * self.um
            && (!turns || self.middle[1] <= tolerance[1] + unsure * self.deg)
    }
}

impl Scatter {
    /// Takes the first frame after a move.
    pub(crate) fn take(&mut self, now: PoseError) {
        if self.0.len() == MOVES {
            self.0.remove(0);
        }
        self.0.push(now);
    }

    /// Counts anew.
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }

    /// How the last moves ended, where there were enough and they came no nearer; what is within a tolerance, um and deg, need not.
    pub(crate) fn stays(&self, tolerance: [f64; 2]) -> Option<Spread> {
        if self.0.len() < MOVES {
            return None;
        }
        let (early, late) = self.0.split_at(MOVES / 2);
        let off = |all: &[PoseError]| {
            [
                rms(all.iter().map(|m| m.distance_um())),
                rms(all.iter().map(|m| m.angle_deg())),
            ]
        };
        let (early, late) = (off(early), off(late));
        if (0..2).any(|k| early[k] > tolerance[k] && late[k] < NEARER * early[k]) {
            return None;
        }
        let mean = PoseError::mean(self.0.iter().copied());
        let [x, y] = mean.t_um();
        let turned_deg = |m: &PoseError| wrapped(m.theta_rad - mean.theta_rad).to_degrees();
        let off = |m: &PoseError| {
            let [a, b] = m.t_um();
            f64::hypot(a - x, b - y)
        };
        let freedom = (MOVES as f64 / (MOVES - 1) as f64).sqrt();
        Some(Spread {
            um: freedom * rms(self.0.iter().map(off)),
            deg: freedom * rms(self.0.iter().map(turned_deg)),
            middle: [f64::hypot(x, y), mean.angle_deg().abs()],
        })
    }
}

fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    (values.map(|v| v * v).sum::<f64>() / count).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(moves: &[[f64; 3]]) -> Option<Spread> {
        let mut scatter = Scatter::default();
        for [x_um, y_um, deg] in moves {
            scatter.take(PoseError {
                t_m: [x_um * 1e-6, y_um * 1e-6],
                theta_rad: deg.to_radians(),
            });
        }
        scatter.stays([0.4, 0.01])
    }

    #[test]
    fn what_comes_nearer_is_no_scatter_and_what_stays_has_its_spread() {
        let nearer: Vec<_> = (0..6).map(|k| [100.0 * 0.8f64.powi(k), 0.0, 0.0]).collect();
        assert_eq!(after(&nearer), None);
        // Six places about a middle, the angle to and fro.
        let about = |middle: f64| -> Vec<[f64; 3]> {
            let at = |k: u32| {
                let (sin, cos) = (f64::from(k) * std::f64::consts::FRAC_PI_3).sin_cos();
                [middle + 2.0 * cos, 2.0 * sin, 0.001 * cos]
            };
            (0..6).map(at).collect()
        };
        assert_eq!(after(&about(0.0)[..5]), None, "too few");
        let spread = after(&about(0.0)).unwrap();
        assert!((spread.um - 2.0 * 1.2f64.sqrt()).abs() < 1e-6, "{spread:?}");
        assert!(spread.middle[0] < 1e-9 && spread.is_about_the_goal([0.4, 0.01], true));
        let beside = after(&about(10.0)).unwrap();
        assert!((beside.middle[0] - 10.0).abs() < 1e-6, "{beside:?}");
        assert!(!beside.is_about_the_goal([0.4, 0.01], true));
    }

    /// On a stage that does not turn, however the slide lies.
    #[test]
    fn an_angle_that_stays_is_no_way_and_at_half_a_turn_it_scatters_no_more_than_elsewhere() {
        for turned in [0.5, -20.0, 180.0] {
            let at = |k: u32| {
                let (sin, cos) = (f64::from(k) * std::f64::consts::FRAC_PI_3).sin_cos();
                let deg: f64 = turned + 0.001 * cos;
                [
                    2.0 * cos,
                    2.0 * sin,
                    if deg > 180.0 { deg - 360.0 } else { deg },
                ]
            };
            let all: Vec<_> = (0..6).map(at).collect();
            let spread = after(&all).unwrap();
            assert!(spread.deg < 0.001, "{turned}: {spread:?}");
            assert!(
                (spread.middle[1] - turned.abs()).abs() < 0.001,
                "{spread:?}"
            );
            assert!(spread.is_about_the_goal([0.4, 0.01], false), "{turned}");
            assert!(!spread.is_about_the_goal([0.4, 0.01], true), "{turned}");
        }
    }
}

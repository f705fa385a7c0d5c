//! The sum of squares that a calibration minimises, and its normal equations.

use super::model::{OPTICS, Order, Pair, Priors, Unknowns, View, axes};
use super::sight::{Derivative, Shown, Sight, shown, shown_by, sight};
use super::three::{dot, times};
use crate::pose::wrapped;
use scopeservo_geometry::cholesky_inverse;

/// The measurements, each pair with its weight.
#[derive(Clone, Copy)]
pub(super) struct Problem<'a> {
    pub(super) priors: &'a Priors,
    pub(super) views: &'a [View],
    pub(super) pairs: &'a [Pair],
    /// One for each pair: 1, or less for what others contradict.
    pub(super) weights: &'a [f64],
    /// What the stated covariances of all pairs are multiplied by.
    pub(super) pair_variance: f64,
}

/// What an axis that is not asked to move moves, as a share of its scatter: nearly nothing.
const STANDS: f64 = 0.01;
/// And by so much between two views, as buildings tremble, m and rad.
const TREMBLES: [f64; 3] = [20e-9, 20e-9, 2e-7];

/// Something known beforehand: a residual with its derivative by a few unknowns, and its standard deviation.
pub(super) struct PriorRow {
    pub(super) by: Vec<(usize, f64)>,
    pub(super) off: f64,
    pub(super) sigma: f64,
    /// The axis, where it is about an arrival.
    pub(super) arrival: Option<usize>,
}

/// `step = -information^-1 gradient`, information row by row.
pub(super) struct Normal {
    pub(super) information: Vec<f64>,
    pub(super) gradient: Vec<f64>,
}

impl Normal {
    /// Adds `certainty (by . step + residual)^2 / 2` over a few unknowns.
    fn add_row(&mut self, by: &[(usize, f64)], residual: f64, certainty: f64) {
        let n = self.gradient.len();
        for &(i, a) in by {
            self.gradient[i] += certainty * a * residual;
            for &(j, b) in by {
                self.information[i * n + j] += certainty * a * b;
            }
        }
    }

    /// The same of a pair's three numbers.
    fn add(&mut self, by: &[(usize, Shown)], residual: &Shown, certainty: &[[f64; 3]; 3]) {
        let n = self.gradient.len();
        for &(i, a) in by {
            let a = times(certainty, &a);
            self.gradient[i] += dot(&a, residual);
            for (j, b) in by {
                self.information[i * n + j] += dot(&a, b);
            }
        }
    }

    /// Holds an unknown where it is: its equation is `step = 0`.
    fn hold(&mut self, k: usize) {
        let n = self.gradient.len();
        for j in 0..n {
            (self.information[k * n + j], self.information[j * n + k]) = (0.0, 0.0);
        }
        (self.information[k * n + k], self.gradient[k]) = (1.0, 0.0);
    }
}

impl Problem<'_> {
    /// The sights of a pair, with what it shows less what was measured.
    fn off(&self, at: &Unknowns, pair: &Pair) -> Option<([Sight; 2], Shown)> {
        let both = [pair.fixed, pair.found];
        let optics = both.map(|v| &at.instrument.optics[self.views[v].optics]);
        let sights = [0, 1].map(|n| {
            sight(
                self.priors.kinematics,
                &at.poses[both[n]],
                optics[n].centre_m,
            )
        });
        let [x, y, angle] = shown(&sights, &optics)?;
        let [x_px, y_px] = pair.centre_px;
        Some((
            sights,
            [x - x_px, y - y_px, wrapped(angle - pair.angle_rad)],
        ))
    }

    /// The covariance of a pair.
    pub(super) fn covariance(&self, pair: &Pair) -> [Shown; 3] {
        pair.covariance
            .map(|row| row.map(|c| c * self.pair_variance))
    }

    /// What a pair shows less what was measured.
    pub(super) fn residual(&self, at: &Unknowns, pair: &Pair) -> Option<Shown> {
        Some(self.off(at, pair)?.1)
    }

    /// The residual of a pair and its derivative, with the unknowns that each column belongs to.
    pub(super) fn linear(
        &self,
        at: &Unknowns,
        pair: &Pair,
    ) -> Option<(Shown, Vec<(usize, Shown)>)> {
        let order = at.order();
        let (sights, off) = self.off(at, pair)?;
        let both = [pair.fixed, pair.found];
        let optics = both.map(|v| self.views[v].optics);
        let Derivative { by_pose, by_optics } =
            shown_by(&sights, &optics.map(|o| &at.instrument.optics[o]))?;
        let mut by = Vec::with_capacity(2 * (3 + OPTICS));
        for n in 0..2 {
            by.extend((order.pose(both[n])..).zip(by_pose[n]));
        }
        let [mut first, second] = by_optics;
        if optics[0] == optics[1] {
            // Summed here, as what they leave of the centre is lost in the squares of either.
            for (sum, more) in first.iter_mut().zip(second) {
                *sum = std::array::from_fn(|r| sum[r] + more[r]);
            }
        } else {
            by.extend((order.optics(optics[1])..).zip(second));
        }
        by.extend((order.optics(optics[0])..).zip(first));
        Some((off, by))
    }

    pub(super) fn prior_rows(&self, at: &Unknowns) -> Vec<PriorRow> {
        let (order, priors) = (at.order(), self.priors);
        let mut rows = Vec::new();
        let mut add = |by: &[(usize, f64)], off, sigma, arrival| {
            let by = by.to_vec();
            rows.push(PriorRow {
                by,
                off,
                sigma,
                arrival,
            });
        };
        for (k, trembles) in TREMBLES.into_iter().enumerate() {
            let Some(sigma) = priors.arrival[k] else {
                continue;
            };
            let backlash = at.instrument.backlash[k];
            let play = order.backlash() + k;
            add(&[(play, 1.0)], backlash, priors.backlash[k], None);
            // The view at which the axis arrived last.
            let mut stands = 0;
            for (v, (view, pose)) in self.views.iter().zip(&at.poses).enumerate() {
                let half = f64::from(view.approach[k]) / 2.0;
                let since_s = view.time_s - self.views[0].time_s;
                let drifted = at.drift.get(k).map_or(0.0, |drift| drift * since_s);
                let off = axes(pose)[k] - axes(&view.reported)[k] + half * backlash - drifted;
                let here = order.pose(v) + k;
                if view.arrived[k] || v == 0 || priors.coupled.unwrap_or(true) {
                    stands = v;
                    let mut by = vec![(here, 1.0), (play, half)];
                    if k < 2 {
                        by.push((order.drift() + k, -since_s));
                    }
                    add(&by, off, sigma, Some(k));
                } else {
                    let before = axes(&at.poses[stands])[k] - axes(&self.views[stands].reported)[k];
                    let gap_s = view.time_s - self.views[stands].time_s;
                    let drifted = at.drift.get(k).map_or(0.0, |drift| drift * gap_s);
                    let stood = axes(pose)[k] - axes(&view.reported)[k] - before - drifted;
                    let mut by = vec![(here, 1.0), (order.pose(stands) + k, -1.0)];
                    if k < 2 {
                        by.push((order.drift() + k, -gap_s));
                    }
                    add(&by, stood, f64::hypot(STANDS * sigma, trembles), None);
                }
            }
        }
        if priors.drift_m_per_s > 0.0 {
            for (k, drift) in at.drift.into_iter().enumerate() {
                add(
                    &[(order.drift() + k, 1.0)],
                    drift,
                    priors.drift_m_per_s,
                    None,
                );
            }
        }
        let centre =
            |o: usize, k: usize| (order.optics(o) + 4 + k, at.instrument.optics[o].centre_m[k]);
        for k in 0..2 {
            let (first, value) = centre(0, k);
            add(&[(first, 1.0)], value, priors.lever_m, None);
            for o in 1..order.optics {
                let (other, other_value) = centre(o, k);
                let by = [(other, 1.0), (first, -1.0)];
                add(&by, other_value - value, priors.parcentric_m, None);
            }
        }
        rows
    }

    /// Unknowns that have no meaning without an axis.
    pub(super) fn held(&self, order: Order) -> Vec<usize> {
        let mut held = Vec::new();
        for k in (0..3).filter(|k| self.priors.arrival[*k].is_none()) {
            held.extend((0..order.views).map(|v| order.pose(v) + k));
            held.push(order.backlash() + k);
        }
        if self.priors.drift_m_per_s <= 0.0 {
            held.extend([0, 1].map(|k| order.drift() + k));
        }
        if self.priors.arrival[2].is_none() {
            held.extend([4, 5].map(|k| order.optics(0) + k));
        }
        held
    }

    /// Twice the negative logarithm of the likelihood: chi-square where all weights are 1. `None` where a map is singular.
    pub(super) fn cost(&self, at: &Unknowns) -> Option<f64> {
        let rows = self.prior_rows(at);
        let mut cost: f64 = rows.iter().map(|row| (row.off / row.sigma).powi(2)).sum();
        for (pair, weight) in self.pairs.iter().zip(self.weights) {
            let off = self.residual(at, pair)?;
            cost += weight
                * dot(
                    &off,
                    &times(&cholesky_inverse(&self.covariance(pair))?, &off),
                );
        }
        cost.is_finite().then_some(cost)
    }

    /// The normal equations of a Gauss-Newton step.
    pub(super) fn normal(&self, at: &Unknowns) -> Option<Normal> {
        let order = at.order();
        let n = order.count();
        let mut normal = Normal {
            information: vec![0.0; n * n],
            gradient: vec![0.0; n],
        };
        for PriorRow { by, off, sigma, .. } in self.prior_rows(at) {
            normal.add_row(&by, off, 1.0 / (sigma * sigma));
        }
        for (pair, weight) in self.pairs.iter().zip(self.weights) {
            let (off, by) = self.linear(at, pair)?;
            let certainty = cholesky_inverse(&self.covariance(pair))?;
            normal.add(&by, &off, &certainty.map(|row| row.map(|c| c * weight)));
        }
        for k in self.held(order) {
            normal.hold(k);
        }
        Some(normal)
    }
}

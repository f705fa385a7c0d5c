//! The fit: all views and pairs at once, without the pairs that the others contradict.

use super::equations::Problem;
use super::minimise::minimise;
use super::model::{Instrument, OPTICS, Order, Pair, Priors, Unknowns, View};
use super::start::start;
use super::three::{Three, dot, entries, inverse, product, times};
use crate::kinematics::PlanarPose;
use scopeservo_geometry::{Cholesky, cholesky_inverse};

/// What the measurements say of the instrument, with its covariance.
#[derive(Debug, Clone, PartialEq)]
pub struct JointFit {
    /// The optics and the backlash.
    pub instrument: Instrument,
    /// Where each view truly was.
    pub poses: Vec<PlanarPose>,
    /// Covariance of the instrument with the poses marginalised: backlash x, y, rotation; then of each optics the map row by row and the
    /// centre. n x n, row by row, in SI units; zero where there is no such axis.
    pub covariance: Vec<f64>,
    /// Weighted sum of squares; chi-square with `freedom` degrees of freedom where all stated deviations are true.
    pub chi_sq: f64,
    /// Three for each pair that counts, less what the measurements determine of the instrument.
    pub freedom: f64,
    /// Pairs that the others contradict, which count for nothing.
    pub left_out: Vec<usize>,
}

impl JointFit {
    /// Covariance of an optics' map (row by row, m/px) and centre (m), as a `Calibration` holds it.
    pub fn optics_covariance(&self, optics: usize) -> [[f64; OPTICS]; OPTICS] {
        let n = 3 + OPTICS * self.instrument.optics.len();
        let first = 3 + OPTICS * optics;
        std::array::from_fn(|i| {
            std::array::from_fn(|j| self.covariance[(first + i) * n + first + j])
        })
    }

    /// Standard deviations of the backlash, x, y (m) and rotation (rad).
    pub fn backlash_sigma(&self) -> [f64; 3] {
        let n = 3 + OPTICS * self.instrument.optics.len();
        [0, 1, 2].map(|k| self.covariance[k * n + k].sqrt())
    }
}

/// A pair this far from what all others expect, squared and in standard deviations of three numbers, is wrong: one right pair in 65 000
/// is.
const CONTRADICTED_SQ: f64 = 25.0;
/// Where the weight of Cauchy is one half, the same way.
const HALF_WEIGHT_SQ: f64 = 9.0;
/// Rounds of reweighting, and of leaving out, at most.
const ROUNDS: usize = 4;

/// Fits everything jointly. `None` where the measurements do not determine the maps: moves without rotation in two directions at least.
///
/// # Panics
/// Where a pair names a view that is not there.
pub fn fit(priors: &Priors, views: &[View], pairs: &[Pair]) -> Option<JointFit> {
    let ones = vec![1.0; pairs.len()];
    let plain = Problem {
        priors,
        views,
        pairs,
        weights: &ones,
    };
    let mut solved = Solved::of(&plain, start(&plain)?)?;
    let mut off_sq = solved.contradictions(&plain)?;
    if off_sq.iter().all(|t| *t <= CONTRADICTED_SQ) {
        return Some(solved.told(&plain));
    }
    let mut weights = ones.clone();
    for round in 0..2 * ROUNDS {
        let weight = |t: &f64| match round < ROUNDS {
            true => 1.0 / (1.0 + t / HALF_WEIGHT_SQ),
            false => f64::from(u8::from(*t <= CONTRADICTED_SQ)),
        };
        let next: Vec<f64> = off_sq.iter().map(weight).collect();
        if next == weights {
            break;
        }
        weights = next;
        let weighted = Problem {
            weights: &weights,
            ..plain
        };
        solved = Solved::of(&weighted, solved.at)?;
        off_sq = solved.contradictions(&weighted)?;
    }
    Some(solved.told(&Problem {
        weights: &weights,
        ..plain
    }))
}

/// A minimum with the covariance of all unknowns, n x n.
struct Solved {
    at: Unknowns,
    cost: f64,
    covariance: Vec<f64>,
}

impl Solved {
    fn of(problem: &Problem, from: Unknowns) -> Option<Self> {
        let (at, cost) = minimise(problem, from)?;
        let n = at.order().count();
        let mut covariance = Cholesky::of(&problem.normal(&at)?.information, n)?.inverse();
        for k in problem.held(at.order()) {
            covariance[k * n + k] = 0.0;
        }
        Some(Self {
            at,
            cost,
            covariance,
        })
    }

    /// For each pair how far it is from what all others expect of it, squared, in standard deviations of both: Baarda's test. None where
    /// nothing else says anything of it.
    fn contradictions(&self, problem: &Problem) -> Option<Vec<f64>> {
        let pairs = problem.pairs.iter().zip(problem.weights);
        pairs
            .map(|(pair, weight)| {
                let (off, by) = problem.linear(&self.at, pair)?;
                let expected = self.expected(&by);
                Some(contradiction_sq(&off, &pair.covariance, &expected, *weight).unwrap_or(0.0))
            })
            .collect()
    }

    /// The covariance of what the fit expects of a pair, by its derivative.
    fn expected(&self, by: &[(usize, Three)]) -> [Three; 3] {
        let n = self.at.order().count();
        let mut expected = [[0.0; 3]; 3];
        for (i, a) in by {
            for (j, b) in by {
                let c = self.covariance[i * n + j];
                for (row, a) in expected.iter_mut().zip(a) {
                    for (cell, b) in row.iter_mut().zip(b) {
                        *cell += a * c * b;
                    }
                }
            }
        }
        expected
    }

    fn told(self, problem: &Problem) -> JointFit {
        let order = self.at.order();
        let (n, first) = (order.count(), order.backlash());
        let covariance: Vec<f64> = (first..n)
            .flat_map(|i| self.covariance[i * n + first..(i + 1) * n].to_vec())
            .collect();
        let left_out: Vec<usize> = (0..problem.pairs.len())
            .filter(|k| problem.weights[*k] == 0.0)
            .collect();
        let counted = problem.pairs.len() - left_out.len();
        let freedom = 3.0 * counted as f64 - determined(problem, order, &self.covariance);
        JointFit {
            instrument: self.at.instrument,
            poses: self.at.poses,
            covariance,
            chi_sq: self.cost,
            freedom,
            left_out,
        }
    }
}

/// The square of a residual that a pair would have in a fit without it, in standard deviations.
///
/// With residual r, its covariance R, weight w, and Q the covariance of what the fit expects, this pair included: without it the residual is
/// `e = (1 - w Q R^-1)^-1 r`, with covariance `R + (1 - w Q R^-1)^-1 Q`. `None` where the fit follows this pair alone.
fn contradiction_sq(
    r: &Three,
    own: &[Three; 3],
    expected: &[Three; 3],
    weight: f64,
) -> Option<f64> {
    let share = product(expected, &cholesky_inverse(own)?);
    let left = entries(|i, j| f64::from(u8::from(i == j)) - weight * share[i][j]);
    let without = inverse(&left)?;
    let e = times(&without, r);
    let scatter = product(&without, expected);
    let certainty = cholesky_inverse(&entries(|i, j| own[i][j] + scatter[i][j]))?;
    Some(dot(&e, &times(&certainty, &e)))
}

/// How many numbers of the instrument the measurements determine, where the prior alone would not: one less what is left of its variance.
fn determined(problem: &Problem, order: Order, covariance: &[f64]) -> f64 {
    let n = order.count();
    let priors = problem.priors;
    let learnt = |k: usize, sigma: f64| 1.0 - covariance[k * n + k] / (sigma * sigma);
    let held = problem.held(order);
    let backlash = (0..3).map(|k| (order.backlash() + k, priors.backlash[k]));
    let centres = (0..order.optics).flat_map(|o| {
        let sigma = if o == 0 {
            priors.lever_m
        } else {
            priors.parcentric_m
        };
        [4, 5].map(|k| (order.optics(o) + k, sigma))
    });
    let others = backlash
        .chain(centres)
        .filter(|(k, _)| !held.contains(k))
        .map(|(k, sigma)| learnt(k, sigma).max(0.0));
    4.0 * order.optics as f64 + others.sum::<f64>()
}

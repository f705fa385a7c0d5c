//! The fit: all views and pairs at once, without the pairs that the others contradict.

use super::equations::Problem;
use super::minimise::minimise;
use super::model::{Instrument, OPTICS, Order, Pair, Priors, Unknowns, View, axes};
use super::start::start;
use super::three::{Three, dot, entries, inverse, product, times};
use crate::kinematics::PlanarPose;
use scopeservo_geometry::{Cholesky, Vec2, cholesky_inverse};
use serde::{Deserialize, Serialize};

/// What the measurements say of the instrument, with its covariance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointFit {
    /// The optics and the backlash.
    pub instrument: Instrument,
    /// Where each view truly was.
    pub poses: Vec<PlanarPose>,
    /// Covariance of the instrument with the poses marginalised: backlash x, y, rotation; then of each optics the map row by row and the
    /// centre. n x n, row by row, in SI units; zero where there is no such axis.
    pub covariance: Vec<f64>,
    /// How fast the stage drifts, x and y, m/s.
    #[serde(default)]
    pub drift: Vec2,
    /// Covariance of the pose of the first view and of the drift with the n numbers of the instrument, then with each other: 5 x (n + 5).
    #[serde(default)]
    pub besides: Vec<f64>,
    /// Weighted sum of squares; chi-square with `freedom` degrees of freedom.
    pub chi_sq: f64,
    /// Three for each pair that counts, less what the measurements determine of the instrument.
    pub freedom: f64,
    /// Pairs that the others contradict, which count for nothing.
    pub left_out: Vec<usize>,
    /// Standard deviation of where an arrival ends, as seen: x, y (m), rotation (rad).
    pub scatter: [Option<f64>; 3],
    /// What the pairs scatter, in their stated standard deviations; 1 at least.
    pub pair_sigma: f64,
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
const ROUNDS: usize = 6;
/// A standard deviation that changes by a smaller share has settled.
const SETTLED: f64 = 0.02;
/// What scatters is estimated by so much redundancy, at least: else the greater of what is stated and what is seen counts.
const REDUNDANCY: f64 = 5.0;
/// So many of all pairs are wrong, at most.
const FEW_WRONG: f64 = 0.1;
/// Residuals with less redundancy, for each of their numbers, say nothing of what scatters.
const LEAST_REDUNDANCY: f64 = 0.1;
/// Axes that are not asked to move stand when they scatter by less than this share of what arrivals do, in variance; of so many, at least.
const STANDING: f64 = 0.25;
const FEW_STANDING: u32 = 6;
/// The images show an axis' scatter where they leave less than this share of its variance open.
const SEEN: f64 = 0.5;
/// No stage arrives better than this, m and rad.
const LEAST_SCATTER: f64 = 1e-9;

/// Fits everything jointly. `None` where the measurements do not determine the maps: moves without rotation in two directions at least.
///
/// How far arrivals scatter is stated by data sheets in many ways, with the play in it or without. So it is estimated, axis by axis, along
/// with the rest: variance components by Foerstner's iteration, each the sum of its squared residuals over its redundancy.
///
/// Whether an axis that is not asked to move stands, or arrives anew with all the others, no description of a stage says. It is seen, too.
///
/// A wrong pair looks like a stage that scatters, and a stage that scatters more than it says like wrong pairs. So first the stage is believed
/// until no pair contradicts another; where that leaves out many, the stage is what is wrong.
///
/// # Panics
/// Where a pair names a view that is not there.
pub fn fit(priors: &Priors, views: &[View], pairs: &[Pair]) -> Option<JointFit> {
    // A stage that claims to arrive to the last bit is believed so far.
    let priors = Priors {
        arrival: priors
            .arrival
            .map(|a| a.map(|sigma| sigma.max(LEAST_SCATTER))),
        ..*priors
    };
    let of = |coupled: bool| {
        let coupled = Some(coupled);
        fit_as(&Priors { coupled, ..priors }, views, pairs)
    };
    let (together, stands) = match priors.coupled {
        Some(coupled) => return Some(of(coupled)?.0),
        None => of(true)?,
    };
    match stands {
        true => Some(of(false)?.0),
        false => Some(together),
    }
}

/// The fit, and whether in it axes that are not asked to move are seen to stand.
fn fit_as(priors: &Priors, views: &[View], pairs: &[Pair]) -> Option<(JointFit, bool)> {
    let believed = fit_from(priors, views, pairs, true)?;
    match believed.0.left_out.len() as f64 <= FEW_WRONG * pairs.len() as f64 {
        true => Some(believed),
        false => fit_from(priors, views, pairs, false),
    }
}

/// What is believed from round to round: how far all scatters, and which pairs are right.
struct Belief {
    priors: Priors,
    pair_variance: f64,
    weights: Vec<f64>,
}

impl Belief {
    fn problem<'a>(&'a self, views: &'a [View], pairs: &'a [Pair]) -> Problem<'a> {
        Problem {
            priors: &self.priors,
            views,
            pairs,
            weights: &self.weights,
            pair_variance: self.pair_variance,
        }
    }
}

fn fit_from(
    priors: &Priors,
    views: &[View],
    pairs: &[Pair],
    believed: bool,
) -> Option<(JointFit, bool)> {
    let mut belief = Belief {
        priors: *priors,
        pair_variance: 1.0,
        weights: vec![1.0; pairs.len()],
    };
    let mut at = start(&belief.problem(views, pairs))?;
    // First with what a few wrong pairs hardly change; then without these.
    for (robust, rounds) in [(true, ROUNDS), (false, 2 * ROUNDS)] {
        for _ in 0..rounds {
            let problem = belief.problem(views, pairs);
            let solved = Solved::of(&problem, at)?;
            let off_sq = solved.contradictions(&problem)?;
            let clean = off_sq.iter().all(|t| *t <= CONTRADICTED_SQ);
            let weight = |t: &f64| match robust {
                true if clean => 1.0,
                true => 1.0 / (1.0 + t / HALF_WEIGHT_SQ),
                false => f64::from(u8::from(*t <= CONTRADICTED_SQ)),
            };
            let weights: Vec<f64> = off_sq.iter().map(weight).collect();
            let components = solved.components(&problem, priors, robust)?;
            let same = weights == belief.weights;
            let settled = same && components.settled(&belief.priors.arrival, belief.pair_variance);
            let update = match robust {
                true => clean || !believed,
                false => same,
            };
            if update {
                belief.priors.arrival = components.arrival;
                belief.pair_variance = components.pair_variance;
            }
            (belief.weights, at) = (weights, solved.at);
            if settled {
                break;
            }
        }
    }
    let problem = belief.problem(views, pairs);
    let solved = Solved::of(&problem, at)?;
    let stand = solved.stand(&problem);
    Some((solved.told(&problem), stand))
}

/// What scatters, as the residuals show it.
struct Components {
    arrival: [Option<f64>; 3],
    pair_variance: f64,
}

/// Residuals of one kind, squared, each of so many numbers.
struct Residuals {
    numbers: u8,
    sum_sq: f64,
    redundancy: f64,
    each: Vec<f64>,
}

impl Residuals {
    const fn new(numbers: u8) -> Self {
        Self {
            numbers,
            sum_sq: 0.0,
            redundancy: 0.0,
            each: Vec::new(),
        }
    }

    fn add(&mut self, off_sq: f64, redundancy: f64, weight: f64) {
        let redundancy = redundancy.max(0.0);
        self.sum_sq += weight * off_sq;
        self.redundancy += weight * redundancy;
        if redundancy > LEAST_REDUNDANCY * f64::from(self.numbers) {
            self.each.push(off_sq / redundancy);
        }
    }

    /// Their variance over what is expected: from all, or robustly from the middle one.
    fn variance(&mut self, robust: bool) -> f64 {
        if !robust || self.each.is_empty() {
            // The mean of what the variance may be: two more than the number that is likeliest, as a few residuals leave it open.
            return self.sum_sq / (self.redundancy - 2.0).max(1.0);
        }
        let middle = self.each.len() / 2;
        let (_, median, _) = self.each.select_nth_unstable_by(middle, f64::total_cmp);
        // The median of chi-square with one and three degrees of freedom.
        let expected = if self.numbers == 1 {
            0.455
        } else {
            2.366 / 3.0
        };
        *median / expected
    }
}

impl Components {
    fn settled(&self, arrival: &[Option<f64>; 3], pair_variance: f64) -> bool {
        let near = |a: f64, b: f64| (a / b - 1.0).abs() < SETTLED;
        let both = self.arrival.iter().zip(arrival);
        near(self.pair_variance, pair_variance)
            && both.into_iter().all(|(a, b)| match (a, b) {
                (Some(a), Some(b)) => near(*a, *b),
                _ => true,
            })
    }
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
                let own = problem.covariance(pair);
                Some(contradiction_sq(&off, &own, &expected, *weight).unwrap_or(0.0))
            })
            .collect()
    }

    /// The variance components: of each axis' arrivals, and of the pairs, which are never better than stated.
    fn components(&self, problem: &Problem, stated: &Priors, robust: bool) -> Option<Components> {
        if stated.sure {
            return Some(Components {
                arrival: stated.arrival,
                pair_variance: 1.0,
            });
        }
        let n = self.at.order().count();
        let variance = |by: &[(usize, f64)]| -> f64 {
            let all = by.iter().flat_map(|a| by.iter().map(move |b| (a, b)));
            all.map(|((i, a), (j, b))| a * b * self.covariance[i * n + j])
                .sum()
        };
        // In stated variances: of x and y together, whose scatter the rotation's hides in part; of the rotation.
        let mut arrivals = [const { Residuals::new(1) }; 2];
        for row in problem.prior_rows(&self.at) {
            let Some((k, stated)) = row.arrival.and_then(|k| Some((k, stated.arrival[k]?))) else {
                continue;
            };
            let redundancy = 1.0 - variance(&row.by) / (row.sigma * row.sigma);
            arrivals[k / 2].add((row.off / stated).powi(2), redundancy, 1.0);
        }
        let factor = arrivals.map(|mut of| match of.redundancy >= REDUNDANCY {
            true => of.variance(robust).sqrt(),
            false => of.variance(robust).sqrt().max(1.0),
        });
        let arrival =
            [0, 1, 2].map(|k| Some((factor[k / 2] * stated.arrival[k]?).max(LEAST_SCATTER)));
        let mut shown = Residuals::new(3);
        for (pair, weight) in problem.pairs.iter().zip(problem.weights) {
            let (off, by) = problem.linear(&self.at, pair)?;
            let certainty = cholesky_inverse(&problem.covariance(pair))?;
            let share = product(&self.expected(&by), &certainty);
            let redundancy = 3.0 - weight * (0..3).map(|k| share[k][k]).sum::<f64>();
            shown.add(dot(&off, &times(&certainty, &off)), redundancy, *weight);
        }
        let factor = match shown.redundancy >= REDUNDANCY {
            true => shown.variance(robust),
            false => 1.0,
        };
        Some(Components {
            arrival,
            pair_variance: (factor * problem.pair_variance).max(1.0),
        })
    }

    /// Whether axes that are not asked to move do not. Were they to arrive anew, they would scatter from view to view by twice the variance of
    /// an arrival, less what is left of that when the images are known; where much is left these say nothing.
    fn stand(&self, problem: &Problem) -> bool {
        let (order, n) = (self.at.order(), self.at.order().count());
        let off =
            |v: usize, k: usize| axes(&self.at.poses[v])[k] - axes(&problem.views[v].reported)[k];
        let (mut count, mut share) = (0, 0.0);
        for (v, view) in problem.views.iter().enumerate().skip(1) {
            for (k, arrival) in problem.priors.arrival.iter().enumerate() {
                let (Some(sigma), false) = (arrival, view.arrived[k]) else {
                    continue;
                };
                let (here, before) = (order.pose(v) + k, order.pose(v - 1) + k);
                let cell = |i: usize, j: usize| self.covariance[i * n + j];
                let left = cell(here, here) + cell(before, before) - 2.0 * cell(here, before);
                let scatter = 2.0 * sigma * sigma;
                if left < SEEN * scatter {
                    count += 1;
                    share += (off(v, k) - off(v - 1, k)).powi(2) / (scatter - left);
                }
            }
        }
        count >= FEW_STANDING && share < STANDING * f64::from(count)
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
        let besides = || (0..3).chain(order.drift()..first);
        let besides = besides()
            .flat_map(|i| (first..n).chain(besides()).map(move |j| i * n + j))
            .map(|cell| self.covariance[cell])
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
            drift: self.at.drift,
            besides,
            chi_sq: self.cost,
            freedom,
            left_out,
            scatter: problem.priors.arrival,
            pair_sigma: problem.pair_variance.sqrt(),
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

//! Locally optimised RANSAC (Chum, Matas, Kittler 2003) with the MSAC cost (Torr, Zisserman 2000). The loop knows no
//! geometry: a [`Problem`] makes models from samples and measures residuals.

use crate::fit::{solve, solve_similarity};
use crate::{Affine2, Correspondence, SplitMix64, affine_from_3, similarity_from_oriented};

/// What the loop needs to know of a problem.
pub trait Problem {
    /// What is estimated.
    type Model: Clone;
    /// Number of data.
    fn len(&self) -> usize;
    /// Whether there are no data.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Data that a minimal sample needs.
    fn sample_size(&self) -> usize;
    /// How much wider than the final threshold a minimal model's inliers may lie: large where the minimal model is
    /// coarse.
    fn slack(&self) -> f64;
    /// The model through a minimal sample, if it is a possible one.
    fn minimal(&self, sample: &[usize]) -> Option<Self::Model>;
    /// The model that fits the given data best, if it is a possible one.
    fn refine(&self, inliers: &[usize]) -> Option<Self::Model>;
    /// Squared residuals of the data from `first` on, in units of the threshold's square: as many as `out` holds.
    fn residuals_sq(&self, model: &Self::Model, first: usize, out: &mut [f64]);
}

/// How long and how strictly to search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RansacOptions {
    /// A datum is an inlier when its residual is at most this.
    pub threshold: f64,
    /// The search ends when a better model than the best so far was missed with less than this probability.
    pub miss_probability: f64,
    /// The search ends after this many samples in any case.
    pub max_samples: usize,
    /// Equal seeds give equal results.
    pub seed: u64,
}

impl Default for RansacOptions {
    fn default() -> Self {
        Self {
            threshold: 3.0,
            miss_probability: 1e-6,
            max_samples: 5000,
            seed: 0,
        }
    }
}

/// The best model found.
#[derive(Debug, Clone, PartialEq)]
pub struct RobustFit<M> {
    /// The model.
    pub model: M,
    /// The data within the threshold, ascending.
    pub inliers: Vec<usize>,
    /// MSAC cost: each datum adds its squared residual over the threshold's, at most 1.
    pub cost: f64,
    /// Samples drawn.
    pub samples: usize,
}

/// Searches for the model with the least MSAC cost. `None` when no sample gives a model that two data more than a
/// sample agree with.
pub fn lo_ransac<P: Problem>(problem: &P, options: &RansacOptions) -> Option<RobustFit<P::Model>> {
    let (n, size) = (problem.len(), problem.sample_size());
    if n < size {
        return None;
    }
    let slack_sq = (options.threshold * problem.slack()).powi(2);
    let mut rng = SplitMix64::new(options.seed);
    let mut best: Option<RobustFit<P::Model>> = None;
    let mut best_minimal = f64::INFINITY;
    let mut needed = options.max_samples;
    let mut order = Permutation::new(n);
    let mut samples = 0;
    while samples < needed.min(options.max_samples) {
        let Some(sample) = order.sample(size, &mut rng) else {
            break;
        };
        samples += 1;
        let Some(minimal) = problem.minimal(sample) else {
            continue;
        };
        let cost = cost(problem, &minimal, slack_sq, best_minimal);
        // Only a minimal model better than any before is worth the local optimisation.
        if cost >= best_minimal {
            continue;
        }
        best_minimal = cost;
        let Some(local) = optimise(problem, minimal, options.threshold) else {
            continue;
        };
        if best.as_ref().is_none_or(|b| local.cost < b.cost) {
            let share = local.inliers.len() as f64 / n as f64;
            needed = samples_needed(share, size, options.miss_probability);
            best = Some(local);
        }
    }
    best.filter(|b| b.inliers.len() >= size + 2)
        .map(|b| RobustFit { samples, ..b })
}

/// Refits while the threshold shrinks from the slack of a minimal model to its final value, then to a fixed point.
fn optimise<P: Problem>(
    problem: &P,
    minimal: P::Model,
    threshold: f64,
) -> Option<RobustFit<P::Model>> {
    let mut model = minimal;
    let mut found = inliers(problem, &model, (threshold * problem.slack()).powi(2));
    for factor in [problem.slack(), problem.slack().sqrt(), 1.0, 1.0, 1.0] {
        model = problem.refine(&found)?;
        let next = inliers(problem, &model, (threshold * factor).powi(2));
        if factor == 1.0 && next == found {
            break;
        }
        found = next;
    }
    Some(RobustFit {
        cost: cost(problem, &model, threshold * threshold, f64::INFINITY),
        model,
        inliers: found,
        samples: 0,
    })
}

/// Data looked at together: their residuals stay in the first cache.
const BLOCK: usize = 128;

/// Calls `see` with the first datum of each block and the block's squared residuals, until it says that it has seen enough.
fn each_block<P: Problem>(
    problem: &P,
    model: &P::Model,
    mut see: impl FnMut(usize, &[f64]) -> bool,
) {
    let mut residuals_sq = [0.0; BLOCK];
    for first in (0..problem.len()).step_by(BLOCK) {
        let block = &mut residuals_sq[..BLOCK.min(problem.len() - first)];
        problem.residuals_sq(model, first, block);
        if see(first, block) {
            break;
        }
    }
}

/// The MSAC cost, or something that is at least `enough` when the cost is.
fn cost<P: Problem>(problem: &P, model: &P::Model, threshold_sq: f64, enough: f64) -> f64 {
    let per_threshold_sq = 1.0 / threshold_sq;
    let share = |r_sq: f64| {
        let share = r_sq * per_threshold_sq;
        if share < 1.0 { share } else { 1.0 }
    };
    let mut cost = 0.0;
    each_block(problem, model, |_, block| {
        // Four sums side by side, which processors add at once.
        let (fours, rest) = block.as_chunks::<4>();
        let mut sums = [0.0; 4];
        for four in fours {
            for k in 0..4 {
                sums[k] += share(four[k]);
            }
        }
        cost += sums.iter().sum::<f64>() + rest.iter().map(|&r| share(r)).sum::<f64>();
        cost >= enough
    });
    cost
}

/// The data within the threshold, ascending.
fn inliers<P: Problem>(problem: &P, model: &P::Model, threshold_sq: f64) -> Vec<usize> {
    let mut found = Vec::new();
    each_block(problem, model, |first, block| {
        let within = block
            .iter()
            .enumerate()
            .filter(|(_, r)| **r <= threshold_sq);
        found.extend(within.map(|(k, _)| first + k));
        false
    });
    found
}

fn samples_needed(inlier_share: f64, size: usize, miss_probability: f64) -> usize {
    let good = inlier_share.powi(size as i32);
    if good >= 1.0 {
        return 1;
    }
    let needed = miss_probability.ln() / (1.0 - good).ln();
    if needed.is_finite() {
        needed.ceil() as usize
    } else {
        usize::MAX
    }
}

/// Samples without repetition inside a sample; samples of one visit every datum once before any twice.
struct Permutation {
    order: Vec<usize>,
    next: usize,
}

impl Permutation {
    fn new(n: usize) -> Self {
        Self {
            order: (0..n).collect(),
            next: 0,
        }
    }

    fn sample(&mut self, size: usize, rng: &mut SplitMix64) -> Option<&[usize]> {
        let n = self.order.len();
        if size == 1 {
            if self.next == n {
                return None;
            }
            let pick = self.next + rng.below(n - self.next);
            self.order.swap(self.next, pick);
            self.next += 1;
            return Some(&self.order[self.next - 1..self.next]);
        }
        for k in 0..size {
            let pick = k + rng.below(n - k);
            self.order.swap(k, pick);
        }
        Some(&self.order[..size])
    }
}

/// Points in columns, so that residuals are computed side by side. Every correspondence counts alike: sigmas would
/// favour large keypoints in the search.
struct Columns {
    a: [Vec<f64>; 2],
    b: [Vec<f64>; 2],
}

impl Columns {
    fn of(correspondences: &[Correspondence]) -> Self {
        let column = |of: fn(&Correspondence) -> f64| correspondences.iter().map(of).collect();
        Self {
            a: [column(|c| c.p_in_a[0]), column(|c| c.p_in_a[1])],
            b: [column(|c| c.p_in_b[0]), column(|c| c.p_in_b[1])],
        }
    }

    fn residuals_sq(&self, model: &Affine2, first: usize, out: &mut [f64]) {
        let here = first..first + out.len();
        let [ax, ay] = self.a.each_ref().map(|v| &v[here.clone()]);
        let [bx, by] = self.b.each_ref().map(|v| &v[here.clone()]);
        for (i, out) in out.iter_mut().enumerate() {
            let q = model.apply([ax[i], ay[i]]);
            let d = [q[0] - bx[i], q[1] - by[i]];
            *out = d[0] * d[0] + d[1] * d[1];
        }
    }

    fn refine(&self, inliers: &[usize], possible: &dyn Fn(&Affine2) -> bool) -> Option<Affine2> {
        if inliers.len() < 3 {
            return None;
        }
        let point = |i: usize| {
            (
                [self.a[0][i], self.a[1][i]],
                [self.b[0][i], self.b[1][i]],
                1.0,
            )
        };
        let fit = solve(inliers.iter().map(|&i| point(i)))?.b_from_a;
        possible(&fit).then_some(fit)
    }

    fn refine_similar(
        &self,
        inliers: &[usize],
        possible: &dyn Fn(&Affine2) -> bool,
    ) -> Option<Affine2> {
        let point = |&i: &usize| {
            let (a, b) = (&self.a, &self.b);
            ([a[0][i], a[1][i]], [b[0][i], b[1][i]], 1.0)
        };
        let fit = solve_similarity(inliers.iter().map(point))?.b_from_a;
        possible(&fit).then_some(fit)
    }
}

/// The paper's problem: an affine transform from three correspondences.
pub struct AffineProblem<'a> {
    correspondences: &'a [Correspondence],
    columns: Columns,
    possible: &'a dyn Fn(&Affine2) -> bool,
}

impl<'a> AffineProblem<'a> {
    /// Over `correspondences`, of which the sigmas play no part; `possible` says which transforms can be at all.
    pub fn new(
        correspondences: &'a [Correspondence],
        possible: &'a dyn Fn(&Affine2) -> bool,
    ) -> Self {
        Self {
            correspondences,
            columns: Columns::of(correspondences),
            possible,
        }
    }
}

impl Problem for AffineProblem<'_> {
    type Model = Affine2;
    fn len(&self) -> usize {
        self.correspondences.len()
    }
    fn sample_size(&self) -> usize {
        3
    }
    fn slack(&self) -> f64 {
        2.0
    }
    fn minimal(&self, sample: &[usize]) -> Option<Affine2> {
        let c = [0, 1, 2].map(|k| self.correspondences[sample[k]]);
        affine_from_3(&c).filter(|m| (self.possible)(m))
    }
    fn refine(&self, inliers: &[usize]) -> Option<Affine2> {
        self.columns.refine(inliers, self.possible)
    }
    fn residuals_sq(&self, model: &Affine2, first: usize, out: &mut [f64]) {
        self.columns.residuals_sq(model, first, out);
    }
}

/// The same transform from single oriented, scaled correspondences: every keypoint match is a hypothesis by itself.
pub struct OrientedProblem<'a> {
    correspondences: &'a [Correspondence],
    oriented: &'a [[f64; 4]],
    columns: Columns,
    possible: &'a dyn Fn(&Affine2) -> bool,
    similar: bool,
}

impl<'a> OrientedProblem<'a> {
    /// As [`AffineProblem::new`], with the scale in a, scale in b, angle in a (rad) and angle in b (rad) of each datum.
    pub fn new(
        correspondences: &'a [Correspondence],
        oriented: &'a [[f64; 4]],
        possible: &'a dyn Fn(&Affine2) -> bool,
    ) -> Self {
        Self {
            correspondences,
            oriented,
            columns: Columns::of(correspondences),
            possible,
            similar: false,
        }
    }

    /// The same for a similarity: data near a line leave an affine transform open, and a similarity not.
    #[must_use]
    pub fn similar(mut self) -> Self {
        self.similar = true;
        self
    }
}

impl Problem for OrientedProblem<'_> {
    type Model = Affine2;
    fn len(&self) -> usize {
        self.correspondences.len()
    }
    fn sample_size(&self) -> usize {
        1
    }
    fn slack(&self) -> f64 {
        6.0
    }
    fn minimal(&self, sample: &[usize]) -> Option<Affine2> {
        let i = sample[0];
        let [scale_a, scale_b, angle_a, angle_b] = self.oriented[i];
        similarity_from_oriented(&self.correspondences[i], scale_a, scale_b, angle_a, angle_b)
            .map(Affine2::from)
    }
    fn refine(&self, inliers: &[usize]) -> Option<Affine2> {
        match self.similar {
            true => self.columns.refine_similar(inliers, self.possible),
            false => self.columns.refine(inliers, self.possible),
        }
    }
    fn residuals_sq(&self, model: &Affine2, first: usize, out: &mut [f64]) {
        self.columns.residuals_sq(model, first, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Similarity;

    struct Scene {
        correspondences: Vec<Correspondence>,
        oriented: Vec<[f64; 4]>,
        truth: Affine2,
        good: usize,
    }

    /// `good` true matches with 0.3 px noise, then `bad` random ones.
    fn scene(good: usize, bad: usize, seed: u64) -> Scene {
        let mut rng = SplitMix64::new(seed);
        let truth = Affine2::from(Similarity {
            scale: 1.3,
            angle_rad: 0.4,
            offset: [20.0, -30.0],
        });
        let mut correspondences = Vec::new();
        let mut oriented = Vec::new();
        for i in 0..good + bad {
            let p_in_a = [rng.uniform() * 640.0, rng.uniform() * 480.0];
            let q = truth.apply(p_in_a);
            let angle = rng.uniform() * 6.0;
            if i < good {
                correspondences.push(Correspondence {
                    p_in_a,
                    p_in_b: [q[0] + 0.3 * rng.normal(), q[1] + 0.3 * rng.normal()],
                    sigma: 1.0,
                });
                let scale_b = 2.0 * 1.3 * (1.0 + 0.03 * rng.normal());
                oriented.push([2.0, scale_b, angle, angle + 0.4 + 0.03 * rng.normal()]);
            } else {
                correspondences.push(Correspondence {
                    p_in_a,
                    p_in_b: [rng.uniform() * 640.0, rng.uniform() * 480.0],
                    sigma: 1.0,
                });
                oriented.push([2.0, 1.0 + 4.0 * rng.uniform(), angle, 6.0 * rng.uniform()]);
            }
        }
        Scene {
            correspondences,
            oriented,
            truth,
            good,
        }
    }

    fn check(scene: &Scene, fit: &RobustFit<Affine2>) {
        let found = fit.inliers.iter().filter(|&&i| i < scene.good).count();
        assert!(found as f64 >= 0.97 * scene.good as f64, "{found}");
        for p in [[0.0, 0.0], [639.0, 479.0]] {
            let (a, b) = (fit.model.apply(p), scene.truth.apply(p));
            assert!(f64::hypot(a[0] - b[0], a[1] - b[1]) < 0.6);
        }
    }

    #[test]
    fn three_point_affine_survives_sixty_percent_outliers() {
        for seed in 0..10 {
            let scene = scene(80, 120, seed);
            let problem = AffineProblem::new(&scene.correspondences, &|_| true);
            check(
                &scene,
                &lo_ransac(
                    &problem,
                    &RansacOptions {
                        seed,
                        ..Default::default()
                    },
                )
                .unwrap(),
            );
        }
    }

    #[test]
    fn one_oriented_match_survives_ninety_five_percent_outliers() {
        for seed in 0..10 {
            let scene = scene(40, 760, seed);
            let problem = OrientedProblem::new(&scene.correspondences, &scene.oriented, &|_| true);
            check(
                &scene,
                &lo_ransac(
                    &problem,
                    &RansacOptions {
                        seed,
                        ..Default::default()
                    },
                )
                .unwrap(),
            );
        }
    }

    #[test]
    fn blocks_add_up_to_the_whole() {
        for count in [1, 3, 127, 128, 129, 400] {
            let scene = scene(count, 0, 3);
            let problem = AffineProblem::new(&scene.correspondences, &|_| true);
            let off_sq: Vec<f64> = scene
                .correspondences
                .iter()
                .map(|c| {
                    let q = scene.truth.apply(c.p_in_a);
                    (q[0] - c.p_in_b[0]).powi(2) + (q[1] - c.p_in_b[1]).powi(2)
                })
                .collect();
            let threshold_sq = 0.15;
            let whole: f64 = off_sq.iter().map(|r| (r / threshold_sq).min(1.0)).sum();
            let blocks = cost(&problem, &scene.truth, threshold_sq, f64::INFINITY);
            assert!((blocks - whole).abs() < 1e-9 * whole, "{count}");
            // Stopping early never makes a model look better than what it has to beat.
            let enough = whole / 2.0;
            assert!(cost(&problem, &scene.truth, threshold_sq, enough) >= enough);
            let within: Vec<usize> = (0..count).filter(|&i| off_sq[i] <= threshold_sq).collect();
            assert_eq!(inliers(&problem, &scene.truth, threshold_sq), within);
        }
    }

    #[test]
    fn equal_seeds_give_equal_results() {
        let scene = scene(60, 200, 5);
        let problem = AffineProblem::new(&scene.correspondences, &|_| true);
        let options = RansacOptions {
            seed: 11,
            ..Default::default()
        };
        assert_eq!(lo_ransac(&problem, &options), lo_ransac(&problem, &options));
    }

    #[test]
    fn too_few_data_or_nothing_possible_is_none() {
        let scene = scene(10, 0, 1);
        let problem = AffineProblem::new(&scene.correspondences[..2], &|_| true);
        assert!(lo_ransac(&problem, &RansacOptions::default()).is_none());
        let problem = AffineProblem::new(&scene.correspondences, &|_| false);
        assert!(lo_ransac(&problem, &RansacOptions::default()).is_none());
    }
}

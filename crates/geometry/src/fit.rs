//! Transforms from correspondences: minimal and least squares, with the covariance of the result.

use crate::jackknife::{Equation, blocks, changes, covariance};
use crate::{Affine2, Mat2, Similarity, Vec2, cholesky_inverse};
use serde::{Deserialize, Serialize};

/// One correspondence: `p_in_a` and `p_in_b` show the same thing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Correspondence {
    /// The point in frame a.
    pub p_in_a: Vec2,
    /// The point in frame b.
    pub p_in_b: Vec2,
    /// Standard deviation of one coordinate of the residual in b, in b's unit, up to a common factor.
    pub sigma: f64,
}

/// An affine fit with its covariance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AffineFit {
    /// The transform.
    pub b_from_a: Affine2,
    /// Covariance of (a11, a12, b1, a21, a22, b2), the rows of the 2x3 matrix one after the other.
    pub covariance: [[f64; 6]; 6],
}

/// What the residuals of single correspondences do not tell of their errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SharedErrors {
    /// Side, in a, of the squares within which correspondences may share their errors. Smaller where there would be few squares.
    pub block: f64,
    /// Standard deviation, in b, of what all of them may be off by. It also turns and stretches the transform as far, at their
    /// distance from the middle.
    pub systematic: f64,
}

impl AffineFit {
    /// 2x2 covariance, in b, of where the point `p_in_a` lands.
    pub fn covariance_at(&self, p_in_a: Vec2) -> Mat2 {
        let row = [p_in_a[0], p_in_a[1], 1.0];
        let mut out = [[0.0; 2]; 2];
        for (r, out_row) in out.iter_mut().enumerate() {
            for (c, cell) in out_row.iter_mut().enumerate() {
                for i in 0..3 {
                    for j in 0..3 {
                        *cell += row[i] * self.covariance[3 * r + i][3 * c + j] * row[j];
                    }
                }
            }
        }
        Mat2(out)
    }

    /// Standard deviation per coordinate, in b, of where `p_in_a` lands: root of half the covariance's trace.
    pub fn sigma_at(&self, p_in_a: Vec2) -> f64 {
        let m = self.covariance_at(p_in_a).0;
        ((m[0][0] + m[1][1]) / 2.0).max(0.0).sqrt()
    }
}

/// The affine transform through three correspondences; `None` when the points in a lie on a line.
pub fn affine_from_3(c: &[Correspondence; 3]) -> Option<Affine2> {
    let edge = |from: Vec2, to: Vec2| [to[0] - from[0], to[1] - from[1]];
    let (a1, a2) = (
        edge(c[0].p_in_a, c[1].p_in_a),
        edge(c[0].p_in_a, c[2].p_in_a),
    );
    let (b1, b2) = (
        edge(c[0].p_in_b, c[1].p_in_b),
        edge(c[0].p_in_b, c[2].p_in_b),
    );
    let edges_a = Mat2([[a1[0], a2[0]], [a1[1], a2[1]]]);
    let edges_b = Mat2([[b1[0], b2[0]], [b1[1], b2[1]]]);
    let longest_sq = (a1[0] * a1[0] + a1[1] * a1[1]).max(a2[0] * a2[0] + a2[1] * a2[1]);
    if edges_a.det().abs() <= 1e-9 * longest_sq {
        return None;
    }
    Some(through(
        edges_b * edges_a.inverse()?,
        c[0].p_in_a,
        c[0].p_in_b,
    ))
}

/// The similarity of one oriented, scaled correspondence: a keypoint at `p_in_a` with scale and angle seen at `p_in_b`
/// with another. `None` when a scale is not positive.
pub fn similarity_from_oriented(
    c: &Correspondence,
    scale_a: f64,
    scale_b: f64,
    angle_a_rad: f64,
    angle_b_rad: f64,
) -> Option<Similarity> {
    if !(scale_a > 0.0 && scale_b > 0.0) {
        return None;
    }
    let scale = scale_b / scale_a;
    let angle_rad = angle_b_rad - angle_a_rad;
    let offset = through(Mat2::rotation(angle_rad) * scale, c.p_in_a, c.p_in_b).offset;
    Some(Similarity {
        scale,
        angle_rad,
        offset,
    })
}

fn through(linear: Mat2, p_in_a: Vec2, p_in_b: Vec2) -> Affine2 {
    let moved = linear * p_in_a;
    Affine2 {
        linear,
        offset: [p_in_b[0] - moved[0], p_in_b[1] - moved[1]],
    }
}

/// Weighted means of both point sets, and the sum of weights.
fn centroids(points: impl Iterator<Item = (Vec2, Vec2, f64)>) -> (Vec2, Vec2, f64) {
    let (mut a, mut b, mut total) = ([0.0; 2], [0.0; 2], 0.0);
    for (p_in_a, p_in_b, w) in points {
        total += w;
        for k in 0..2 {
            a[k] += w * p_in_a[k];
            b[k] += w * p_in_b[k];
        }
    }
    (a.map(|v| v / total), b.map(|v| v / total), total)
}

/// What least squares gives before anyone asks for its covariance.
pub(crate) struct Solution {
    pub(crate) b_from_a: Affine2,
    mean_a: Vec2,
    /// Weighted mean of the squared distance from `mean_a`.
    spread: f64,
}

/// Least squares affine over `(p_in_a, p_in_b, weight)`. `None` when the points lie on a line.
///
/// Both coordinates share one normal matrix. About the centroid the offset separates from it, which leaves 2x2.
pub(crate) fn solve(points: impl Iterator<Item = (Vec2, Vec2, f64)> + Clone) -> Option<Solution> {
    let (mean_a, mean_b, total) = centroids(points.clone());
    if !(total.is_finite() && total > 0.0) {
        return None;
    }
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    let mut right = [[0.0; 2]; 2];
    for (p_in_a, p_in_b, w) in points {
        let (x, y) = (p_in_a[0] - mean_a[0], p_in_a[1] - mean_a[1]);
        let (wx, wy) = (w * x, w * y);
        xx += wx * x;
        xy += wx * y;
        yy += wy * y;
        for k in 0..2 {
            let b = p_in_b[k] - mean_b[k];
            right[k][0] += wx * b;
            right[k][1] += wy * b;
        }
    }
    let [[i00, i01], [i10, i11]] = cholesky_inverse(&[[xx, xy], [xy, yy]])?;
    let centred = Affine2 {
        linear: Mat2(right) * Mat2([[i00, i01], [i10, i11]]),
        offset: [0.0; 2],
    };
    Some(Solution {
        b_from_a: centred.recentred([-mean_a[0], -mean_a[1]], [-mean_b[0], -mean_b[1]]),
        mean_a,
        spread: (xx + yy) / total,
    })
}

/// Least squares affine over `c`, each equation weighted by `robust_weight / sigma^2`.
///
/// The robust weights are those of the Cauchy function, whose slope is their square, or 1. `None` when the correspondences, or those
/// that are left without one block, lie on a line.
pub fn fit_affine(
    c: &[Correspondence],
    robust_weights: &[f64],
    shared: &SharedErrors,
) -> Option<AffineFit> {
    assert_eq!(c.len(), robust_weights.len());
    let weights = combined(c, robust_weights);
    let Solution {
        b_from_a,
        mean_a,
        spread,
    } = solve(weighted(c, &weights))?;
    let (block_of, count) = blocks(c.iter().map(|c| c.p_in_a), shared.block);
    let equations = (0..c.len()).map(|i| {
        let p = c[i].p_in_a;
        Equation {
            block: block_of[i],
            row: [p[0] - mean_a[0], p[1] - mean_a[1], 1.0],
            slope: weights[i] * robust_weights[i],
            pull: residual(&b_from_a, &c[i]).map(|r| weights[i] * r),
        }
    });
    let changes = changes(equations, count)?;
    let deviations = jackknife(&changes, 1.0).chain(common(shared, spread));
    Some(AffineFit {
        b_from_a,
        covariance: covariance(deviations, mean_a),
    })
}

/// Deviations whose covariance is `more` times that of the changes.
fn jackknife(changes: &[[[f64; 3]; 2]], more: f64) -> impl Iterator<Item = [[f64; 3]; 2]> {
    let count = changes.len() as f64;
    let factor = ((count - 1.0) / count * more).sqrt();
    let scaled = move |c: &[[f64; 3]; 2]| c.map(|row| row.map(|v| factor * v));
    changes.iter().map(scaled)
}

/// Deviations that no residual shows, about the middle: a shift, a turn and a scale. `spread` is the mean squared distance from it.
fn common(shared: &SharedErrors, spread: f64) -> impl Iterator<Item = [[f64; 3]; 2]> + use<> {
    let shift = shared.systematic;
    let turn = shift / spread.sqrt();
    [
        [[0.0, 0.0, shift], [0.0; 3]],
        [[0.0; 3], [0.0, 0.0, shift]],
        [[turn, 0.0, 0.0], [0.0, turn, 0.0]],
        [[0.0, -turn, 0.0], [turn, 0.0, 0.0]],
    ]
    .into_iter()
}

/// Robust weights over the variances given.
fn combined(c: &[Correspondence], robust: &[f64]) -> Vec<f64> {
    let of = |(c, r): (&Correspondence, &f64)| r / (c.sigma * c.sigma);
    c.iter().zip(robust).map(of).collect()
}

fn weighted(
    c: &[Correspondence],
    weights: &[f64],
) -> impl Iterator<Item = (Vec2, Vec2, f64)> + Clone {
    c.iter().zip(weights).map(|(c, &w)| (c.p_in_a, c.p_in_b, w))
}

/// Rounds of reweighting: by then the fit moves less than it is known by far.
const ROUNDS: usize = 10;
/// The median of a Rayleigh distributed residual, in sigmas of one coordinate.
const RAYLEIGH_MEDIAN: f64 = 1.1774;
/// Where the Cauchy weight is one half, in the same sigmas.
const CAUCHY_WIDTH: f64 = 2.4;

/// Iteratively reweighted least squares with Cauchy weights; the scale is the median residual, taken anew each time.
pub fn fit_affine_robust(c: &[Correspondence], shared: &SharedErrors) -> Option<AffineFit> {
    let weights = robust_weights(c, 3, |weights| Some(solve(weighted(c, weights))?.b_from_a))?;
    fit_affine(c, &weights, shared)
}

/// The same for a similarity: for few correspondences, which an affine transform would follow into their errors.
///
/// The covariance is that of the affine transform which it stands for: the two parameters that a similarity lacks have a standard
/// deviation of `anisotropy`, relative to the scale. `None` with fewer than four correspondences, for which it has none.
pub fn fit_similarity_robust(
    c: &[Correspondence],
    anisotropy: f64,
    shared: &SharedErrors,
) -> Option<AffineFit> {
    let (robust, weights, solution) = solve_similarity_robust(c)?;
    let (b_from_a, mean_a) = (solution.b_from_a, solution.mean_a);
    let (block_of, count) = blocks(c.iter().map(|c| c.p_in_a), shared.block);
    // The unknowns are (a11, a21, b1, b2).
    let equations = (0..c.len()).flat_map(|i| {
        let [x, y] = [0, 1].map(|k| c[i].p_in_a[k] - mean_a[k]);
        let off = residual(&b_from_a, &c[i]);
        [([x, -y, 1.0, 0.0], off[0]), ([y, x, 0.0, 1.0], off[1])].map(|(row, off)| Equation {
            block: block_of[i],
            row,
            slope: weights[i] * robust[i],
            pull: [weights[i] * off],
        })
    });
    let changes: Vec<_> = changes(equations, count)?
        .into_iter()
        .map(|[[a11, a21, b1, b2]]| [[a11, -a21, b1], [a21, a11, b2]])
        .collect();
    let shape = anisotropy * b_from_a.linear.det().abs().sqrt();
    let lacking = [
        [[shape, 0.0, 0.0], [0.0, -shape, 0.0]],
        [[0.0, shape, 0.0], [shape, 0.0, 0.0]],
    ];
    // Few blocks tell a variance badly: it is that of Student's distribution. An affine transform follows few places so far that
    // leaving one out changes it by more than its error, which makes up for that.
    let freedom = 2.0 * changes.len() as f64 - 4.0;
    let student = freedom / (freedom - 2.0).max(1.0);
    let deviations = jackknife(&changes, student)
        .chain(lacking)
        .chain(common(shared, solution.spread));
    Some(AffineFit {
        b_from_a,
        covariance: covariance(deviations, mean_a),
    })
}

/// The transform of [`fit_affine_robust`] without regard to which errors are shared, for those who ask for no covariance.
pub fn affine_robust(c: &[Correspondence]) -> Option<Affine2> {
    let affine = |weights: &[f64]| Some(solve(weighted(c, weights))?.b_from_a);
    let robust = robust_weights(c, 3, affine)?;
    affine(&combined(c, &robust))
}

/// The transform of [`fit_similarity_robust`], for those who ask for no covariance.
pub fn similarity_robust(c: &[Correspondence]) -> Option<Affine2> {
    Some(solve_similarity_robust(c)?.2.b_from_a)
}

/// Robust weights, the same over the variances given, and the similarity that they make.
fn solve_similarity_robust(
    c: &[Correspondence],
) -> Option<(Vec<f64>, Vec<f64>, SimilaritySolution)> {
    if c.len() < 4 {
        return None;
    }
    let similar = |weights: &[f64]| Some(solve_similarity(weighted(c, weights))?.b_from_a);
    let robust = robust_weights(c, 2, similar)?;
    let weights = combined(c, &robust);
    let solution = solve_similarity(weighted(c, &weights))?;
    Some((robust, weights, solution))
}

/// Cauchy weights of a fit that `sample` correspondences determine. `fit` makes it from certainties times weights.
///
/// The scale is the median residual of those that the fit is free to miss: through as many as it takes it goes without any.
fn robust_weights(
    c: &[Correspondence],
    sample: usize,
    fit: impl Fn(&[f64]) -> Option<Affine2>,
) -> Option<Vec<f64>> {
    let certainty: Vec<f64> = c.iter().map(|c| 1.0 / (c.sigma * c.sigma)).collect();
    let mut weights = certainty.clone();
    let mut robust = vec![1.0; c.len()];
    let (mut off_sq, mut ranked) = (vec![0.0; c.len()], Vec::new());
    let middle = (c.len() + sample).saturating_sub(1) / 2;
    for _ in 0..ROUNDS {
        let b_from_a = fit(&weights)?;
        for ((off_sq, c), certainty) in off_sq.iter_mut().zip(c).zip(&certainty) {
            *off_sq = distance_sq(b_from_a.apply(c.p_in_a), c.p_in_b) * certainty;
        }
        ranked.clone_from(&off_sq);
        let last = ranked.len().checked_sub(1)?;
        let (_, median_sq, _) = ranked.select_nth_unstable_by(middle.min(last), f64::total_cmp);
        let scale_sq = (*median_sq / (RAYLEIGH_MEDIAN * RAYLEIGH_MEDIAN)).max(1e-18);
        let half_sq = CAUCHY_WIDTH * CAUCHY_WIDTH * scale_sq;
        for i in 0..c.len() {
            robust[i] = half_sq / (half_sq + off_sq[i]);
            weights[i] = robust[i] * certainty[i];
        }
    }
    Some(robust)
}

fn distance_sq(p: Vec2, q: Vec2) -> f64 {
    let d = [p[0] - q[0], p[1] - q[1]];
    d[0] * d[0] + d[1] * d[1]
}

fn residual(b_from_a: &Affine2, c: &Correspondence) -> Vec2 {
    let there = b_from_a.apply(c.p_in_a);
    [c.p_in_b[0] - there[0], c.p_in_b[1] - there[1]]
}

pub(crate) struct SimilaritySolution {
    pub(crate) b_from_a: Affine2,
    similarity: Similarity,
    mean_a: Vec2,
    /// Weighted mean of the squared distance from `mean_a`.
    spread: f64,
}

/// Least squares similarity over `(p_in_a, p_in_b, weight)` (Umeyama 1991, in the plane closed form). `None` without two distinct
/// points.
pub(crate) fn solve_similarity(
    points: impl Iterator<Item = (Vec2, Vec2, f64)> + Clone,
) -> Option<SimilaritySolution> {
    let (mean_a, mean_b, total) = centroids(points.clone());
    if !(total.is_finite() && total > 0.0) {
        return None;
    }
    let (mut dot, mut cross, mut spread) = (0.0, 0.0, 0.0);
    for (p_in_a, p_in_b, w) in points {
        let a = [p_in_a[0] - mean_a[0], p_in_a[1] - mean_a[1]];
        let b = [p_in_b[0] - mean_b[0], p_in_b[1] - mean_b[1]];
        dot += w * (a[0] * b[0] + a[1] * b[1]);
        cross += w * (a[0] * b[1] - a[1] * b[0]);
        spread += w * (a[0] * a[0] + a[1] * a[1]);
    }
    if spread <= 0.0 {
        return None;
    }
    let (scale, angle_rad) = (f64::hypot(dot, cross) / spread, f64::atan2(cross, dot));
    let similarity = Similarity {
        scale,
        angle_rad,
        offset: through(Mat2::rotation(angle_rad) * scale, mean_a, mean_b).offset,
    };
    Some(SimilaritySolution {
        b_from_a: similarity.into(),
        similarity,
        mean_a,
        spread: spread / total,
    })
}

/// Least squares similarity, each equation weighted by `1 / sigma^2`. `None` with fewer than two distinct points.
pub fn fit_similarity(c: &[Correspondence]) -> Option<Similarity> {
    let weights: Vec<f64> = c.iter().map(|c| 1.0 / (c.sigma * c.sigma)).collect();
    Some(solve_similarity(weighted(c, &weights))?.similarity)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SplitMix64;

    const TRUTH: [[f64; 3]; 2] = [[4.2, -0.4, 31.0], [0.5, 4.1, -12.0]];

    /// Each correspondence for itself.
    const ALONE: SharedErrors = SharedErrors {
        block: 1.0,
        systematic: 0.0,
    };

    fn noisy(rng: &mut SplitMix64, n: usize, sigma: f64) -> Vec<Correspondence> {
        let truth = Affine2::from(TRUTH);
        (0..n)
            .map(|_| {
                let p_in_a = [rng.uniform() * 640.0, rng.uniform() * 480.0];
                let q = truth.apply(p_in_a);
                Correspondence {
                    p_in_a,
                    p_in_b: [q[0] + sigma * rng.normal(), q[1] + sigma * rng.normal()],
                    sigma: 1.0,
                }
            })
            .collect()
    }

    fn distance(a: Affine2, b: Affine2) -> f64 {
        [[0.0, 0.0], [639.0, 0.0], [0.0, 479.0], [639.0, 479.0]]
            .into_iter()
            .map(|p| {
                let (p, q) = (a.apply(p), b.apply(p));
                f64::hypot(p[0] - q[0], p[1] - q[1])
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn zero_residual_at_the_truth() {
        let mut rng = SplitMix64::new(3);
        let c = noisy(&mut rng, 12, 0.0);
        let fit = fit_affine(&c, &[1.0; 12], &ALONE).unwrap();
        assert!(distance(fit.b_from_a, TRUTH.into()) < 1e-9);
        assert!(fit.sigma_at([0.0, 0.0]) < 1e-9);
        let three = affine_from_3(&[c[0], c[1], c[2]]).unwrap();
        assert!(distance(three, TRUTH.into()) < 1e-8);
    }

    #[test]
    fn outliers_hardly_move_the_robust_fit() {
        let mut rng = SplitMix64::new(4);
        let mut c = noisy(&mut rng, 200, 0.3);
        let clean = fit_affine_robust(&c, &ALONE).unwrap().b_from_a;
        for c in &mut c[..30] {
            c.p_in_b[0] += 15.0;
        }
        let plain = fit_affine(&c, &[1.0; 200], &ALONE).unwrap().b_from_a;
        let robust = fit_affine_robust(&c, &ALONE).unwrap().b_from_a;
        assert!(distance(plain, clean) > 1.5 && distance(robust, clean) < 0.1);
        let exact = noisy(&mut rng, 12, 0.0);
        let fit = fit_affine_robust(&exact, &ALONE).unwrap();
        assert!(distance(fit.b_from_a, TRUTH.into()) < 1e-9);
        assert_eq!(fit_affine_robust(&exact[..2], &ALONE), None);
        assert_eq!(fit_affine_robust(&[], &ALONE), None);
    }

    #[test]
    fn four_points_do_not_pass_for_three_exact_ones() {
        // Through three of four points every affine transform goes exactly; that must not make it certain.
        let mut rng = SplitMix64::new(11);
        for _ in 0..200 {
            let c = noisy(&mut rng, 4, 0.5);
            let fit = fit_affine_robust(&c, &ALONE).unwrap();
            let sigma = fit.sigma_at(c[0].p_in_a);
            assert!(sigma > 1e-3, "{sigma}");
        }
    }

    #[test]
    fn a_similarity_of_few_points_knows_how_well_it_is_known() {
        let truth = Affine2::from(Similarity {
            scale: 3.0,
            angle_rad: 0.8,
            offset: [5.0, -7.0],
        });
        let mut rng = SplitMix64::new(12);
        let (draws, at) = (2000, [100.0, 50.0]);
        for n in [5, 8, 60] {
            let mut far = 0;
            for _ in 0..draws {
                let c: Vec<Correspondence> = (0..n)
                    .map(|_| {
                        let p_in_a = [rng.uniform() * 640.0, rng.uniform() * 480.0];
                        let q = truth.apply(p_in_a);
                        Correspondence {
                            p_in_a,
                            p_in_b: q.map(|v| v + 0.7 * rng.normal()),
                            sigma: 1.0,
                        }
                    })
                    .collect();
                let fit = fit_similarity_robust(&c, 0.0, &ALONE).unwrap();
                let (p, q) = (fit.b_from_a.apply(at), truth.apply(at));
                let off = f64::hypot(p[0] - q[0], p[1] - q[1]);
                far += usize::from(off > 3.0 * fit.sigma_at(at));
            }
            // Of a normal distribution 1.1 % lie that far out in the plane.
            assert!(far * 100 < 4 * draws, "{n}: {far} of {draws}");
        }
        let four = noisy(&mut rng, 4, 0.1);
        assert_eq!(fit_similarity_robust(&four[..3], 0.0, &ALONE), None);
        // What a similarity lacks counts by `anisotropy`: at 100 px from the centroid 0.01 is 1 px per unit of scale.
        let exact: Vec<Correspondence> = [[-9.0, 0.0], [9.0, 0.0], [0.0, 9.0], [0.0, -9.0]]
            .into_iter()
            .map(|p_in_a| Correspondence {
                p_in_a,
                p_in_b: truth.apply(p_in_a),
                sigma: 1.0,
            })
            .collect();
        let fit = fit_similarity_robust(&exact, 0.01, &ALONE).unwrap();
        assert!((fit.sigma_at([100.0, 0.0]) - 3.0).abs() < 1e-6);
        assert!((fit.sigma_at([60.0, 80.0]) - 3.0).abs() < 1e-6);
    }

    #[test]
    fn the_scatter_of_robust_fits_is_the_stated_one_for_few_points_and_many() {
        let mut rng = SplitMix64::new(13);
        let truth = Affine2::from(Similarity {
            scale: 3.0,
            angle_rad: 0.8,
            offset: [5.0, -7.0],
        });
        let (draws, at) = (1000, [100.0, 50.0]);
        for n in [6, 10, 20, 80] {
            let mut pulls_sq = [0.0; 2];
            for _ in 0..draws {
                let mut c = noisy(&mut rng, n, 0.0);
                for c in &mut c {
                    // Not all as well placed, and not as told.
                    let sigma = 0.7 * (0.5 * rng.normal()).exp();
                    c.p_in_b = truth.apply(c.p_in_a).map(|v| v + sigma * rng.normal());
                }
                let fits = [
                    fit_affine_robust(&c, &ALONE).unwrap(),
                    fit_similarity_robust(&c, 0.0, &ALONE).unwrap(),
                ];
                for (pull_sq, fit) in pulls_sq.iter_mut().zip(fits) {
                    let (p, q) = (fit.b_from_a.apply(at), truth.apply(at));
                    let off = f64::hypot(p[0] - q[0], p[1] - q[1]);
                    *pull_sq += (off / fit.sigma_at(at)).powi(2) / 2.0;
                }
            }
            for pull in pulls_sq.map(|s| (s / f64::from(draws)).sqrt()) {
                assert!((0.75..1.15).contains(&pull), "{n}: {pull}");
            }
        }
    }

    #[test]
    fn points_on_a_line_are_refused() {
        let on_line = |t: f64| Correspondence {
            p_in_a: [t, 2.0 * t + 1.0],
            p_in_b: [t, t],
            sigma: 1.0,
        };
        let c = [on_line(0.0), on_line(1.0), on_line(5.0)];
        assert_eq!(affine_from_3(&c), None);
        assert_eq!(fit_affine(&c, &[1.0; 3], &ALONE), None);
    }

    #[test]
    fn the_covariance_is_the_scatter_over_many_draws() {
        let (draws, n, sigma) = (3000, 40, 0.7);
        let mut rng = SplitMix64::new(9);
        let places = noisy(&mut rng, n, 0.0);
        let at = [500.0, 100.0];
        let (mut sum_sq, mut predicted) = (0.0, 0.0);
        let target = Affine2::from(TRUTH).apply(at);
        for _ in 0..draws {
            let mut c = places.clone();
            for c in &mut c {
                c.p_in_b[0] += sigma * rng.normal();
                c.p_in_b[1] += sigma * rng.normal();
            }
            let fit = fit_affine(&c, &vec![1.0; n], &ALONE).unwrap();
            let p = fit.b_from_a.apply(at);
            sum_sq += (p[0] - target[0]).powi(2) + (p[1] - target[1]).powi(2);
            predicted += 2.0 * fit.sigma_at(at).powi(2);
        }
        let ratio = sum_sq / predicted;
        assert!((ratio - 1.0).abs() < 0.08, "scatter / predicted = {ratio}");
    }

    #[test]
    fn one_oriented_match_is_a_similarity() {
        let truth = Similarity {
            scale: 4.3,
            angle_rad: 0.7,
            offset: [10.0, -20.0],
        };
        let p_in_a = [33.0, 44.0];
        let c = Correspondence {
            p_in_a,
            p_in_b: Affine2::from(truth).apply(p_in_a),
            sigma: 1.0,
        };
        let s = similarity_from_oriented(&c, 2.0, 2.0 * 4.3, 0.1, 0.8).unwrap();
        assert!(distance(s.into(), truth.into()) < 1e-9);
        assert_eq!(similarity_from_oriented(&c, 0.0, 1.0, 0.0, 0.0), None);
    }

    #[test]
    fn least_squares_similarity_finds_the_truth() {
        let truth = Similarity {
            scale: 0.5,
            angle_rad: -2.0,
            offset: [1.0, 2.0],
        };
        let c: Vec<_> = [[0.0, 0.0], [10.0, 0.0], [3.0, 8.0]]
            .into_iter()
            .map(|p_in_a| Correspondence {
                p_in_a,
                p_in_b: Affine2::from(truth).apply(p_in_a),
                sigma: 2.0,
            })
            .collect();
        assert!(distance(fit_similarity(&c).unwrap().into(), truth.into()) < 1e-9);
    }
}

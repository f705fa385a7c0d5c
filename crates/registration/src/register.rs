//! Features of view and target to a transform with a verdict.

use crate::correspond::coherence;
use crate::search::{Shape, fitted};
use crate::significance::{
    AFFINE_SAMPLE, SIMILARITY_SAMPLE, log10_nfa, occupied_area, unique_places,
};
use crate::{Prior, correspondences};
use scopeservo_geometry::{Affine2, AffineFit, Correspondence, Vec2, fit_similarity_robust};
use scopeservo_sift::{Features, Keypoint, Match, MatchOptions};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// How minimal hypotheses are made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// From one oriented, scaled match.
    #[default]
    Oriented,
    /// From three matches, as in the paper.
    ThreePoint,
}

/// Settings of a registration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Nearest over second nearest descriptor distance, at most.
    pub ratio: f32,
    /// A match agrees with the transform when it lands this near, in pixels of the coarser image.
    pub threshold_px: f64,
    /// Expected number of false "found" per registration of unrelated images, at most.
    pub false_alarms: f64,
    /// A transform is refused when the predicted standard deviation of a view corner, in target pixels, is larger.
    pub max_corner_sigma_px: f64,
    /// How minimal hypotheses are made.
    pub method: Method,
    /// Seed of the random samples.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            ratio: 0.85,
            threshold_px: 2.5,
            false_alarms: 1e-6,
            max_corner_sigma_px: 12.0,
            method: Method::Oriented,
            seed: 0,
        }
    }
}

/// Why a registration was not found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Error)]
#[serde(tag = "code", rename_all = "snake_case")]
pub enum NotFound {
    /// An image has too little texture.
    #[error(
        "too little texture: {view} features in the view and {target} in the target, {needed} are needed in each"
    )]
    TooFewFeatures {
        /// Features of the view.
        view: usize,
        /// Features of the target.
        target: usize,
        /// Needed in each.
        needed: usize,
    },
    /// Hardly anything in one image looks like anything in the other.
    #[error(
        "only {matches} features of the view look like features of the target, {needed} are needed"
    )]
    TooFewMatches {
        /// Matches after ratio and mutual test.
        matches: usize,
        /// Needed.
        needed: usize,
    },
    /// No possible transform has agreeing matches.
    #[error("none of {matches} matches agree on a possible transform")]
    NoAgreement {
        /// Matches after ratio and mutual test.
        matches: usize,
    },
    /// As many agreeing matches come up between unrelated images.
    #[error("{inliers} agreeing places among {matches} matches could be chance")]
    ByChance {
        /// Agreeing unique places.
        inliers: usize,
        /// Unique matches.
        matches: usize,
        /// log10 of the expected number of such agreements between unrelated images; `None` when they prove nothing.
        log10_nfa: Option<f64>,
    },
    /// The matches agree, but leave the transform open.
    #[error("the agreeing matches leave a view corner uncertain by {corner_sigma_px:.1} target px")]
    Uncertain {
        /// Largest predicted standard deviation of a view corner in target pixels.
        corner_sigma_px: f64,
    },
}

/// A transform with its uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Pixel of the target from pixel of the view; integer coordinates are pixel centres.
    pub target_from_view: Affine2,
    /// Covariance of the 2x3 matrix, row by row.
    pub covariance: [[f64; 6]; 6],
    /// Standard deviation per coordinate of where the view's centre lands, target px.
    pub sigma_px: f64,
    /// The same for the worst corner of the view.
    pub corner_sigma_px: f64,
    /// Standard deviation of the rotation, radians.
    pub sigma_angle_rad: f64,
}

impl Estimate {
    /// That of a picture to itself, known for sure.
    pub fn at_rest() -> Self {
        Self {
            target_from_view: Affine2::IDENTITY,
            covariance: [[0.0; 6]; 6],
            sigma_px: 0.0,
            corner_sigma_px: 0.0,
            sigma_angle_rad: 0.0,
        }
    }
}

/// The answer of a registration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Registration {
    /// The transform when found, or why not.
    pub outcome: Result<Estimate, NotFound>,
    /// Agreeing matches on unique places.
    pub inliers: usize,
    /// Matches after ratio and mutual test.
    pub matches: usize,
    /// log10 of the expected number of agreements as good between unrelated images; `None` when nothing agreed.
    pub log10_nfa: Option<f64>,
    /// Agreeing places for drawing: x, y in the view, x, y in the target.
    pub pairs: Vec<[f32; 4]>,
    /// The same as indices: feature of the view, feature of the target.
    pub agreeing: Vec<[usize; 2]>,
}

impl Registration {
    /// The transform, when found.
    pub fn found(&self) -> Option<&Estimate> {
        self.outcome.as_ref().ok()
    }

    fn not_found(reason: NotFound, matches: usize) -> Self {
        Self {
            outcome: Err(reason),
            inliers: 0,
            matches,
            log10_nfa: None,
            pairs: Vec::new(),
            agreeing: Vec::new(),
        }
    }
}

/// Fewer features or matches than this can never pass the significance test.
const MIN_MATCHES: usize = 5;
/// How far from a similarity the transform between two views of a microscope may be, relative to its scale: standard deviation.
/// Between the paper's 100x and 400x views it is 0.004.
pub(crate) const ANISOTROPY: f64 = 0.005;
/// Places closer than this, in pixels of each image times its keypoints' finest scale, are one place.
const PLACE_PX: f64 = 2.0;

/// A registration with the matches that it was made from.
#[derive(Debug, Clone, PartialEq)]
pub struct Matched {
    /// The answer.
    pub registration: Registration,
    /// Matches after ratio and mutual test.
    pub matches: Vec<Match>,
    /// Their places, in the same order.
    pub pairs: Vec<Correspondence>,
}

impl Matched {
    /// Matches and registers a view to a target.
    ///
    /// Cost: one gated brute-force match, then [`register_matches`].
    pub fn of(view: &Features, target: &Features, prior: &Prior, options: &Options) -> Self {
        if view.len() < MIN_MATCHES || target.len() < MIN_MATCHES {
            let reason = NotFound::TooFewFeatures {
                view: view.len(),
                target: target.len(),
                needed: MIN_MATCHES,
            };
            return Self {
                registration: Registration::not_found(reason, 0),
                matches: Vec::new(),
                pairs: Vec::new(),
            };
        }
        let match_options = MatchOptions {
            ratio: options.ratio,
            mutual: true,
        };
        let (matches, pairs) = correspondences(view, target, prior, &match_options);
        Self {
            registration: register_matches(view, target, prior, options, &matches, &pairs),
            matches,
            pairs,
        }
    }

    /// The answer of those matches alone that count.
    pub fn of_those(
        &self,
        (view, target): (&Features, &Features),
        prior: &Prior,
        options: &Options,
        counts: impl Fn(&Match, &Correspondence) -> bool,
    ) -> Registration {
        let (matches, pairs): (Vec<Match>, Vec<Correspondence>) = self
            .matches
            .iter()
            .zip(&self.pairs)
            .filter(|(m, c)| counts(m, c))
            .map(|(m, c)| (*m, *c))
            .unzip();
        register_matches(view, target, prior, options, &matches, &pairs)
    }
}

/// Registers a view to a target; as [`Matched::of`].
pub fn register(
    view: &Features,
    target: &Features,
    prior: &Prior,
    options: &Options,
) -> Registration {
    Matched::of(view, target, prior, options).registration
}

/// What follows the matching: search, robust fit and verdict, from the [`correspondences`] of view and target.
///
/// Cost: about half a millisecond for 2000 matches.
pub fn register_matches(
    view: &Features,
    target: &Features,
    prior: &Prior,
    options: &Options,
    matches: &[Match],
    pairs: &[Correspondence],
) -> Registration {
    if matches.len() < MIN_MATCHES {
        let reason = NotFound::TooFewMatches {
            matches: matches.len(),
            needed: MIN_MATCHES,
        };
        return Registration::not_found(reason, matches.len());
    }
    let no_agreement = || {
        let reason = NotFound::NoAgreement {
            matches: matches.len(),
        };
        Registration::not_found(reason, matches.len())
    };

    // One pixel of the coarser image, in target pixels: what localisation can hope for.
    let typical_ratio = prior.scale.map_or_else(
        || {
            let ratio = |(v, t): (&Keypoint, &Keypoint)| f64::from(t.sigma) / f64::from(v.sigma);
            let mut ratios: Vec<f64> = keypoints(view, target, matches).map(ratio).collect();
            let middle = ratios.len() / 2;
            *ratios.select_nth_unstable_by(middle, f64::total_cmp).1
        },
        |s| s.ratio,
    );
    let coarse_px = typical_ratio.max(1.0);
    let threshold = options.threshold_px * coarse_px;

    let fit = |shape| {
        fitted(
            view, target, matches, pairs, prior, options, threshold, shape,
        )
    };
    // Places near a line leave an affine transform open, and a similarity not.
    let by_affine = fit(Shape::Affine).map(|fit| (fit, AFFINE_SAMPLE, 2.0));
    let Some((fit, sample, kinds)) =
        by_affine.or_else(|| Some((fit(Shape::Similarity)?, SIMILARITY_SAMPLE, 3.0)))
    else {
        return no_agreement();
    };

    // The verdict, on unique places: the best-fitting match of each neighbourhood stands for it.
    let ranked = ranked(
        &fit.b_from_a,
        view,
        target,
        matches,
        pairs,
        0..matches.len(),
    );
    let points: Vec<(Vec2, Vec2)> = ranked
        .iter()
        .map(|&(_, i)| (pairs[i].p_in_a, pairs[i].p_in_b))
        .collect();
    let apart_view = PLACE_PX * (coarse_px / typical_ratio);
    let places: Vec<(f64, usize)> = unique_places(&points, apart_view, PLACE_PX * coarse_px)
        .into_iter()
        .map(|k| ranked[k])
        .collect();
    // In order of their residuals.
    let within = |r: f64| places.partition_point(|place| place.0 <= r);
    let area = occupied_area(
        target
            .keypoints
            .iter()
            .map(|k| [f64::from(k.x), f64::from(k.y)]),
        20.0,
    );
    // The least probable of three radii and so many kinds of transform counts; having tried six costs a factor of six.
    let radii = [threshold, threshold / 2.0, threshold / 4.0];
    let tried = (kinds * radii.len() as f64).log10();
    let least = |sample: usize, within: &dyn Fn(f64) -> usize| {
        let nfa = |&r: &f64| {
            let chance = std::f64::consts::PI * r * r / area * prior.chance_of_coherence();
            log10_nfa(sample, places.len(), within(r), chance) + tried
        };
        radii.iter().map(nfa).fold(f64::INFINITY, f64::min)
    };
    let (mut fit, mut nfa) = (fit, least(sample, &within));
    let mut agreeing: Vec<usize> = places[..within(threshold)].iter().map(|p| p.1).collect();
    let limit = options.false_alarms.log10();
    if nfa >= limit
        && sample == AFFINE_SAMPLE
        && let Some(similar) = similar(view, target, matches, pairs, &places, &agreeing)
        && prior.allows(&similar.fit.b_from_a)
    {
        // Too few places for an affine transform may be enough for a similarity, and then that is the answer.
        let within = |r: f64| similar.residuals.partition_point(|place| place.0 <= r);
        let by_similarity = least(SIMILARITY_SAMPLE, &within);
        if by_similarity < nfa {
            nfa = by_similarity;
            let near = &similar.residuals[..within(threshold)];
            agreeing = near.iter().map(|place| place.1).collect();
            fit = similar.fit;
        }
    }
    agreeing.sort_unstable();

    let (w, h) = (view.width as f64 - 1.0, view.height as f64 - 1.0);
    let corner_sigma_px = [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]]
        .into_iter()
        .map(|p| fit.sigma_at(p))
        .fold(0.0, f64::max);
    let outcome = if nfa >= limit {
        Err(NotFound::ByChance {
            inliers: agreeing.len(),
            matches: places.len(),
            log10_nfa: nfa.is_finite().then_some(nfa),
        })
    } else if corner_sigma_px.is_nan() || corner_sigma_px > options.max_corner_sigma_px * coarse_px
    {
        Err(NotFound::Uncertain { corner_sigma_px })
    } else {
        Ok(Estimate {
            target_from_view: fit.b_from_a,
            covariance: fit.covariance,
            sigma_px: fit.sigma_at([w / 2.0, h / 2.0]),
            corner_sigma_px,
            sigma_angle_rad: sigma_angle_rad(&fit),
        })
    };
    Registration {
        outcome,
        inliers: agreeing.len(),
        matches: matches.len(),
        log10_nfa: nfa.is_finite().then_some(nfa),
        pairs: agreeing
            .iter()
            .map(|&i| {
                let Correspondence { p_in_a, p_in_b, .. } = pairs[i];
                [
                    p_in_a[0] as f32,
                    p_in_a[1] as f32,
                    p_in_b[0] as f32,
                    p_in_b[1] as f32,
                ]
            })
            .collect(),
        agreeing: agreeing
            .iter()
            .map(|&i| [matches[i].query, matches[i].train])
            .collect(),
    }
}

/// A similarity, and how far each place lies from where it belongs: residual and match, in order.
struct Similar {
    fit: AffineFit,
    residuals: Vec<(f64, usize)>,
}

/// The robust similarity through the matches that `agree`.
fn similar(
    view: &Features,
    target: &Features,
    matches: &[Match],
    pairs: &[Correspondence],
    places: &[(f64, usize)],
    agree: &[usize],
) -> Option<Similar> {
    let chosen: Vec<Correspondence> = agree.iter().map(|&i| pairs[i]).collect();
    let fit = fit_similarity_robust(&chosen, ANISOTROPY)?;
    let of = places.iter().map(|place| place.1);
    let residuals = ranked(&fit.b_from_a, view, target, matches, pairs, of);
    Some(Similar { fit, residuals })
}

/// How far each of the matches `of` lies from where it belongs, and which it is, in order. What turns or scales otherwise is infinitely
/// far off.
fn ranked(
    transform: &Affine2,
    view: &Features,
    target: &Features,
    matches: &[Match],
    pairs: &[Correspondence],
    of: impl Iterator<Item = usize>,
) -> Vec<(f64, usize)> {
    let coherent = coherence(transform);
    let mut ranked: Vec<(f64, usize)> = of
        .map(|i| {
            let Match { query, train, .. } = matches[i];
            match coherent(&view.keypoints[query], &target.keypoints[train]) {
                true => (residual(transform, &pairs[i]), i),
                false => (f64::INFINITY, i),
            }
        })
        .collect();
    // A stable sort: of equals the first match stays the first.
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    ranked
}

/// The keypoints of each match.
pub(crate) fn keypoints<'a>(
    view: &'a Features,
    target: &'a Features,
    matches: &'a [Match],
) -> impl Iterator<Item = (&'a Keypoint, &'a Keypoint)> {
    matches
        .iter()
        .map(|m| (&view.keypoints[m.query], &target.keypoints[m.train]))
}

fn residual(transform: &Affine2, c: &Correspondence) -> f64 {
    let q = transform.apply(c.p_in_a);
    let d = [q[0] - c.p_in_b[0], q[1] - c.p_in_b[1]];
    (d[0] * d[0] + d[1] * d[1]).sqrt()
}

/// The angle is `atan2(a21 - a12, a11 + a22)`: to first order its variance is that of `a21 - a12` over the square of
/// `a11 + a22` turned upright, `4 det` for a similarity.
fn sigma_angle_rad(fit: &AffineFit) -> f64 {
    let c = &fit.covariance;
    let [[a11, a12], [a21, a22]] = fit.b_from_a.linear.0;
    let (up, across) = (a11 + a22, a21 - a12);
    // Gradient of the angle in (a11, a12, a21, a22); rows 0, 1, 3, 4 of the covariance.
    let size_sq = up * up + across * across;
    let gradient = [-across, -up, up, -across].map(|g| g / size_sq);
    let rows = [0, 1, 3, 4];
    let mut variance = 0.0;
    for (i, gi) in rows.iter().zip(gradient) {
        for (j, gj) in rows.iter().zip(gradient) {
            variance += gi * c[*i][*j] * gj;
        }
    }
    variance.max(0.0).sqrt()
}

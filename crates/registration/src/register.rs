//! Correspondences to a transform with a verdict.

use crate::correspondences::{Correspondences, MIN_MATCHES};
use crate::outcome::corner_sigma_px;
use crate::prior::coherence;
use crate::search::{ANISOTROPY, Search, Shape};
use crate::significance::{AFFINE_SAMPLE, SIMILARITY_SAMPLE, log10_nfa, unique_places};
use crate::{Estimate, NotFound, Options, Prior, Registration};
use scopeservo_features::{FeatureEngine, Features};
use scopeservo_geometry::{
    Affine2, AffineFit, Correspondence, SharedErrors, Vec2, fit_similarity_robust,
};

/// Places closer than this, in pixels of each image times its keypoints' finest scale, are one place.
const PLACE_PX: f64 = 2.0;
/// Side of the squares within which errors may be shared, in sigmas of the keypoints: two windows of a descriptor. What lies nearer
/// together than one window sees the same pixels.
const SHARED_SIGMAS: f64 = 24.0;
/// What all places of an image may be off by, in pixels of the coarser image: no residual shows it. Less than was ever measured, so that
/// nothing is known for sure.
const SYSTEMATIC_PX: f64 = 0.0005;

/// Matches and registers a view to a target.
///
/// Cost: one gated brute-force match, then [`register_correspondences`].
pub fn register(
    engine: &dyn FeatureEngine,
    view: &Features,
    target: &Features,
    prior: &Prior,
    options: &Options,
) -> Registration {
    match Correspondences::of(engine, view, target, prior, options) {
        Ok(all) => register_correspondences(&all, prior, options),
        Err(reason) => Registration::not_found(reason, 0),
    }
}

/// What follows the matching: search, robust fit and verdict.
///
/// Cost: about half a millisecond for 2000 correspondences.
pub fn register_correspondences(
    all: &Correspondences,
    prior: &Prior,
    options: &Options,
) -> Registration {
    let matches = all.len();
    if matches < MIN_MATCHES {
        let needed = MIN_MATCHES;
        return Registration::not_found(NotFound::TooFewMatches { matches, needed }, matches);
    }
    // One pixel of the coarser image, in target pixels: what localisation can hope for.
    let typical_ratio = prior.scale.map_or_else(|| median_ratio(all), |s| s.ratio);
    let coarse_px = typical_ratio.max(1.0);
    let threshold = options.threshold_px * coarse_px;
    let search = Search {
        all,
        prior,
        options,
        threshold,
        shared: SharedErrors {
            block: SHARED_SIGMAS * median(all.shapes.iter().map(|shapes| shapes[0])),
            systematic: SYSTEMATIC_PX * coarse_px,
        },
    };
    // Places near a line leave an affine transform open, and a similarity not.
    let by_affine = search.fitted(Shape::Affine);
    let by_affine = by_affine.map(|fit| (fit, AFFINE_SAMPLE, 2.0));
    let fitted =
        by_affine.or_else(|| Some((search.fitted(Shape::Similarity)?, SIMILARITY_SAMPLE, 3.0)));
    let Some((fit, sample, kinds)) = fitted else {
        return Registration::not_found(NotFound::NoAgreement { matches }, matches);
    };
    let places = places(all, &fit, coarse_px / typical_ratio, coarse_px);
    let test = Significance {
        prior,
        area: all.target_area,
        places: places.len(),
        threshold,
        kinds,
    };
    // In order of their residuals.
    let within = |r: f64| places.partition_point(|place| place.0 <= r);
    let mut best = Agreement {
        log10_nfa: test.least_log10_nfa(sample, &within),
        agreeing: places[..within(threshold)].iter().map(|p| p.1).collect(),
        fit,
    };
    let passes =
        |a: &Agreement| a.is_significant(options) && a.uncertain(all, options, coarse_px).is_none();
    if !passes(&best) && sample == AFFINE_SAMPLE {
        // Too few places for an affine transform may be enough for a similarity, and then that is the answer.
        let similar = similar(&search, &places, &best.agreeing, &test);
        best = similar
            .filter(|s| prior.allows(&s.fit.b_from_a))
            .filter(|s| s.log10_nfa < best.log10_nfa || passes(s))
            .unwrap_or(best);
    }
    best.agreeing.sort_unstable();
    answer(all, &best, places.len(), options, coarse_px)
}

/// Target over view of the keypoints' sizes, in the median.
fn median_ratio(all: &Correspondences) -> f64 {
    median(all.shapes.iter().map(|[view, target, ..]| target / view))
}

/// Of at least one value.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// A transform and those that agree with it.
struct Agreement {
    fit: AffineFit,
    agreeing: Vec<usize>,
    /// The expected number of agreements as good between unrelated images.
    log10_nfa: f64,
}

impl Agreement {
    fn is_significant(&self, options: &Options) -> bool {
        self.log10_nfa < options.false_alarms.log10()
    }

    /// The standard deviation of the worst corner of the view, target pixels.
    fn corner_sigma_px(&self, all: &Correspondences) -> f64 {
        corner_sigma_px(&self.fit, all.view_size)
    }

    /// The same when it is more than is allowed.
    fn uncertain(&self, all: &Correspondences, options: &Options, coarse_px: f64) -> Option<f64> {
        let sigma_px = self.corner_sigma_px(all);
        let allowed = sigma_px <= options.max_corner_sigma_px * coarse_px;
        (!allowed).then_some(sigma_px)
    }
}

/// What chance could do.
struct Significance<'a> {
    prior: &'a Prior,
    area: f64,
    places: usize,
    threshold: f64,
    /// Kinds of transform that were tried.
    kinds: f64,
}

impl Significance<'_> {
    /// The least probable of three radii and so many kinds of transform counts; having tried six costs a factor of six
    /// (Bonferroni). `within`: how many places lie within a radius.
    fn least_log10_nfa(&self, sample: usize, within: &dyn Fn(f64) -> usize) -> f64 {
        let radii = [self.threshold, self.threshold / 2.0, self.threshold / 4.0];
        let tried = (self.kinds * radii.len() as f64).log10();
        let nfa = |&r: &f64| {
            let share = std::f64::consts::PI * r * r / self.area;
            let chance = share * self.prior.chance_of_coherence();
            log10_nfa(sample, self.places, within(r), chance) + tried
        };
        radii.iter().map(nfa).fold(f64::INFINITY, f64::min)
    }
}

/// Unique places, by residual: the best-fitting match of each neighbourhood stands for it.
fn places(
    all: &Correspondences,
    fit: &AffineFit,
    view_px: f64,
    target_px: f64,
) -> Vec<(f64, usize)> {
    let ranked = ranked(&fit.b_from_a, all, 0..all.len());
    let points: Vec<(Vec2, Vec2)> = ranked
        .iter()
        .map(|&(_, i)| (all.pairs[i].p_in_a, all.pairs[i].p_in_b))
        .collect();
    unique_places(&points, PLACE_PX * view_px, PLACE_PX * target_px)
        .into_iter()
        .map(|k| ranked[k])
        .collect()
}

/// The robust similarity through the matches that `agree`.
fn similar(
    search: &Search<'_>,
    places: &[(f64, usize)],
    agree: &[usize],
    test: &Significance<'_>,
) -> Option<Agreement> {
    let all = search.all;
    let chosen: Vec<Correspondence> = agree.iter().map(|&i| all.pairs[i]).collect();
    let fit = fit_similarity_robust(&chosen, ANISOTROPY, &search.shared)?;
    let residuals = ranked(&fit.b_from_a, all, places.iter().map(|place| place.1));
    let within = |r: f64| residuals.partition_point(|place| place.0 <= r);
    let near = &residuals[..within(test.threshold)];
    Some(Agreement {
        log10_nfa: test.least_log10_nfa(SIMILARITY_SAMPLE, &within),
        agreeing: near.iter().map(|place| place.1).collect(),
        fit,
    })
}

/// How far each of the matches `of` lies from where it belongs, and which it is, in order. What turns or scales otherwise is infinitely
/// far off.
fn ranked(
    transform: &Affine2,
    all: &Correspondences,
    of: impl Iterator<Item = usize>,
) -> Vec<(f64, usize)> {
    let coherent = coherence(transform);
    let mut ranked: Vec<(f64, usize)> = of
        .map(|i| match coherent(&all.shapes[i]) {
            true => (residual(transform, &all.pairs[i]), i),
            false => (f64::INFINITY, i),
        })
        .collect();
    // A stable sort: of equals the first match stays the first.
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    ranked
}

fn residual(transform: &Affine2, c: &Correspondence) -> f64 {
    let q = transform.apply(c.p_in_a);
    let d = [q[0] - c.p_in_b[0], q[1] - c.p_in_b[1]];
    (d[0] * d[0] + d[1] * d[1]).sqrt()
}

/// The verdict.
fn answer(
    all: &Correspondences,
    best: &Agreement,
    places: usize,
    options: &Options,
    coarse_px: f64,
) -> Registration {
    let fit = &best.fit;
    let log10_nfa = best.log10_nfa.is_finite().then_some(best.log10_nfa);
    let outcome = if !best.is_significant(options) {
        Err(NotFound::ByChance {
            inliers: best.agreeing.len(),
            matches: places,
            log10_nfa,
        })
    } else if let Some(corner_sigma_px) = best.uncertain(all, options, coarse_px) {
        Err(NotFound::Uncertain { corner_sigma_px })
    } else {
        Ok(Estimate::of(fit, all.view_size))
    };
    let drawn = |&i: &usize| {
        let Correspondence { p_in_a, p_in_b, .. } = all.pairs[i];
        [p_in_a[0], p_in_a[1], p_in_b[0], p_in_b[1]].map(|v| v as f32)
    };
    Registration {
        outcome,
        inliers: best.agreeing.len(),
        matches: all.len(),
        log10_nfa,
        pairs: best.agreeing.iter().map(drawn).collect(),
        agreeing: best.agreeing.iter().map(|&i| all.indices[i]).collect(),
    }
}

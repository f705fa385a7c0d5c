//! Where a target of few things lies in a view of a lower magnification, by how they lie: cells of a smear look alike, and how they are scattered over the glass
//! never does.
//!
//! Where matches of descriptors say nothing, the keypoints of view and target are taken for what they are besides: places, each with a size and a
//! polarity. Two of the target's and two of the view's, as far apart as the scale that is known asks, propose a transform (`search`); what says
//! how much it is worth is how many of the others land on one (`judge`), against what chance puts there where things lie as densely. A second
//! transform that says as much makes it ambiguous, as a lattice of cells does.
//!
//! What is fixed to the camera keeps its size in pixels, so that it cannot agree with a scale that is none of one: this is for magnifications that differ.

mod judge;
mod near;
mod places;
mod search;

use crate::corners::{centre, corners};
use crate::search::ANISOTROPY;
use crate::{Correspondences, Estimate, NotFound, Options, Prior, Registration, Rival};
use judge::{Judge, Judged};
use places::{LEAST_PLACES, Places};
use scopeservo_features::Features;
use scopeservo_geometry::{
    Affine2, AffineFit, Correspondence, SharedErrors, fit_similarity_robust,
};
use search::proposals;

/// Target pixels per pixel of the view, at least.
pub const LEAST_RATIO: f64 = 1.5;
/// Of the target's places in view at least this share agrees.
const LEAST_SHARE: f64 = 0.5;
/// Expected number of agreements as good among things that are scattered as densely, at most: log10.
const LOG10_CHANCE: f64 = -6.0;
/// Another transform is as good when its agreement is by this share as improbable.
const AS_GOOD: f64 = 0.6;
/// What one place may be off by, pixels of the view: keypoints of one thing at two magnifications. Few of them do not tell it.
const PLACE_SIGMA_PX: f64 = 0.4;

/// What a constellation says.
#[derive(Debug, Clone, PartialEq)]
pub struct Constellation {
    /// The transform, or why there is none.
    pub registration: Registration,
    /// The places that agree: indices are keypoints of view and target.
    pub correspondences: Correspondences,
    /// Other transforms that say as much: with any of them it is ambiguous.
    pub rivals: Vec<Rival>,
}

/// Looks for a target of few things in a view. `None` where this is not the way: no scale is known, the magnifications are alike, or things lie too
/// densely or are too few to tell.
///
/// Cost: below 100 ms for 1000 keypoints of the view, one core.
pub fn constellation(
    view: &Features,
    target: &Features,
    prior: &Prior,
    options: &Options,
) -> Option<Constellation> {
    let ratio = prior.scale.filter(|s| s.ratio >= LEAST_RATIO)?.ratio;
    let of_view = Places::of_view(view);
    let of_target = Places::of_target(target, ratio);
    let judge = Judge::new(&of_view, &of_target, prior, options.threshold_px)?;
    let proposed = proposals(&judge);
    let mut judged: Vec<Judged> = proposed
        .transforms
        .iter()
        .filter_map(|t| judge.judged(t, proposed.tried))
        .collect();
    judged.sort_by(|a, b| {
        let fewer = b.agreeing.len().cmp(&a.agreeing.len());
        a.log10_nfa.total_cmp(&b.log10_nfa).then(fewer)
    });
    let best = judged.first()?.clone();
    let others = judged[1..]
        .iter()
        .filter(|o| elsewhere(view, &best.target_from_view, &o.target_from_view, ratio))
        .filter(|o| o.log10_nfa <= AS_GOOD * best.log10_nfa);
    let middle = centre([view.width, view.height]);
    let rival = |other: &Judged| {
        let counts = [other.agreeing.len(), best.agreeing.len()];
        let (first, second) = (&best.target_from_view, &other.target_from_view);
        let rival = Rival::beside(first, second, middle, counts)?;
        Some(Rival {
            significant: true,
            ..rival
        })
    };
    let rivals = others.filter_map(rival).collect();
    let correspondences = correspondences(view, target, &best, &judge);
    Some(Constellation {
        registration: registration(
            &correspondences,
            &best,
            [target.width, target.height],
            prior,
            options,
        ),
        correspondences,
        rivals,
    })
}

fn correspondences(
    view: &Features,
    target: &Features,
    best: &Judged,
    judge: &Judge<'_>,
) -> Correspondences {
    let mut all = Correspondences {
        view_size: [view.width, view.height],
        target_area: (target.width * target.height) as f64,
        indices: Vec::new(),
        pairs: Vec::new(),
        shapes: Vec::new(),
    };
    let mut agreeing = best.agreeing.clone();
    agreeing.sort_unstable();
    for [v, t] in agreeing {
        let (v, t) = (judge.view.all[v], judge.target.all[t]);
        all.indices.push([v.index, t.index]);
        all.pairs.push(Correspondence {
            p_in_a: v.at,
            p_in_b: t.at,
            sigma: 1.0,
        });
        let keypoints = (&view.keypoints[v.index], &target.keypoints[t.index]);
        let (v, t) = keypoints;
        all.shapes
            .push([v.sigma, t.sigma, v.angle, t.angle].map(f64::from));
    }
    all
}

/// The verdict.
fn registration(
    all: &Correspondences,
    best: &Judged,
    target_size: [usize; 2],
    prior: &Prior,
    options: &Options,
) -> Registration {
    let ratio = prior.scale.map_or(1.0, |s| s.ratio);
    let (inliers, matches) = (all.len(), best.places);
    let drawn = all.pairs.iter().map(|c| {
        let [a, b] = [c.p_in_a, c.p_in_b];
        [a[0], a[1], b[0], b[1]].map(|v| v as f32)
    });
    // Each is a block of its own: they are different things.
    let shared = SharedErrors {
        block: 1.0,
        systematic: PLACE_SIGMA_PX * ratio / (inliers.max(1) as f64).sqrt(),
    };
    let fit = fit_similarity_robust(&all.pairs, ANISOTROPY, &shared);
    let least = options.false_alarms.log10().min(LOG10_CHANCE);
    let enough = inliers >= LEAST_PLACES && best.log10_nfa < least && best.is_whole(LEAST_SHARE);
    let outcome = match fit.filter(|fit| prior.allows(&fit.b_from_a)) {
        _ if !enough => Err(NotFound::ByChance {
            inliers,
            matches,
            log10_nfa: Some(best.log10_nfa),
        }),
        None => Err(NotFound::NoAgreement { matches }),
        Some(fit) => {
            let corner_sigma_px = target_sigma_px(&fit, target_size);
            match corner_sigma_px <= options.max_corner_sigma_px * ratio {
                true => Ok(Estimate::of(&fit, all.view_size)),
                false => Err(NotFound::Uncertain { corner_sigma_px }),
            }
        }
    };
    Registration {
        outcome,
        inliers,
        matches,
        log10_nfa: Some(best.log10_nfa),
        pairs: drawn.collect(),
        agreeing: all.indices.clone(),
    }
}

/// The standard deviation of the worst corner of the target as it lies in the view, target pixels: the view's own corners are far from everything
/// that was compared.
fn target_sigma_px(fit: &AffineFit, target_size: [usize; 2]) -> f64 {
    let Some(view_from_target) = fit.b_from_a.inverse() else {
        return f64::INFINITY;
    };
    let lie = corners(target_size).into_iter();
    let sigmas = lie.map(|p| fit.sigma_at(view_from_target.apply(p)));
    sigmas.fold(0.0, f64::max)
}

/// Whether two transforms put some corner of the view at different places.
fn elsewhere(view: &Features, first: &Affine2, other: &Affine2, ratio: f64) -> bool {
    corners([view.width, view.height]).into_iter().any(|p| {
        let (a, b) = (first.apply(p), other.apply(p));
        f64::hypot(a[0] - b[0], a[1] - b[1]) > 12.0 * ratio
    })
}

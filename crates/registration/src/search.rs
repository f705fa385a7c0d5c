//! The search for a transform among matches, and the robust fit to what agrees with it.

use crate::correspond::coherence;
use crate::register::{ANISOTROPY, keypoints};
use crate::{Method, Options, Prior};
use scopeservo_geometry::{
    Affine2, AffineFit, AffineProblem, Correspondence, OrientedProblem, RansacOptions, RobustFit,
    fit_affine_robust, fit_similarity_robust, lo_ransac,
};
use scopeservo_sift::{Features, Match};

/// What is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shape {
    Affine,
    Similarity,
}

/// The search and the robust fit to what agrees, when a possible transform comes out.
#[expect(
    clippy::too_many_arguments,
    reason = "all that a registration knows, and it is asked twice"
)]
pub(crate) fn fitted(
    view: &Features,
    target: &Features,
    matches: &[Match],
    pairs: &[Correspondence],
    prior: &Prior,
    options: &Options,
    threshold: f64,
    shape: Shape,
) -> Option<AffineFit> {
    let rough = search(
        view, target, matches, pairs, prior, options, threshold, shape,
    )?;
    let coherent = coherence(&rough.model);
    let chosen: Vec<Correspondence> = rough
        .inliers
        .iter()
        .filter(|&&i| {
            let Match { query, train, .. } = matches[i];
            coherent(&view.keypoints[query], &target.keypoints[train])
        })
        .map(|&i| pairs[i])
        .collect();
    let fit = match shape {
        Shape::Affine => fit_affine_robust(&chosen),
        Shape::Similarity => fit_similarity_robust(&chosen, ANISOTROPY),
    };
    fit.filter(|fit| prior.allows(&fit.b_from_a))
}

#[expect(clippy::too_many_arguments, reason = "as above")]
fn search(
    view: &Features,
    target: &Features,
    matches: &[Match],
    pairs: &[Correspondence],
    prior: &Prior,
    options: &Options,
    threshold: f64,
    shape: Shape,
) -> Option<RobustFit<Affine2>> {
    let possible = |m: &Affine2| prior.allows(m);
    let ransac = RansacOptions {
        threshold,
        seed: options.seed,
        ..RansacOptions::default()
    };
    if options.method == Method::ThreePoint {
        // The paper's way knows no similarity.
        let affine = shape == Shape::Affine;
        return affine.then(|| lo_ransac(&AffineProblem::new(pairs, &possible), &ransac))?;
    }
    let oriented: Vec<[f64; 4]> = keypoints(view, target, matches)
        .map(|(v, t)| [v.sigma, t.sigma, v.angle, t.angle].map(f64::from))
        .collect();
    let problem = OrientedProblem::new(pairs, &oriented, &possible);
    match shape {
        Shape::Affine => lo_ransac(&problem, &ransac),
        Shape::Similarity => lo_ransac(&problem.similar(), &ransac),
    }
}

//! The search for a transform among correspondences, and the robust fit to what agrees with it.

use crate::correspondences::Correspondences;
use crate::prior::coherence;
use crate::{Method, Options, Prior};
use scopeservo_geometry::{
    Affine2, AffineFit, AffineProblem, Correspondence, OrientedProblem, RansacOptions, RobustFit,
    SharedErrors, fit_affine_robust, fit_similarity_robust, lo_ransac,
};

/// How far from a similarity the transform between two views of a microscope may be, relative to its scale: standard deviation.
/// Between the paper's 100x and 400x views it is 0.004.
pub(crate) const ANISOTROPY: f64 = 0.005;

/// What is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shape {
    Affine,
    Similarity,
}

/// What is searched in, and for what.
pub(crate) struct Search<'a> {
    pub(crate) all: &'a Correspondences,
    pub(crate) prior: &'a Prior,
    pub(crate) options: &'a Options,
    /// A match agrees when it lands this near, target pixels.
    pub(crate) threshold: f64,
    pub(crate) shared: SharedErrors,
}

impl Search<'_> {
    /// The search and the robust fit to what agrees, when a possible transform comes out.
    pub(crate) fn fitted(&self, shape: Shape) -> Option<AffineFit> {
        let rough = self.rough(shape)?;
        let coherent = coherence(&rough.model);
        let inliers = rough.inliers.iter();
        let chosen: Vec<Correspondence> = inliers
            .filter(|&&i| coherent(&self.all.shapes[i]))
            .map(|&i| self.all.pairs[i])
            .collect();
        let fit = match shape {
            Shape::Affine => fit_affine_robust(&chosen, &self.shared),
            Shape::Similarity => fit_similarity_robust(&chosen, ANISOTROPY, &self.shared),
        };
        fit.filter(|fit| self.prior.allows(&fit.b_from_a))
    }

    fn rough(&self, shape: Shape) -> Option<RobustFit<Affine2>> {
        let (all, options) = (self.all, self.options);
        let possible = |m: &Affine2| self.prior.allows(m);
        let ransac = RansacOptions {
            threshold: self.threshold,
            seed: options.seed,
            ..RansacOptions::default()
        };
        if options.method == Method::ThreePoint {
            // The paper's way knows no similarity.
            let affine = shape == Shape::Affine;
            return affine
                .then(|| lo_ransac(&AffineProblem::new(&all.pairs, &possible), &ransac))?;
        }
        let problem = OrientedProblem::new(&all.pairs, &all.shapes, &possible);
        match shape {
            Shape::Affine => lo_ransac(&problem, &ransac),
            Shape::Similarity => lo_ransac(&problem.similar(), &ransac),
        }
    }
}

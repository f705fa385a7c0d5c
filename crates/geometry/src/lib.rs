//! Plane geometry for registration: 2x2 closed forms, affine and similarity transforms, least squares, robust fits
//! and the covariance of their results.
//!
//! Transforms are named `b_from_a` and map points of frame a to frame b. Everything here is a pure function; a seed is
//! an argument. This crate knows neither images nor microscopes.

#![warn(clippy::too_many_lines)]
#![cfg_attr(
    not(test),
    warn(
        clippy::disallowed_methods,
        clippy::disallowed_types,
        clippy::disallowed_macros
    )
)]

mod affine;
mod dense;
mod fit;
mod jackknife;
mod mat2;
mod ransac;
mod rng;
mod solve;

pub use affine::{Affine2, Similarity};
pub use dense::Cholesky;
pub use fit::{
    AffineFit, Correspondence, SharedErrors, affine_from_3, affine_robust, fit_affine,
    fit_affine_robust, fit_similarity, fit_similarity_robust, similarity_from_oriented,
    similarity_robust,
};
pub use jackknife::{Normal, changes_without, covariance as covariance_of_deviations};
pub use mat2::{Mat2, Svd2};
pub use ransac::{AffineProblem, OrientedProblem, Problem, RansacOptions, RobustFit, lo_ransac};
pub use rng::SplitMix64;
pub use solve::{cholesky_inverse, least_squares};

/// A point or vector of the plane.
pub type Vec2 = [f64; 2];

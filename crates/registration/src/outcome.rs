//! What comes of a registration.

use crate::corners::{centre, corners};
use scopeservo_geometry::{Affine2, AffineFit};
use serde::{Deserialize, Serialize};
use thiserror::Error;

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
    /// The features are of two engines, or are damaged.
    #[error("{reason}")]
    NotComparable {
        /// What is wrong with them.
        reason: String,
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
    #[error("{inliers} inliers among {matches} matches could be chance")]
    ByChance {
        /// Agreeing unique places.
        inliers: usize,
        /// Unique matches.
        matches: usize,
        /// log10 of the expected number of such agreements between unrelated images; `None` when they prove nothing.
        log10_nfa: Option<f64>,
    },
    /// The features agree, and the pixels do not.
    #[error(
        "the features agree, but of {asked} places with structure only {agree} look as they should: it is another place that looks alike, or most of the view is covered"
    )]
    PixelsDisagree {
        /// Blocks of pixels that have structure.
        asked: usize,
        /// Those that lie where they should.
        agree: usize,
    },
    /// It is there, as a mirror image only.
    #[error(
        "it is there as a mirror image only, with {inliers} places that agree: the slide lies upside down, or the camera's image is mirrored otherwise than when the view was saved"
    )]
    Mirrored {
        /// Agreeing unique places of the mirror image.
        inliers: usize,
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
    /// Of a fit, in a view of this size.
    pub fn of(fit: &AffineFit, view_size: [usize; 2]) -> Self {
        Self {
            target_from_view: fit.b_from_a,
            covariance: fit.covariance,
            sigma_px: fit.sigma_at(centre(view_size)),
            corner_sigma_px: corner_sigma_px(fit, view_size),
            sigma_angle_rad: sigma_angle_rad(fit),
        }
    }

    /// That of an image to itself, known for sure.
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
    /// Inliers for drawing: x, y in the view, x, y in the target.
    pub pairs: Vec<[f32; 4]>,
    /// The same as indices: feature of the view, feature of the target.
    pub agreeing: Vec<[usize; 2]>,
}

impl Registration {
    /// The transform, when found.
    pub fn found(&self) -> Option<&Estimate> {
        self.outcome.as_ref().ok()
    }

    /// That nothing was found.
    pub fn not_found(reason: NotFound, matches: usize) -> Self {
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

/// The standard deviation of the worst corner of the view, target pixels.
pub(crate) fn corner_sigma_px(fit: &AffineFit, view_size: [usize; 2]) -> f64 {
    corners(view_size)
        .into_iter()
        .map(|p| fit.sigma_at(p))
        .fold(0.0, f64::max)
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

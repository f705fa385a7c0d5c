//! Where a target lies in a frame. A localizer is one file here, or anything that implements [`Localizer`].

mod chosen;
mod correlation;
mod features;

use crate::{FixedPlaces, LocatedBy, ServoError, Target};
use scopeservo_features::{Features, GrayImage};
use scopeservo_registration::correlation::Perhaps;
use scopeservo_registration::{Correspondences, Estimate, NotFound, Prior, Registration, Rival};
use std::borrow::Cow;
use std::fmt::Debug;

pub(crate) use chosen::with_localizer;
pub use correlation::CorrelationLocalizer;
pub use features::FeatureLocalizer;

/// What is known of a frame before looking.
#[derive(Debug, Clone, Copy)]
pub struct Expected<'a> {
    /// Scale and angle of the transform, as far as they are known.
    pub prior: Prior,
    /// What does not belong to the specimen, in the pixels of the camera.
    pub fixed: &'a FixedPlaces,
}

/// A target that was located in a view.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// `target_from_view` with its covariance.
    pub estimate: Estimate,
    /// By what it was located.
    pub by: LocatedBy,
    /// How it was found.
    pub registration: Registration,
    /// The places of view and target that look alike: what is proved by motion stands on these alone.
    pub correspondences: Correspondences,
    /// All features of the view, where the localizer works with features.
    pub features: Option<Features>,
    /// Other transforms that the localizer saw on its way to say as much.
    pub rivals: Vec<Rival>,
}

/// Whether descriptors say nothing, and another way may.
pub(crate) fn says_nothing(reason: &NotFound) -> bool {
    matches!(
        reason,
        NotFound::TooFewFeatures { .. }
            | NotFound::TooFewMatches { .. }
            | NotFound::NoAgreement { .. }
            | NotFound::ByChance { .. }
    )
}

/// Finds a target in views.
pub trait Localizer: Debug + Send + Sync {
    /// Adds to a target what it lacks to be looked for: a target may come from another program or microscope.
    ///
    /// # Errors
    /// [`ServoError::PoorTarget`], or why its image cannot be used.
    fn prepare<'a>(&self, target: &'a Target) -> Result<Cow<'a, Target>, ServoError>;

    /// Looks for a target, prepared before, in a view. The inner result is a measurement or the reason why there is none.
    ///
    /// # Errors
    /// [`ServoError::Features`] for a view that cannot be used.
    fn locate(
        &self,
        target: &Target,
        view: &GrayImage,
        expected: &Expected<'_>,
    ) -> Result<Result<Measurement, NotFound>, ServoError>;

    /// Where the target may lie in a view in which it was not found, the most likely first: for a look with a higher objective. Nowhere, of a
    /// localizer that cannot tell.
    fn perhaps(
        &self,
        _target: &Target,
        _view: &GrayImage,
        _expected: &Expected<'_>,
    ) -> Vec<Perhaps> {
        Vec::new()
    }

    /// Other transforms that explain a view nearly as well. `without_identity`: what stays where it is on the sensor is none.
    fn rivals(
        &self,
        target: &Target,
        measured: &Measurement,
        expected: &Expected<'_>,
        without_identity: bool,
    ) -> Vec<Rival>;
}

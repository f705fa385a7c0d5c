//! The nosepiece: which objectives there are and which one looks at the specimen.

use crate::{Immersion, Motion, ObjectiveId, ScopeError};
use serde::{Deserialize, Serialize};

/// What is engraved on an objective, and what the maker's data sheet says of the image it gives here.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Objective {
    /// Its name.
    pub id: ObjectiveId,
    /// Total magnification at the eyepiece, for people and for ordering.
    pub magnification: f64,
    /// Numerical aperture.
    pub numerical_aperture: f64,
    /// Nominal size of one camera pixel on the specimen, um. Plans the first calibration moves; measured afterwards.
    pub nominal_um_per_px: f64,
    /// What it works in.
    #[serde(default, skip_serializing_if = "Immersion::is_air")]
    pub immersion: Immersion,
}

impl Objective {
    /// Whether its numbers can be those of an objective.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`].
    pub fn check(&self) -> Result<(), ScopeError> {
        let sizes = [
            self.magnification,
            self.numerical_aperture,
            self.nominal_um_per_px,
        ];
        match sizes.iter().all(|v| v.is_finite() && *v > 0.0) {
            true => Ok(()),
            false => Err(ScopeError::BadSetting {
                what: format!(
                    "magnification, numerical_aperture and um_per_px of {} must be above 0",
                    self.id
                ),
            }),
        }
    }
}

/// How a nosepiece knows which objective is active.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KnownBy {
    /// A sensor tells.
    #[default]
    Sensor,
    /// It counts from where it stood when somebody said which one was in.
    Count,
    /// Somebody who was asked to turn it says so.
    Report,
}

/// A motorised (or hand-turned) nosepiece. A change is started and polled.
pub trait Nosepiece: Send + Sync {
    /// The objectives it carries.
    fn objectives(&self) -> &[Objective];
    /// The active objective; `None` while turning or unknown.
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError>;
    /// Starts to change and returns at once.
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError>;
    /// What the nosepiece is doing.
    fn poll(&self) -> Result<Motion, ScopeError>;
    /// Stops at once where the hardware can.
    fn stop(&self) -> Result<(), ScopeError>;
    /// How it knows what [`Nosepiece::current`] tells. What is not sensed has to be shown by an image before anything leans on it; the
    /// instrument keeps what images have shown.
    fn known_by(&self) -> KnownBy {
        KnownBy::Sensor
    }
}

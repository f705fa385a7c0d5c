//! Settings of a calibration, and what both methods refuse.

use super::joint::PathOptions;
use crate::{Calibration, ServoError};
use scopeservo_registration::NotFound;
use scopeservo_scope::Objective;
use serde::{Deserialize, Serialize};

/// How to calibrate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CalibrationMethod {
    /// A chain of views and everything solved at once.
    #[default]
    Joint,
    /// The paper's translations and rotations about one reference view.
    TwoStep,
}

/// Settings of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CalibrateOptions {
    /// How.
    pub method: CalibrationMethod,
    /// Where the joint calibration looks.
    pub path: PathOptions,
    /// Features that are kept of a view of the joint calibration, at most.
    pub kept_features: usize,
    /// Two-step: radius of the eight translations, as a share of the shorter side of the field.
    pub translation_share: f64,
    /// Two-step: sweep of the view in a rotation, as a share of the shorter side of the field.
    pub rotation_share: f64,
    /// Two-step: largest rotation, radians.
    pub max_rotation_rad: f64,
    /// Measured over nominal um per pixel may be this, or one over this, at most.
    pub nominal_factor: f64,
    /// What is seen may be this many times what the stage's repeatability explains, at most.
    pub residual_factor: f64,
    /// One direction's scale over the other's, at most.
    pub anisotropy: f64,
}

impl Default for CalibrateOptions {
    fn default() -> Self {
        Self {
            method: CalibrationMethod::default(),
            path: PathOptions::default(),
            kept_features: 500,
            translation_share: 0.35,
            rotation_share: 0.4,
            max_rotation_rad: 0.08,
            nominal_factor: 1.25,
            residual_factor: 4.0,
            anisotropy: 1.2,
        }
    }
}

impl CalibrateOptions {
    /// Refuses a scale that is far from what is engraved; a pixel much longer one way than the other; and what is seen farther from what the
    /// stage reports than `explained_px`, the part of its repeatability, allows.
    pub(super) fn judge(
        &self,
        calibration: &Calibration,
        objective: &Objective,
        (residual_px, explained_px): (f64, f64),
    ) -> Result<(), ServoError> {
        let (measured, nominal) = (calibration.um_per_px(), objective.nominal_um_per_px);
        let factor = (measured / nominal).max(nominal / measured);
        if factor.is_nan() || factor > self.nominal_factor {
            return Err(ServoError::CalibrationImplausible {
                objective: objective.id.clone(),
                measured_um_per_px: measured,
                nominal_um_per_px: nominal,
            });
        }
        let [large, small] = calibration.stage_from_pixel.svd().s;
        if large > self.anisotropy * small {
            return Err(ServoError::AxesDiffer {
                objective: objective.id.clone(),
                factor: large / small,
            });
        }
        // One pixel is for what the data sheet does not name: vibration, drift, the slide's seat.
        let allowed_px = 1.0 + self.residual_factor * explained_px;
        if residual_px > allowed_px {
            return Err(ServoError::CalibrationInconsistent {
                objective: objective.id.clone(),
                residual_px,
                allowed_px,
            });
        }
        Ok(())
    }
}

/// That too few views were found, the last of them because of `last`.
pub(super) fn too_few(
    objective: &Objective,
    measured: usize,
    needed: usize,
    last: Option<&NotFound>,
) -> ServoError {
    let nothing = NotFound::TooFewFeatures {
        view: 0,
        target: 0,
        needed,
    };
    ServoError::CalibrationViews {
        objective: objective.id.clone(),
        measured,
        needed,
        last: last.cloned().unwrap_or(nothing),
    }
}

//! What jobs make that is worth keeping.

use scopeservo_scope::FlatField;
use scopeservo_servo::{Calibration, CalibrationSet, SwitchingReport};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A calibration that a job made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MadeCalibration {
    /// The calibration.
    pub calibration: Calibration,
    /// Root mean square residual of its views, pixels.
    pub residual_px: Option<f64>,
    /// Where the objective was in focus, um.
    pub focus_z_um: Option<f64>,
}

/// What a job made that is worth keeping, however it ends.
#[derive(Debug, Clone, PartialEq)]
pub enum Kept {
    /// A calibration.
    Calibration(Box<MadeCalibration>),
    /// Calibrations that are one instrument, each of which is kept by itself as well.
    Set(Box<CalibrationSet>),
    /// What repeated switching between two objectives has shown.
    Switching(Box<SwitchingReport>),
    /// What lies on the camera, as it was seen last.
    Shadows(Arc<FlatField>),
}

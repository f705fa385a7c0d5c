//! What the calibration of one objective saw, to be compared with that of others.

use super::joint::Single;
use crate::Calibration;
use scopeservo_features::Features;
use serde::{Deserialize, Serialize};

/// What a calibration saw, for [`one_microscope`](super::one_microscope).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alone {
    pub(super) calibration: Calibration,
    pub(super) single: Single,
    /// Of its first view.
    pub(super) features: Features,
}

//! What a page is told of calibrations that were made before.

use scopeservo_servo::Calibration;
use serde::{Deserialize, Serialize};

/// A calibration that was made before the run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stored {
    /// The calibration.
    pub calibration: Calibration,
    /// Where it is kept.
    pub file: String,
    /// When it was made, as people read it; empty where that is not known.
    pub made: String,
}

impl Stored {
    /// " of WHEN", or nothing where that is not known.
    pub(crate) fn of_when(&self) -> String {
        match self.made.is_empty() {
            true => String::new(),
            false => format!(" of {}", self.made),
        }
    }
}

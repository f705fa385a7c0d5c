//! How things stood when somebody looked.

use scopeservo_scope::{ObjectiveId, StagePose};
use std::time::Instant;

/// What was seen of the instrument, and when.
#[derive(Debug, Clone)]
pub(crate) struct Standing {
    /// Counts the looks.
    pub(crate) number: u64,
    /// When the stage said where it is.
    pub(crate) at_time: Instant,
    pub(crate) at: Option<StagePose>,
    pub(crate) homed: bool,
    pub(crate) moving: bool,
    pub(crate) objective: Option<ObjectiveId>,
    pub(crate) exposure_ms: Option<f64>,
    pub(crate) light: Option<f64>,
    /// What the instrument does not answer.
    pub(crate) trouble: Option<String>,
    /// Seconds on the instrument's clock.
    pub(crate) time_s: f64,
}

impl Standing {
    /// Before anybody looked.
    pub(crate) fn unknown() -> Self {
        Self {
            number: 0,
            at_time: Instant::now(),
            at: None,
            homed: false,
            moving: false,
            objective: None,
            exposure_ms: None,
            light: None,
            trouble: None,
            time_s: 0.0,
        }
    }
}

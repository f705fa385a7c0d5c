//! Which objective an image shows to be active.

use scopeservo_scope::ObjectiveId;
use serde::{Deserialize, Serialize};

/// What the image tells.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// Measured um per pixel.
    pub um_per_px: f64,
    /// The objective that this fits; `None` when it fits none.
    pub looks_like: Option<ObjectiveId>,
    /// Whether it is the one that is said to be there, as far as the scale tells.
    pub as_told: bool,
}

//! By what a target was located in a view: features first, then what else there is.

use serde::{Deserialize, Serialize};

/// By what a target was located.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LocatedBy {
    /// What features look like.
    #[default]
    Features,
    /// How a few of them lie to each other.
    Arrangement,
    /// Correlation of blocks of pixels.
    Correlation,
}

//! Which objective is meant.

use serde::{Deserialize, Serialize};
use std::fmt;

/// The name of an objective. Calibrations belong to it; its magnification is only a label.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ObjectiveId(pub String);

impl fmt::Display for ObjectiveId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

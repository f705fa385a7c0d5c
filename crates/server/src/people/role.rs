//! Roles.

use serde::{Deserialize, Serialize};

/// What somebody may do; each may do what those before it may.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Role {
    /// Look, and stop.
    Viewer,
    /// Move, save, and go.
    Operator,
    /// Say who may.
    Admin,
}

//! Places where the target may lie.

use crate::PlanarPose;
use scopeservo_scope::ObjectiveId;
use serde::{Deserialize, Serialize};

/// What is less like the target is not looked at; 1 for what is the same.
pub(crate) const LEAST_HEIGHT: f32 = 0.25;

/// Somewhere the target may lie.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct MayLie {
    /// Where the stage goes for the higher objective to see it.
    pub(crate) stage: PlanarPose,
    /// How like the target it is: 1 for what is the same.
    pub(crate) height: f32,
}

/// All of these, and what looks at them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct MayLieAt {
    pub(crate) to: ObjectiveId,
    /// The most likely first; at least one.
    pub(crate) places: Vec<MayLie>,
    /// Places that cannot be looked at: out of reach, or too far for one step to lead there for sure.
    #[serde(default)]
    pub(crate) beyond: Vec<MayLie>,
}

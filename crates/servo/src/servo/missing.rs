//! What a stage lacks to bring a view back.

use scopeservo_scope::Axis;
use serde::{Deserialize, Serialize};

/// How far a place lies past the end of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Beyond {
    /// The axis.
    pub axis: Axis,
    /// How far, m or rad: above the upper end, or below the lower one where it is negative.
    pub by: f64,
    /// The lower end of where the axis may go.
    pub min: f64,
    /// The upper end.
    pub max: f64,
}

/// What a stage lacks to bring a view back, and what of the specimen's place would help.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Missing {
    /// The axes that do not go far enough; none where another rule of the motion gate is in the way.
    pub beyond: Vec<Beyond>,
    /// How far the specimen is turned from where it was, degrees.
    pub turned_deg: f64,
    /// Turned back by so much, degrees, the specimen would be within reach where it lies; `None` where it must be shifted as well, or instead.
    pub turn_back_deg: Option<f64>,
    /// Whether the stage carries the specimen, and not the microscope.
    pub carries_specimen: bool,
    /// The rule that is in the way, in words, where it is no axis.
    pub rule: Option<String>,
}

impl Missing {
    /// What is missing of an axis.
    pub fn of(&self, axis: Axis) -> Option<&Beyond> {
        self.beyond.iter().find(|b| b.axis == axis)
    }
}

//! What a place breaks.

use crate::Axis;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Which rule a place breaks. In the units that people read: um or deg.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Breach {
    /// An axis is outside its limits.
    Limits {
        /// Which axis.
        axis: Axis,
        /// Where it is.
        at: f64,
        /// The lower limit.
        min: f64,
        /// The upper limit.
        max: f64,
    },
    /// The axes use more of the travel that they share than there is.
    Workspace {
        /// Which share; above 1.
        share: f64,
    },
    /// The objective is too close to something.
    Zone {
        /// What is there.
        zone: String,
        /// The height, um.
        z_um: f64,
        /// The nearest allowed, um.
        closest_um: f64,
    },
}

impl fmt::Display for Breach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Limits { axis, at, min, max } => write!(
                f,
                "{axis} is at {at:.1} {unit}, outside {min:.1} to {max:.1} {unit}",
                unit = axis.display_unit()
            ),
            Self::Workspace { share } => write!(
                f,
                "the axes share their travel, and use {:.0} % of it",
                share * 100.0
            ),
            Self::Zone {
                zone,
                z_um,
                closest_um,
            } => write!(
                f,
                "over {zone} z is at {z_um:.1} um, and {closest_um:.1} um is the closest allowed"
            ),
        }
    }
}

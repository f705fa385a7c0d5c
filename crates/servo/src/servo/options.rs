//! Settings of the loop.

use crate::{ControlLaw, Proportional};
use serde::{Deserialize, Serialize};

/// The control laws that options can name.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Law {
    /// [`Proportional`], with the gain `lambda`.
    #[default]
    Proportional,
}

/// Settings of the loop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ServoOptions {
    /// The control law.
    #[serde(skip_serializing_if = "is_default")]
    pub law: Law,
    /// Gain: the share of the error that one iteration takes away. The paper's is 0.2.
    pub lambda: f64,
    /// Iterations at one magnification, at most.
    pub max_iterations: usize,
    /// Convergence: the distance must be at most this many pixels of the present view...
    pub position_px: f64,
    /// ...and the angle at most this, times the ratio of view pixel to target pixel size.
    pub angle_deg: f64,
    /// Frames in a row that must pass.
    pub confirmations: usize,
    /// Seconds between them at the target's own magnification, at least: a specimen that drifts shows it.
    pub confirmation_s: f64,
    /// Frames in a row that may be lost before giving up.
    pub max_lost: usize,
    /// Standard deviations by which the error must lie inside both limits at the target's own magnification, where passing
    /// means arrival.
    pub sure_sigmas: f64,
    /// Divergence: give up when the distance grows to this many times its first value and over ten view pixels, or the
    /// angle to this many times its first value and over half a degree.
    pub divergence_factor: f64,
}

fn is_default(law: &Law) -> bool {
    *law == Law::default()
}

impl Default for ServoOptions {
    fn default() -> Self {
        Self {
            law: Law::default(),
            lambda: 0.2,
            max_iterations: 64,
            position_px: 0.8,
            angle_deg: 0.01,
            confirmations: 2,
            confirmation_s: 0.5,
            max_lost: 3,
            sure_sigmas: 2.0,
            divergence_factor: 3.0,
        }
    }
}

impl ServoOptions {
    /// The control law that is named.
    pub fn control_law(&self) -> impl ControlLaw + use<> {
        match self.law {
            Law::Proportional => Proportional {
                lambda: self.lambda,
            },
        }
    }
}

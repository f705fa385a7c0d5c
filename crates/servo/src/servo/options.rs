//! Settings of the loop.

use crate::{Calibration, ControlLaw, Direct, PoseEstimate, Proportional, Velocity};
use serde::{Deserialize, Serialize};

/// The control laws that options can name.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Law {
    /// [`Direct`]: the whole way, one measurement at each magnification on the way.
    #[default]
    Direct,
    /// [`Proportional`], the paper's, with the gain `lambda`, at every magnification until it converges.
    Proportional,
}

/// Settings of the loop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ServoOptions {
    /// The control law. Settings that were stored when there was one only have that.
    #[serde(default = "the_papers")]
    pub law: Law,
    /// Gain of the paper's law: the share of the error that one iteration takes away. The paper's is 0.2.
    pub lambda: f64,
    /// Iterations at one magnification, at most.
    pub max_iterations: usize,
    /// Convergence: the distance must be at most this many pixels of the present view...
    pub position_px: f64,
    /// ...and the angle at most this, times the ratio of view pixel to target pixel size.
    pub angle_deg: f64,
    /// What a user asks of an arrival, um: it is claimed only within this for sure. Less than the method asks for counts where nothing nearer
    /// came in some moves.
    pub within_um: Option<f64>,
    /// The same of the angle, degrees. What a stage cannot turn may be left up to this; `None` there while the middle of the target is in view.
    pub within_deg: Option<f64>,
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

fn the_papers() -> Law {
    Law::Proportional
}

impl Default for ServoOptions {
    fn default() -> Self {
        Self {
            law: Law::default(),
            lambda: 0.2,
            max_iterations: 64,
            position_px: 0.8,
            angle_deg: 0.01,
            within_um: None,
            within_deg: None,
            confirmations: 2,
            confirmation_s: 0.5,
            max_lost: 3,
            sure_sigmas: 2.0,
            divergence_factor: 3.0,
        }
    }
}

impl ControlLaw for ServoOptions {
    fn velocity(&self, error: &PoseEstimate, view: &Calibration) -> Velocity {
        match self.law {
            Law::Direct => Direct.velocity(error, view),
            Law::Proportional => {
                let lambda = self.lambda;
                Proportional { lambda }.velocity(error, view)
            }
        }
    }
}

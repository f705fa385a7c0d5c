//! How a servo loop ends, and what is known then.

use super::missing::Missing;
use crate::{Contradiction, PoseError};
use scopeservo_registration::{NotFound, Rival};
use scopeservo_scope::ObjectiveId;
use serde::{Deserialize, Serialize};

/// How a loop ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ServoEnd {
    /// The view is there.
    Converged(ServoResult),
    /// Below the target's own magnification: the last move surely brought the target into the view of a higher one.
    HandedOver {
        /// To which objective.
        to: ObjectiveId,
        /// Within this of its goal, um: three standard deviations.
        lands_within_um: f64,
        /// The last error, before that move.
        last: ServoResult,
    },
    /// What was seen after the last moves contradicts what they were to do.
    Contradicted {
        /// Why, as far as it shows.
        why: Contradiction,
        /// The last error.
        last: ServoResult,
    },
    /// The stage cannot go where the view would be back; nothing was moved for it.
    CannotReach {
        /// What it lacks.
        missing: Missing,
        /// The last error.
        last: ServoResult,
    },
    /// As near as the stage or the images allow, time and again, and not as near as was asked for.
    OutsideTolerance {
        /// The last error.
        last: ServoResult,
        /// What was asked for.
        asked_um: Option<f64>,
        /// What was asked for.
        asked_deg: Option<f64>,
        /// How near this stage comes back to a place, two standard deviations.
        stage_um: f64,
        /// The same of the angle.
        stage_deg: f64,
    },
    /// The target is not in the view.
    Lost(NotFound),
    /// The iterations ran out.
    IterationLimit(ServoResult),
    /// The error grows: a sign or a calibration is wrong.
    Diverged(ServoResult),
    /// Another place explains the view as well.
    Ambiguous {
        /// The other one.
        rival: Rival,
        /// Size of a pixel of the target, um.
        um_per_px: f64,
    },
    /// The stage moved, and nothing in the image did.
    NothingMoves {
        /// How far the stage moved, um.
        moved_um: f64,
    },
    /// What agrees was not seen to move with the specimen.
    Unproven(ServoResult),
    /// The view does not rest.
    Drifting {
        /// How fast, um/s.
        um_per_s: f64,
        /// The last error.
        last: ServoResult,
    },
}

impl ServoEnd {
    /// The last error, where something is known of the specimen's.
    pub fn result(&self) -> Option<&ServoResult> {
        match self {
            Self::Converged(r)
            | Self::IterationLimit(r)
            | Self::Diverged(r)
            | Self::Drifting { last: r, .. } => Some(r),
            Self::HandedOver { last, .. }
            | Self::Contradicted { last, .. }
            | Self::CannotReach { last, .. }
            | Self::OutsideTolerance { last, .. } => Some(last),
            // What is not known to be the specimen says nothing of its distance.
            Self::Lost(_)
            | Self::Ambiguous { .. }
            | Self::NothingMoves { .. }
            | Self::Unproven(_) => None,
        }
    }

    /// The end in a word, for programs.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Converged(_) => "converged",
            Self::HandedOver { .. } => "handed_over",
            Self::Contradicted { .. } => "contradicted",
            Self::CannotReach { .. } => "cannot_reach",
            Self::OutsideTolerance { .. } => "outside_tolerance",
            Self::Lost(_) => "lost",
            Self::IterationLimit(_) => "iteration_limit",
            Self::Diverged(_) => "diverged",
            Self::Ambiguous { .. } => "ambiguous",
            Self::NothingMoves { .. } => "nothing_moves",
            Self::Unproven(_) => "unproven",
            Self::Drifting { .. } => "drifting",
        }
    }
}

/// What an arrival is limited by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LimitedBy {
    /// How well the stage comes back to a place.
    Repeatability,
    /// How well the images tell.
    Measurement,
}

/// The last error and how well it is known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ServoResult {
    /// Iterations done.
    pub iterations: usize,
    /// Inliers in the last frame.
    pub inliers: usize,
    /// The last error; the mean over the confirming frames after convergence.
    pub error: PoseError,
    /// Standard deviation of the error's distance, um: of the registration, and after convergence of the confirming frames
    /// among themselves (vibration, drift).
    pub sigma_um: f64,
    /// Standard deviation of the error's angle, degrees, of the registration.
    #[serde(default)]
    pub sigma_deg: f64,
    /// After convergence outside the tolerance: what kept the view from coming nearer.
    #[serde(default)]
    pub limited_by: Option<LimitedBy>,
    /// The stage did not turn: the angle is what is left.
    #[serde(default)]
    pub angle_is_left: bool,
}

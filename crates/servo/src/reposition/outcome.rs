//! The answer of a run.

use crate::{Calibration, ErrorCode, LimitedBy, Missing, Remark, ServoEnd, ServoError};
use scopeservo_scope::ObjectiveId;
use serde::{Deserialize, Serialize};

/// The answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The saved view is back, checked on its own frames.
    Arrived,
    /// The saved view was not seen.
    NotFound,
    /// Something needed could not be done; nothing is claimed.
    Refused,
    /// The saved view was seen, and so was another place that looks like it; nothing is claimed.
    Ambiguous,
}

/// Why a run ended, for programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// The view is back.
    Converged,
    /// The target has too little texture to come back to.
    BlankTarget,
    /// No focus: nothing to see at the start.
    NoFocus,
    /// It gets sharper towards where the stage may not go.
    AtLimit,
    /// The camera shows images that were taken before.
    StaleImages,
    /// Another objective is active than the one that was asked for, or it could not be seen which.
    WrongObjective,
    /// Calibration had too little to see or was implausible.
    CalibrationFailed,
    /// The target is not in the view.
    TargetNotInView,
    /// The iterations ran out.
    IterationLimit,
    /// The error grew.
    Diverged,
    /// The way leads outside the limits, or past another rule of the motion gate.
    OutsideLimits,
    /// The place is back, but the stage has no axis for the angle that is left, and that is more than may be left.
    CannotTurn,
    /// The stage does not go, or turn, as far as it takes.
    CannotReach,
    /// Not as near as was asked for, and as near as it gets.
    OutsideTolerance,
    /// Another place looks the same.
    Ambiguous,
    /// The stage moved, and nothing in the image did: stuck, or all of it is on the camera.
    NothingMoves,
    /// What agrees with the target was not seen to move with the specimen.
    Unproven,
    /// The view does not rest.
    Drifting,
    /// What was seen contradicts what the stage was told to do.
    Contradicted,
}

/// What happened at one magnification.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MagnificationResult {
    /// The objective.
    pub objective: ObjectiveId,
    /// Its magnification.
    pub magnification: f64,
    /// How the loop ended there.
    pub end: ServoEnd,
    /// The calibration used.
    pub calibration: Calibration,
}

/// The answer of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// The answer.
    pub verdict: Verdict,
    /// Why, for programs.
    pub reason: Reason,
    /// Why, for people.
    pub message: String,
    /// Last measured distance with its uncertainty added in quadrature, um.
    pub estimated_error_um: Option<f64>,
    /// Last measured angle, degrees.
    pub estimated_error_deg: Option<f64>,
    /// What kept the view from coming nearer than it did, where that is not within the tolerance.
    #[serde(default)]
    pub limited_by: Option<LimitedBy>,
    /// The angle that a stage leaves which cannot turn so far, degrees; `None` where it turned, or the place is not back.
    #[serde(default)]
    pub angle_left_deg: Option<f64>,
    /// Share of the target's area that is in the view then.
    #[serde(default)]
    pub in_view: Option<f64>,
    /// What the stage lacks to get there.
    #[serde(default)]
    pub missing: Option<Missing>,
    /// What was seen of the instrument, and went on: a calibration that has drifted, a move that did something else.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<Remark>,
    /// Width and height of the widest view in which the target was seen, um on the specimen: what looks the same farther away could not be.
    #[serde(default)]
    pub unique_within_um: Option<[f64; 2]>,
    /// Every magnification that was servoed, in order.
    pub magnifications: Vec<MagnificationResult>,
}

impl Reason {
    /// The reason why a run that ends with this error is refused; `None` for a fault or an interruption.
    pub fn of(error: &ServoError) -> Option<Self> {
        Some(match error.code() {
            ErrorCode::NoFocus => Self::NoFocus,
            ErrorCode::AtLimit => Self::AtLimit,
            ErrorCode::StaleImages => Self::StaleImages,
            ErrorCode::PoorTarget => Self::BlankTarget,
            ErrorCode::NothingMoves => Self::NothingMoves,
            ErrorCode::Ambiguous => Self::Ambiguous,
            ErrorCode::WrongObjective => Self::WrongObjective,
            // No run looks at a grid, checks a calibration or levels; what it would be is one that failed.
            ErrorCode::CalibrationFailed
            | ErrorCode::GridFailed
            | ErrorCode::CheckFailed
            | ErrorCode::LevelFailed => Self::CalibrationFailed,
            ErrorCode::OutsideLimits => Self::OutsideLimits,
            ErrorCode::Immersion
            | ErrorCode::Refused
            | ErrorCode::Interrupted
            | ErrorCode::Fault
            | ErrorCode::Internal => return None,
        })
    }
}

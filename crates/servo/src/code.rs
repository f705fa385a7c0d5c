//! What an error is, for programs: judged here, once, for answers, exit codes and whoever else has to decide what comes next.

use crate::ServoError;
use scopeservo_scope::{ErrorKind as ScopeErrorKind, Remedy as ScopeRemedy, ScopeError};
use serde::{Deserialize, Serialize};

/// What kind of trouble an error is, for deciding what to do next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorKind {
    /// What the method was asked for was looked for and not found, or seen and refused.
    Answer,
    /// The request was not allowed; the instrument is as before.
    Refusal,
    /// Somebody stopped the work.
    Interruption,
    /// The instrument failed, or the program.
    Fault,
}

/// What an error is. Stable: added to, never renamed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorCode {
    /// No focus.
    NoFocus,
    /// The focus lies beyond where the stage may go.
    AtLimit,
    /// The camera shows images that were taken before.
    StaleImages,
    /// A calibration had too little to see, or was implausible.
    CalibrationFailed,
    /// Another objective is active than the one that is said to be, or it could not be seen which.
    WrongObjective,
    /// The view has too little to come back to.
    PoorTarget,
    /// The stage moved, and nothing in the frame did.
    NothingMoves,
    /// Another place looks the same.
    Ambiguous,
    /// No grid of that pitch was seen, or the stage could not be followed on it.
    GridFailed,
    /// Whether a calibration still holds could not be seen.
    CheckFailed,
    /// The tilt could not be seen, or the stage did not level it.
    LevelFailed,
    /// The objective works in another medium than is on the specimen, and nobody agreed to that.
    Immersion,
    /// The way leads past a rule of the motion gate.
    OutsideLimits,
    /// The instrument does not do it for another reason.
    Refused,
    /// Somebody stopped the work.
    Interrupted,
    /// The instrument failed.
    Fault,
    /// The program failed.
    Internal,
}

/// What can be done about an error; each front end has its own words for it.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Remedy {
    /// That of the instrument.
    Scope(ScopeRemedy),
    /// Describe one objective alone: then nobody needs to see which one is active.
    DescribeOneObjective,
    /// Correct the nominal scales of the objectives.
    CorrectScales,
}

impl ErrorCode {
    /// The kind of trouble.
    pub fn kind(self) -> ErrorKind {
        match self {
            Self::NoFocus
            | Self::AtLimit
            | Self::StaleImages
            | Self::CalibrationFailed
            | Self::WrongObjective
            | Self::PoorTarget
            | Self::NothingMoves
            | Self::Ambiguous
            | Self::GridFailed
            | Self::CheckFailed
            | Self::LevelFailed => ErrorKind::Answer,
            Self::Immersion | Self::OutsideLimits | Self::Refused => ErrorKind::Refusal,
            Self::Interrupted => ErrorKind::Interruption,
            Self::Fault | Self::Internal => ErrorKind::Fault,
        }
    }
}

impl ServoError {
    /// What it is.
    pub fn code(&self) -> ErrorCode {
        match self {
            Self::Scope(error) => scope_code(error),
            Self::NoFocus { .. } => ErrorCode::NoFocus,
            Self::FocusAtLimit { .. } => ErrorCode::AtLimit,
            Self::CalibrationViews { .. }
            | Self::CalibrationImplausible { .. }
            | Self::CalibrationInconsistent { .. }
            | Self::CalibrationContradicted { .. }
            | Self::BlankView { .. }
            | Self::WentDark { .. }
            | Self::AxisStands { .. }
            | Self::AxesAlike { .. }
            | Self::AxesContradict { .. }
            | Self::AxesDiffer { .. }
            | Self::ViewAstray { .. }
            | Self::ViewShakes { .. }
            | Self::ObjectivesDisagree { .. }
            | Self::SwitchingUnclear { .. }
            | Self::CentreUnknown { .. } => ErrorCode::CalibrationFailed,
            Self::ObjectiveUnclear { .. }
            | Self::PictureStays { .. }
            | Self::StageTooCoarse { .. }
            | Self::WrongObjective { .. } => ErrorCode::WrongObjective,
            Self::PoorTarget { .. } | Self::HopelessTarget(_) | Self::NothingToFollow => {
                ErrorCode::PoorTarget
            }
            Self::NothingMoves { .. } | Self::CheckStands { .. } => ErrorCode::NothingMoves,
            Self::CheckUnclear { .. } | Self::CheckTooCoarse { .. } => ErrorCode::CheckFailed,
            Self::Repeats { .. } => ErrorCode::Ambiguous,
            Self::NoGrid { .. }
            | Self::GridTooFineForStage { .. }
            | Self::GridUnfollowed { .. }
            | Self::GridStage { .. } => ErrorCode::GridFailed,
            Self::Level(_) => ErrorCode::LevelFailed,
            Self::MovesTooFar { .. } => ErrorCode::Refused,
            Self::StaysNear { .. } => ErrorCode::Fault,
            Self::Features(_) | Self::CannotGoOn(_) => ErrorCode::Internal,
        }
    }

    /// What kind of trouble it is.
    pub fn kind(&self) -> ErrorKind {
        self.code().kind()
    }

    /// What can be done about it, beyond what its text says.
    pub fn remedy(&self) -> Option<Remedy> {
        match self {
            Self::Scope(error) => error.remedy().map(Remedy::Scope),
            Self::StageTooCoarse { .. } => Some(Remedy::DescribeOneObjective),
            Self::WrongObjective { .. } => Some(Remedy::CorrectScales),
            _ => None,
        }
    }
}

fn scope_code(error: &ScopeError) -> ErrorCode {
    match error {
        ScopeError::OutsideLimits { .. }
        | ScopeError::StandsOutside { .. }
        | ScopeError::OutsideWorkspace { .. }
        | ScopeError::TooClose { .. }
        | ScopeError::StepTooLarge { .. }
        | ScopeError::NotRetracted { .. } => ErrorCode::OutsideLimits,
        ScopeError::ImmersionNotAgreed { .. } => ErrorCode::Immersion,
        ScopeError::Frozen { .. } => ErrorCode::NothingMoves,
        ScopeError::Stale { .. } => ErrorCode::StaleImages,
        other => match other.kind() {
            ScopeErrorKind::Refused => ErrorCode::Refused,
            ScopeErrorKind::Interrupted => ErrorCode::Interrupted,
            _ => ErrorCode::Fault,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Reason;
    use scopeservo_scope::ObjectiveId;

    #[test]
    fn an_answer_has_a_reason_and_a_fault_or_a_stop_has_none() {
        let objective = || ObjectiveId("40x".into());
        let errors: Vec<ServoError> = vec![
            ScopeError::Interrupted { at: None }.into(),
            ScopeError::NotHomed { device: "stage" }.into(),
            ScopeError::StepTooLarge {
                axis: scopeservo_scope::Axis::X,
                step: 3.0,
                largest: 2.0,
            }
            .into(),
            ServoError::PoorTarget {
                features: 3,
                moved: None,
                needed: 30,
            },
            ServoError::PictureStays {
                objective: objective(),
                moved_um: 5.0,
            },
            ServoError::StageTooCoarse {
                objective: objective(),
                moved_um: 5.0,
                scatter_um: 4.0,
            },
            ServoError::WrongObjective {
                told: objective(),
                looks_like: None,
                um_per_px: 1.0,
            },
            ServoError::CannotGoOn("no target".into()),
        ];
        for error in errors {
            let has_reason = Reason::of(&error).is_some();
            match error.kind() {
                ErrorKind::Answer => assert!(has_reason, "{error}"),
                ErrorKind::Refusal => {
                    assert_eq!(has_reason, error.code() == ErrorCode::OutsideLimits)
                }
                ErrorKind::Interruption | ErrorKind::Fault => assert!(!has_reason, "{error}"),
            }
            // The words for flags and files of a program are the program's.
            let text = error.to_string();
            assert!(
                !text.contains("--") && !text.contains('_') && !text.contains('='),
                "{text}"
            );
        }
    }
}

//! What ends the program early, and with which exit code.

use scopeservo_scope::{ErrorKind, ScopeError};
use scopeservo_servo::ServoError;
use scopeservo_setup::SetupError;
use scopeservo_slide::SlideError;
use std::path::PathBuf;
use thiserror::Error;

#[derive(Debug, Error)]
pub(crate) enum CliError {
    #[error("{0}")]
    Usage(String),
    #[error(transparent)]
    Slide(#[from] SlideError),
    #[error(transparent)]
    Specimen(#[from] scopeservo_twin::specimen::SpecimenError),
    #[error(
        "{path} is only {width}x{height} pixels, too small to hold features; give an image of at least {least} pixels each way"
    )]
    TooSmall {
        path: PathBuf,
        width: usize,
        height: usize,
        least: usize,
    },
    #[error("cannot write to {path}: {source}. Give a folder that can be written with --out")]
    Write {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error(transparent)]
    Setup(#[from] SetupError),
    #[error("{path} cannot be read: {what}")]
    Read { path: PathBuf, what: String },
    #[error(transparent)]
    Servo(#[from] ServoError),
    #[error(transparent)]
    Twin(#[from] scopeservo_twin::TwinError),
    #[error("the features could not be computed: {0}")]
    Features(#[from] scopeservo_sift::SiftError),
    #[error("{0}")]
    Internal(String),
}

impl From<ScopeError> for CliError {
    fn from(error: ScopeError) -> Self {
        Self::Servo(error.into())
    }
}

impl CliError {
    /// 2 where the user can mend it by other input, 3 where the instrument refused, else 1.
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_)
            | Self::Slide(_)
            | Self::Specimen(_)
            | Self::TooSmall { .. }
            | Self::Write { .. }
            | Self::Read { .. } => 2,
            Self::Setup(error) => match error.root() {
                // What the file sets cannot be.
                SetupError::Scope(ScopeError::BadSetting { .. }) => 2,
                SetupError::Scope(error) => scope_code(error),
                _ => 2,
            },
            Self::Servo(ServoError::Scope(error)) => scope_code(error),
            // What was looked for was not found, or what was seen was refused.
            Self::Servo(
                ServoError::NoFocus { .. }
                | ServoError::CalibrationViews { .. }
                | ServoError::CalibrationImplausible { .. }
                | ServoError::CalibrationInconsistent { .. }
                | ServoError::ObjectiveUnclear { .. }
                | ServoError::PictureStays { .. }
                | ServoError::StageTooCoarse { .. }
                | ServoError::WrongObjective { .. },
            ) => 3,
            Self::Servo(_) | Self::Twin(_) | Self::Features(_) | Self::Internal(_) => 1,
        }
    }
}

/// What the instrument refuses is an answer; a fault or a stop is none.
fn scope_code(error: &ScopeError) -> u8 {
    match error.kind() {
        ErrorKind::Refused => 3,
        _ => 1,
    }
}

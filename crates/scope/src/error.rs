//! What can go wrong with an instrument, with what the next layer needs to go on.

use crate::{Axis, ObjectiveId, StagePose};
use thiserror::Error;

/// The error of every device call.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ScopeError {
    /// The place asked for is outside the limits. Nothing moved.
    #[error(
        "the move was refused: {axis} = {asked:.1} {unit} is outside {min:.1} to {max:.1} {unit}; nothing moved. \
         Move the specimen nearer to the middle of the travel, or widen the limits if the instrument allows it",
        unit = axis.display_unit()
    )]
    OutsideLimits {
        /// The axis that would pass its limit.
        axis: Axis,
        /// What was asked for, in the axis' display unit (um or deg).
        asked: f64,
        /// The lower limit, same unit.
        min: f64,
        /// The upper limit, same unit.
        max: f64,
    },
    /// The stage has no such axis. Nothing moved.
    #[error("the stage has no {axis} axis; nothing moved")]
    NoSuchAxis {
        /// The axis asked for.
        axis: Axis,
    },
    /// A number that is not finite was given as a position. Nothing moved.
    #[error("{axis} was asked to go to a value that is not a number; nothing moved")]
    NotFinite {
        /// The axis asked for.
        axis: Axis,
    },
    /// Limits or a setting that make no sense.
    #[error("{what}")]
    BadSetting {
        /// What is wrong and what to do.
        what: String,
    },
    /// A device is busy with an earlier command.
    #[error("the {device} is still busy with an earlier command; wait until it has settled")]
    Busy {
        /// Which device.
        device: &'static str,
    },
    /// No such objective on the nosepiece.
    #[error("there is no objective {asked} on the nosepiece; it carries {available}")]
    NoSuchObjective {
        /// The objective asked for.
        asked: ObjectiveId,
        /// Those there are, separated by commas.
        available: String,
    },
    /// The user, or another thread, stopped the work. The stage stands at `at`.
    #[error("stopped on request; the stage stands still")]
    Interrupted {
        /// Where the stage stopped, if it could be read.
        at: Option<StagePose>,
    },
    /// A move ended before its goal.
    #[error(
        "the move ended before its goal; look for an obstacle or a released brake before moving again"
    )]
    MoveAborted {
        /// Where the stage stopped, if it could be read.
        at: Option<StagePose>,
    },
    /// A device did not answer in time.
    #[error("the {device} did not finish within {seconds} s; it was told to stop")]
    Timeout {
        /// Which device.
        device: &'static str,
        /// How long was waited, on the instrument's clock.
        seconds: f64,
    },
    /// The device reported a fault of its own.
    #[error("the {device} reports: {detail}")]
    Device {
        /// Which device.
        device: &'static str,
        /// The maker's words.
        detail: String,
    },
}

/// What kind of trouble an error is, for deciding what to do next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The request was wrong or not allowed; the instrument is as before.
    Refused,
    /// Somebody stopped the work.
    Interrupted,
    /// The instrument failed.
    Fault,
}

impl ScopeError {
    /// What kind of trouble this is.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::OutsideLimits { .. }
            | Self::NoSuchAxis { .. }
            | Self::NotFinite { .. }
            | Self::BadSetting { .. }
            | Self::Busy { .. }
            | Self::NoSuchObjective { .. } => ErrorKind::Refused,
            Self::Interrupted { .. } => ErrorKind::Interrupted,
            Self::MoveAborted { .. } | Self::Timeout { .. } | Self::Device { .. } => {
                ErrorKind::Fault
            }
        }
    }
}

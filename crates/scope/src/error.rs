//! What can go wrong with an instrument, with what the next layer needs to go on.

use crate::{Axis, Breach, Immersion, ImmersionChange, ObjectiveId, StagePose};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A number that a device told, whatever it is.
fn told(number: f64) -> String {
    match number.abs() < 1e9 {
        true => format!("{number:.1}"),
        false => format!("{number:e}"),
    }
}

/// Where the stage was seen to stand, as the end of a sentence; nothing for one that was not looked at.
fn stands(at: &Option<StagePose>) -> String {
    match at {
        None => String::new(),
        Some(at) if *at == StagePose::default() => "; the stage stands still".into(),
        Some(at) => format!("; the stage stands still at {at}"),
    }
}

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
    /// The axes share their travel, and together ask for more than there is. Nothing moved.
    #[error(
        "the move was refused: the axes share their travel, and that place asks for {:.0} % of it; nothing moved. Bring other axes \
         nearer to the middle of their travel first", share * 100.0
    )]
    OutsideWorkspace {
        /// Share of the common travel that the place asks for; above 1.
        share: f64,
    },
    /// The objective would come too close to something. Nothing moved.
    #[error(
        "the move was refused: over {zone} the objective may be at z = {closest_um:.1} um at the closest, and it would be at \
         {z_um:.1} um; nothing moved. Retract first, or go another way"
    )]
    TooClose {
        /// What is there.
        zone: String,
        /// The height at which it would be, um.
        z_um: f64,
        /// The nearest allowed, um.
        closest_um: f64,
    },
    /// One move would go further than allowed. Nothing moved.
    #[error(
        "the move was refused: {axis} would go {step:.1} {unit} in one step, and {largest:.1} {unit} are allowed; nothing moved. \
         Go in smaller steps, or allow larger ones",
        unit = axis.display_unit()
    )]
    StepTooLarge {
        /// The axis.
        axis: Axis,
        /// Its way, in the axis' display unit (um or deg).
        step: f64,
        /// The longest allowed, same unit.
        largest: f64,
    },
    /// The objective is not retracted, so the nosepiece may not turn. Nothing moved.
    #[error(
        "the objective was not changed: the stage is at z = {at_um:.1} um, and the nosepiece may turn from {needed_um:.1} um on; \
         nothing moved. Retract first"
    )]
    NotRetracted {
        /// Where z is, um.
        at_um: f64,
        /// Where it must be, um.
        needed_um: f64,
    },
    /// The objective that was asked for works in another medium than may be on the specimen, and nobody agreed to that. Nothing moved.
    #[error(
        "the objective was not changed: {} works in {}, and on the specimen there is {}; nothing goes from one to the other unasked, and \
         nothing moved. Make the specimen ready for {}, and agree to this change",
        change.objective, change.to, change.from_words(), change.to
    )]
    ImmersionNotAgreed {
        /// What is to be agreed to.
        change: ImmersionChange,
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
    /// The device refused, and says why. Nothing moved.
    #[error("the {device} refused: {detail}")]
    Refused {
        /// Which device.
        device: &'static str,
        /// Its words.
        detail: String,
    },
    /// The device does not know where it is. Nothing moved.
    #[error(
        "the {device} does not know where it is and must be homed first, which moves it: make room"
    )]
    NotHomed {
        /// Which device.
        device: &'static str,
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
    /// The stage stands outside, and a move was asked for that does not bring it back. Nothing moved.
    #[error(
        "the stage stands where it may not: {breach}; nothing moved. Only moves back inside are allowed, and straight away from the \
         specimen"
    )]
    StandsOutside {
        /// What it breaks.
        breach: Breach,
    },
    /// The user, or another thread, stopped the work.
    #[error("stopped on request{}", stands(at))]
    Interrupted {
        /// Where the stage was seen to stand still; `None` when nobody looked.
        at: Option<StagePose>,
    },
    /// It was told to stop, and goes on.
    #[error("the {device} was told to stop and still moves: use the emergency stop")]
    StillMoves {
        /// Which device.
        device: &'static str,
    },
    /// A move ended elsewhere than at its goal. The stage was told to stop.
    #[error(
        "{axis} was sent to {goal:.1} {unit} and says it settled at {at:.1} {unit}: look for an obstacle, and for lost steps, before \
         moving again",
        unit = axis.display_unit()
    )]
    NotArrived {
        /// The axis.
        axis: Axis,
        /// Where it was sent, in the axis' display unit (um or deg).
        goal: f64,
        /// Where it says it is, same unit.
        at: f64,
    },
    /// After a move the stage stands where it may not. It was told to stop.
    #[error(
        "after a move the stage stands where it may not: {breach}; it was told to stop. See what moved it there, then bring it back"
    )]
    Strayed {
        /// What it breaks.
        breach: Breach,
    },
    /// The stage says that it is where it said that it cannot be.
    #[error(
        "{axis} says that it is at {} {unit}, and its own travel is {min:.1} to {max:.1} {unit}: check its unit and its reference, \
         or bring it back by its maker's means",
        told(*at),
        unit = axis.display_unit()
    )]
    ImpossiblePlace {
        /// The axis.
        axis: Axis,
        /// Where it says it is, in the axis' display unit (um or deg); not a number when it says nothing.
        at: f64,
        /// The lower end of its travel, same unit.
        min: f64,
        /// The upper end of its travel, same unit.
        max: f64,
    },
    /// A move ended before its goal.
    #[error(
        "the move ended before its goal; look for an obstacle or a released brake before moving again"
    )]
    MoveAborted {
        /// Where the stage stopped, if it could be read.
        at: Option<StagePose>,
    },
    /// A change of objective ended before the objective was in. The stage stays where it is, away from the specimen.
    #[error(
        "{asked} was not brought into the beam, and which objective is there is not known{}. Change again{}",
        match retracted_from_um {
            Some(from) => format!("; the stage stays retracted, and was at z = {from:.1} um before"),
            None => String::new(),
        },
        match retracted_from_um {
            Some(_) => ", and focus near the height from before",
            None => "",
        }
    )]
    ChangeEnded {
        /// The objective that was asked for.
        asked: ObjectiveId,
        /// The height from which the stage retracted for the change, um.
        retracted_from_um: Option<f64>,
    },
    /// A device did not answer in time.
    #[error("the {device} did not finish within {seconds} s; it was told to stop")]
    Timeout {
        /// Which device.
        device: &'static str,
        /// How long was waited, on the instrument's clock.
        seconds: f64,
    },
    /// The connection to the device is gone.
    #[error(
        "the {device} is lost: {detail}. Check its power, its cable and its driver, then start again"
    )]
    Lost {
        /// Which device.
        device: &'static str,
        /// How it was noticed.
        detail: String,
    },
    /// The camera shows one image again and again, although the stage moved.
    #[error(
        "the {device} shows the very same image again and again: it has frozen, or its images have no noise and nothing in them moves with the stage. \
         Look at its driver and its cable, and start it again; where it averages images or is dark, average fewer, or give it more light"
    )]
    Frozen {
        /// Which device.
        device: &'static str,
    },
    /// Images that were taken before come again as new ones: what is seen changes while nothing moves.
    #[error(
        "the {device} shows stale images: what it showed went on changing for {frames} frames after the stage stood. Empty the buffer of its \
         driver, tell how late its images come, and see that the stage stands when it says so"
    )]
    Stale {
        /// Which device.
        device: &'static str,
        /// How many frames old the images are.
        frames: usize,
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

/// What can be done about an error, besides what its words say: each front end names the command or the button that does it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Remedy {
    /// Let the stage find its reference, which moves it.
    Home,
    /// Move the stage back to where it may stand.
    BringBack,
    /// Make the specimen ready for an objective that works in another medium, and agree to the change.
    AgreeToImmersion {
        /// What it works in.
        to: Immersion,
    },
    /// Focus near the height from before the change.
    FocusNear {
        /// With this objective.
        objective: ObjectiveId,
        /// The height, um.
        z_um: f64,
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
    /// What can be done about it, where a program can do it.
    pub fn remedy(&self) -> Option<Remedy> {
        match self {
            Self::NotHomed { .. } => Some(Remedy::Home),
            Self::StandsOutside { .. } | Self::Strayed { .. } => Some(Remedy::BringBack),
            Self::ImmersionNotAgreed { change } => Some(Remedy::AgreeToImmersion { to: change.to }),
            Self::ChangeEnded {
                asked,
                retracted_from_um: Some(z_um),
            } => Some(Remedy::FocusNear {
                objective: asked.clone(),
                z_um: *z_um,
            }),
            _ => None,
        }
    }

    /// What kind of trouble this is.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::OutsideLimits { .. }
            | Self::OutsideWorkspace { .. }
            | Self::TooClose { .. }
            | Self::StepTooLarge { .. }
            | Self::NotRetracted { .. }
            | Self::ImmersionNotAgreed { .. }
            | Self::NoSuchAxis { .. }
            | Self::NotFinite { .. }
            | Self::BadSetting { .. }
            | Self::Refused { .. }
            | Self::StandsOutside { .. }
            | Self::NotHomed { .. }
            | Self::Busy { .. }
            | Self::NoSuchObjective { .. } => ErrorKind::Refused,
            Self::Interrupted { .. } => ErrorKind::Interrupted,
            Self::MoveAborted { .. }
            | Self::NotArrived { .. }
            | Self::Strayed { .. }
            | Self::ImpossiblePlace { .. }
            | Self::StillMoves { .. }
            | Self::ChangeEnded { .. }
            | Self::Timeout { .. }
            | Self::Lost { .. }
            | Self::Frozen { .. }
            | Self::Stale { .. }
            | Self::Device { .. } => ErrorKind::Fault,
        }
    }
}

impl From<Breach> for ScopeError {
    /// The refusal of a place that was asked for.
    fn from(breach: Breach) -> Self {
        match breach {
            Breach::Limits { axis, at, min, max } => Self::OutsideLimits {
                axis,
                asked: at,
                min,
                max,
            },
            Breach::Workspace { share } => Self::OutsideWorkspace { share },
            Breach::Zone {
                zone,
                z_um,
                closest_um,
            } => Self::TooClose {
                zone,
                z_um,
                closest_um,
            },
        }
    }
}

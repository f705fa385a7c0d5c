//! What the gate is asked and what it answers, for whoever watches.

use crate::{Axis, ObjectiveId, StagePose};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A command to the gate and what became of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum GateEvent {
    /// A move is about to begin, or to be refused: told before, so that a journal knows where the stage may be going.
    MoveAsked {
        /// The axes that are asked for.
        to: StagePose,
    },
    /// A move began.
    MoveBegan {
        /// The axes that were asked for.
        to: StagePose,
    },
    /// A move did not begin, or was stopped as it began.
    MoveRefused {
        /// The axes that were asked for.
        to: StagePose,
        /// Why.
        why: String,
    },
    /// A move ended where it was sent.
    Arrived {
        /// Where the stage says it is.
        at: StagePose,
    },
    /// A move ended elsewhere, or where it may not; the stage was told to stop.
    NotArrived {
        /// Why.
        why: String,
    },
    /// The stage began to find its reference, which may move any of its axes anywhere.
    HomingBegan {
        /// The axes that it has.
        axes: Vec<Axis>,
    },
    /// Homing did not begin, or was stopped as it began.
    HomingRefused {
        /// Why.
        why: String,
    },
    /// The reference was found.
    HomingEnded {
        /// Where the stage says it is, each axis.
        at: StagePose,
    },
    /// The reference was not found, or lies where it cannot be.
    HomingFailed {
        /// Why.
        why: String,
    },
    /// The nosepiece began to turn.
    ChangeBegan {
        /// The objective that was asked for.
        to: ObjectiveId,
    },
    /// The nosepiece did not begin to turn, or was stopped as it began.
    ChangeRefused {
        /// The objective that was asked for.
        to: ObjectiveId,
        /// Why.
        why: String,
    },
    /// The nosepiece ended with the objective in that was asked for.
    Changed {
        /// The active objective.
        to: ObjectiveId,
    },
    /// The nosepiece ended otherwise.
    NotChanged {
        /// The objective that was asked for.
        to: ObjectiveId,
        /// Why.
        why: String,
    },
    /// Stage and nosepiece were told to stop.
    Stopped {
        /// What a device answered that did not take it.
        fault: Option<String>,
    },
}

/// Is told of every command before and after it was answered, on the thread that gave it. It must come back at once, and must not ask the gate
/// for a motion.
pub type Observer = Arc<dyn Fn(GateEvent) + Send + Sync>;

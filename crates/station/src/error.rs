//! What a job ends with that is no answer, and what the station refuses.

use crate::{JobId, JournalError, QuestionId};
use scopeservo_scope::{ScopeError, StagePose};
use scopeservo_servo::{ErrorKind, ServoError};
use thiserror::Error;

/// Why a job has no answer.
#[derive(Debug, Clone, Error)]
#[non_exhaustive]
pub enum JobError {
    /// Somebody stopped it, or the whole instrument.
    #[error("stopped on request")]
    Stopped {
        /// Where the stage was seen to stand still; `None` when nobody looked.
        at: Option<StagePose>,
    },
    /// The procedure failed, or the instrument.
    #[error(transparent)]
    Procedure(ServoError),
    /// Nobody knows which objective is active, and none was named. Nothing moved.
    #[error("nobody knows which objective is active: name one. There are {available}")]
    NoObjective {
        /// Those there are, separated by commas.
        available: String,
    },
    /// The state could not be kept, so the next step was not made.
    #[error("{0}; nothing moved after that")]
    Journal(#[from] JournalError),
    /// A mistake of the program: a panic, after which the instrument was told to stop, or an answer that cannot be.
    #[error("a mistake of the program ended the job: {what}")]
    Mistake {
        /// What it said.
        what: String,
    },
}

impl JobError {
    /// What kind of trouble it is.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Stopped { .. } => ErrorKind::Interruption,
            Self::Procedure(error) => error.kind(),
            Self::NoObjective { .. } => ErrorKind::Refusal,
            Self::Journal(_) | Self::Mistake { .. } => ErrorKind::Fault,
        }
    }
}

impl From<ServoError> for JobError {
    fn from(error: ServoError) -> Self {
        match error {
            ServoError::Scope(ScopeError::Interrupted { at }) => Self::Stopped { at },
            error => Self::Procedure(error),
        }
    }
}

impl From<ScopeError> for JobError {
    fn from(error: ScopeError) -> Self {
        ServoError::from(error).into()
    }
}

/// What the station does not do for whoever asked. Nothing moved.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum Refusal {
    /// Somebody else may move the instrument.
    #[error("{owner} works with this instrument{}; you may watch, and stop it", match seconds_left {
        Some(s) => format!(", for {s:.0} s more unless renewed"),
        None => String::new(),
    })]
    Held {
        /// Who.
        owner: String,
        /// How long still, unless renewed; `None`: until given back.
        seconds_left: Option<f64>,
    },
    /// The lease was given back, has expired, or is of another session.
    #[error("{owner} does not work with this instrument any more: take it again")]
    LeaseLost {
        /// Whose it was.
        owner: String,
    },
    /// No such job is under way.
    #[error("job {id} is not under way")]
    NoSuchJob {
        /// The job.
        id: JobId,
    },
    /// Nobody waits for that answer.
    #[error("question {id} is not open any more")]
    NoSuchQuestion {
        /// The question.
        id: QuestionId,
    },
    /// The computer has no thread left.
    #[error("the job could not begin: {why}")]
    NoThread {
        /// The system's words.
        why: String,
    },
}

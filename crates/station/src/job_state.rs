//! What a job is, and how it stands: values that are told and stored.

use scopeservo_scope::StagePose;
use scopeservo_servo::ErrorKind;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Counts the jobs of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct JobId(pub u64);

impl fmt::Display for JobId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// What a job is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobInfo {
    /// Its number in the session.
    pub id: JobId,
    /// The use case: a word for programs.
    pub kind: String,
    /// Who started it.
    pub owner: String,
}

/// Why a job waits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pause {
    /// Somebody asked for it.
    Asked,
    /// The lease it ran under has expired or was given back. Whoever has the lease resumes it, or stops it.
    LeaseLost,
}

/// How a job ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "how", rename_all = "snake_case")]
pub enum Ended {
    /// With an answer, be it "not found".
    Answered,
    /// Somebody stopped it.
    Stopped {
        /// Where the stage was seen to stand still; `None` when nobody looked.
        at: Option<StagePose>,
    },
    /// With an error.
    Failed {
        /// For people.
        message: String,
        /// What kind of trouble it was, for programs.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        kind: Option<ErrorKind>,
    },
}

/// How a job stands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "state", rename_all = "snake_case")]
pub enum JobState {
    /// Others come first.
    Queued,
    /// It works.
    Running,
    /// It waits before its next step.
    Paused {
        /// Why.
        why: Pause,
    },
    /// It waits for somebody's answer.
    Asking,
    /// It is over.
    Ended(Ended),
}

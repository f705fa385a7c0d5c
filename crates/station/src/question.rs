//! What people are asked.

use crate::JobId;
use scopeservo_scope::{ImmersionChange, ObjectiveId};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Counts the questions of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct QuestionId(pub u64);

impl fmt::Display for QuestionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// What is asked; each front end has its own words for it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum QuestionKind {
    /// Turn the nosepiece to this objective: yes when it is in, no when it will not be.
    TurnNosepiece {
        /// The objective.
        objective: ObjectiveId,
    },
    /// Make the specimen ready for an objective that works in another medium: yes when it is, and this one change may be made.
    ChangeImmersion {
        /// The change.
        change: ImmersionChange,
    },
    /// Something that has no word of its own, for people.
    Confirm {
        /// The question.
        text: String,
    },
}

/// A question that waits for its answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Question {
    /// What to answer to.
    pub id: QuestionId,
    /// The job that waits.
    pub job: Option<JobId>,
    /// What is asked.
    #[serde(flatten)]
    pub kind: QuestionKind,
}

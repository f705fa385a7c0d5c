//! What can be heard.

use crate::jobs::Finding;
use crate::{Ended, JobId, JobInfo, Pause, Question, QuestionId};
use scopeservo_scope::GateEvent;
use scopeservo_servo::Event;
use serde::{Deserialize, Serialize};

/// One thing that happened: a line of the session's log.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Counts from 0 without gaps. (Frames have a `sequence` of their own.)
    pub number: u64,
    /// Seconds on the instrument's clock.
    pub time_s: f64,
    /// The job that was under way.
    pub job: Option<JobId>,
    /// What happened.
    #[serde(flatten)]
    pub news: News,
}

/// Who tells, and what.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "from", rename_all = "snake_case")]
pub enum News {
    /// The procedure of a job.
    Procedure(Box<Event>),
    /// The motion gate: every command, those hidden in a change of objective as well.
    Gate(GateEvent),
    /// The station.
    Station(StationEvent),
}

/// What the station tells.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum StationEvent {
    /// A job waits for its turn.
    JobQueued {
        /// The job.
        info: JobInfo,
    },
    /// A job began.
    JobBegan {
        /// The job.
        info: JobInfo,
    },
    /// A job waits before its next step.
    JobPaused {
        /// Which.
        id: JobId,
        /// Why.
        why: Pause,
    },
    /// A job goes on.
    JobResumed {
        /// Which.
        id: JobId,
    },
    /// A job ended.
    JobEnded {
        /// Which.
        id: JobId,
        /// How.
        how: Ended,
    },
    /// Something could not be kept; the job goes on.
    NotKept {
        /// Which job.
        id: JobId,
        /// Why.
        why: String,
    },
    /// A doctor found something, good or bad.
    Found {
        /// What.
        finding: Box<Finding>,
    },
    /// Somebody is asked something.
    Asked {
        /// What.
        question: Question,
    },
    /// Somebody answered.
    Answered {
        /// Which question.
        id: QuestionId,
        /// What.
        yes: bool,
    },
    /// The answer is not wanted any more.
    QuestionCancelled {
        /// Which question.
        id: QuestionId,
    },
    /// The instrument has an owner.
    LeaseTaken {
        /// Who.
        owner: String,
    },
    /// The instrument has lost its owner.
    LeaseLost {
        /// Who it was.
        owner: String,
        /// Whether the time ran out; else it was given back.
        expired: bool,
    },
    /// Somebody asked for a stop.
    StopAsked,
}

impl Record {
    /// About what it takes in memory.
    pub(crate) fn bytes(&self) -> usize {
        let beyond = match &self.news {
            News::Procedure(event) => {
                let more = match &**event {
                    Event::Iteration { pairs, .. } => size_of_val(&pairs[..]),
                    Event::Finished { outcome } => size_of_val(&outcome.magnifications[..]),
                    _ => 0,
                };
                size_of::<Event>() + more
            }
            _ => 0,
        };
        // Names and messages, and what an allocation costs.
        size_of::<Self>() + beyond + 128
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::Check;
    use scopeservo_servo::FrameRole;

    /// Who tells stands beside what is told: no key of one may be a key of the other.
    #[test]
    fn a_record_comes_back_from_json() {
        let objective = scopeservo_scope::ObjectiveId("40x".into());
        let grabbed = Event::FrameGrabbed {
            sequence: 7,
            role: FrameRole::Servo,
            objective,
            exposure_start_s: Some(1.25),
            exposure_s: Some(0.01),
            stage: Some(scopeservo_scope::StagePose::default()),
        };
        let to = scopeservo_scope::StagePose::default();
        let error = scopeservo_scope::ScopeError::NotHomed { device: "stage" };
        let finding = Box::new(Finding {
            check: Check::Position { at: None },
            of_trial: false,
            trouble: Some(error.into()),
        });
        let told = [
            News::Procedure(Box::new(grabbed)),
            News::Gate(GateEvent::MoveAsked { to }),
            News::Station(StationEvent::JobEnded {
                id: JobId(3),
                how: Ended::Answered,
            }),
            News::Station(StationEvent::Found { finding }),
        ];
        for news in told {
            let record = Record {
                number: 12,
                time_s: 1.5,
                job: Some(JobId(3)),
                news,
            };
            let json = serde_json::to_string(&record).unwrap();
            let back: Record = serde_json::from_str(&json).unwrap();
            assert_eq!(back, record, "{json}");
        }
    }
}

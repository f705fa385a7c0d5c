//! Which objective is active, asked of the image by a small move. The view must be in focus.

use crate::{JobError, UseCase, Work};
use scopeservo_scope::ObjectiveId;
use scopeservo_servo::{Identify, Identity, Progress, VisionOptions};
use serde::{Deserialize, Serialize};

/// What is asked.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IdentifyInput {
    /// The objective that should be there; the one that is said to be active when none is named.
    pub objective: Option<ObjectiveId>,
    /// How to look.
    pub vision: VisionOptions,
}

/// What the image tells.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IdentifyOutput {
    /// The objective that should be there.
    pub objective: ObjectiveId,
    /// What the image tells.
    pub identity: Identity,
}

/// The job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IdentifyJob {
    input: IdentifyInput,
    /// `None` before anything was done.
    under_way: Option<(ObjectiveId, Identify)>,
}

impl IdentifyJob {
    /// Does what is asked.
    pub fn new(input: IdentifyInput) -> Self {
        Self {
            input,
            under_way: None,
        }
    }
}

impl UseCase for IdentifyJob {
    type Output = IdentifyOutput;

    fn kind(&self) -> &'static str {
        "identify"
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<IdentifyOutput>, JobError> {
        let Some((objective, identify)) = &mut self.under_way else {
            let objective = work.objective(self.input.objective.as_ref())?.id;
            let identify = Identify::new(objective.clone(), self.input.vision.clone());
            self.under_way = Some((objective, identify));
            return Ok(Progress::Continue);
        };
        Ok(match work.step(identify)? {
            Progress::Done(identity) => Progress::Done(IdentifyOutput {
                objective: objective.clone(),
                identity,
            }),
            Progress::Continue => Progress::Continue,
        })
    }
}

//! An active objective, brought into focus.

use crate::{JobError, UseCase, Work};
use scopeservo_scope::{Axis, Length, ObjectiveId, StagePose};
use scopeservo_servo::{Bring, FocusOptions, FocusResult, Progress, VisionOptions};
use serde::{Deserialize, Serialize};

/// What is asked.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FocusInput {
    /// The objective; the active one when none is named.
    pub objective: Option<ObjectiveId>,
    /// A height to go to first, um, for a stage that was left retracted.
    pub near_z_um: Option<f64>,
    /// How to focus.
    pub focus: FocusOptions,
    /// How to look, where an image has to show which objective is in.
    pub vision: VisionOptions,
}

/// What was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FocusOutput {
    /// The active objective.
    pub objective: ObjectiveId,
    /// Where it is in focus.
    pub result: FocusResult,
}

/// The job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FocusJob {
    input: FocusInput,
    /// `None` before anything was done.
    under_way: Option<(ObjectiveId, Bring)>,
}

impl FocusJob {
    /// Does what is asked.
    pub fn new(input: FocusInput) -> Self {
        Self {
            input,
            under_way: None,
        }
    }
}

impl UseCase for FocusJob {
    type Output = FocusOutput;

    fn kind(&self) -> &'static str {
        "focus"
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<FocusOutput>, JobError> {
        let Some((objective, bring)) = &mut self.under_way else {
            let objective = work.objective(self.input.objective.as_ref())?.id;
            if let Some(um) = self.input.near_z_um {
                // With the objective in that is to be focused, not with another.
                work.scope().select_objective(&objective)?;
                let z = Length::from_um(um).m();
                work.scope()
                    .move_to(&StagePose::default().with_si(Axis::Z, z))?;
            }
            let input = &self.input;
            let bring = Bring::new(
                objective.clone(),
                Some(input.focus.clone()),
                input.vision.clone(),
            );
            self.under_way = Some((objective, bring));
            return Ok(Progress::Continue);
        };
        Ok(match work.step(bring)? {
            Progress::Done(Some(result)) => Progress::Done(FocusOutput {
                objective: objective.clone(),
                result,
            }),
            // It was asked to focus, and says that it did not.
            Progress::Done(None) => {
                return Err(JobError::Mistake {
                    what: "nothing was focused".into(),
                });
            }
            Progress::Continue => Progress::Continue,
        })
    }
}

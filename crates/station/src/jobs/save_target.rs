//! The view saved as a target, after the objective was brought into the beam and, where that is wanted, into focus.

use crate::{JobError, UseCase, Work};
use scopeservo_scope::{Frame, ObjectiveId, StagePose};
use scopeservo_servo::{
    Bring, Calibration, FocusOptions, InFocus, Progress, SaveOptions, SaveTarget, Target,
    VisionOptions,
};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What is asked.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SaveTargetInput {
    /// The objective; the active one when none is named.
    pub objective: Option<ObjectiveId>,
    /// How to focus first; `None` where the view is in focus.
    pub focus: Option<FocusOptions>,
    /// How to look whether it is, where that may be looked at.
    pub focusing: FocusOptions,
    /// Nothing may move for it: then nobody knows what belongs to the specimen, and the run must prove it.
    pub still: bool,
    /// Calibrations of this instrument and camera that are known; the scale of others is as engraved.
    pub known: Vec<Calibration>,
    /// How to look.
    pub vision: VisionOptions,
}

/// What was saved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SaveTargetOutput {
    /// The target, to be kept.
    pub target: Target,
    /// Where the stage stood.
    pub stage: StagePose,
    /// Its image, to be kept; it stays in this process.
    #[serde(skip)]
    pub frame: Option<Arc<Frame>>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum State {
    Begin,
    Bring {
        objective: ObjectiveId,
        bring: Box<Bring>,
    },
    InFocus {
        objective: ObjectiveId,
        look: Box<InFocus>,
    },
    Save {
        stage: StagePose,
        save: Box<SaveTarget>,
        /// States of earlier versions do not tell it.
        #[serde(default)]
        objective: Option<ObjectiveId>,
    },
}

/// The job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SaveTargetJob {
    input: SaveTargetInput,
    state: State,
}

impl SaveTargetJob {
    /// Does what is asked.
    pub fn new(input: SaveTargetInput) -> Self {
        Self {
            input,
            state: State::Begin,
        }
    }

    /// Where the stage stood for what is kept, once that is known: who goes on after a kill sees whether it was kept by this job.
    pub fn stage(&self) -> Option<&StagePose> {
        match &self.state {
            State::Save { stage, .. } => Some(stage),
            State::Begin | State::Bring { .. } | State::InFocus { .. } => None,
        }
    }

    /// The objective that was brought into the beam.
    fn brought(&self) -> Option<&ObjectiveId> {
        match &self.state {
            State::InFocus { objective, .. } => Some(objective),
            State::Save { objective, .. } => objective.as_ref(),
            State::Begin | State::Bring { .. } => None,
        }
    }

    fn bring(&self, objective: &ObjectiveId) -> Bring {
        let (focus, vision) = (self.input.focus.clone(), self.input.vision.clone());
        Bring::new(objective.clone(), focus, vision)
    }

    fn save(&self, work: &Work<'_>, objective: &ObjectiveId) -> Result<State, JobError> {
        let of_it = |c: &&Calibration| c.objective == *objective;
        let save = SaveTarget::new(SaveOptions {
            vision: self.input.vision.clone(),
            still: self.input.still,
            calibration: self.input.known.iter().find(of_it).cloned(),
        });
        Ok(State::Save {
            stage: work.scope().gate().position()?,
            save: Box::new(save),
            objective: Some(objective.clone()),
        })
    }
}

impl UseCase for SaveTargetJob {
    type Output = SaveTargetOutput;

    fn kind(&self) -> &'static str {
        "save_target"
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<SaveTargetOutput>, JobError> {
        let input = &self.input;
        if let Some(objective) = self.brought()
            && !work.is_in(objective)?
        {
            let objective = objective.clone();
            let bring = Box::new(self.bring(&objective));
            self.state = State::Bring { objective, bring };
            return Ok(Progress::Continue);
        }
        match &mut self.state {
            State::Begin => {
                let objective = work.objective(input.objective.as_ref())?.id;
                let bring = Box::new(self.bring(&objective));
                self.state = State::Bring { objective, bring };
            }
            State::Bring { objective, bring } => {
                if let Progress::Done(_) = work.step(&mut **bring)? {
                    let objective = objective.clone();
                    self.state = match input.still || input.focus.is_some() {
                        true => self.save(work, &objective)?,
                        false => {
                            let (focusing, vision) = (input.focusing.clone(), input.vision.clone());
                            let look = InFocus::new(objective.clone(), focusing, vision);
                            let look = Box::new(look);
                            State::InFocus { objective, look }
                        }
                    };
                }
            }
            State::InFocus { objective, look } => {
                if let Progress::Done(()) = work.step(&mut **look)? {
                    let objective = objective.clone();
                    self.state = self.save(work, &objective)?;
                }
            }
            State::Save { stage, save, .. } => {
                let stage = *stage;
                if let Progress::Done(target) = work.step(&mut **save)? {
                    let frame = work.target_frame();
                    return Ok(Progress::Done(SaveTargetOutput {
                        target,
                        stage,
                        frame,
                    }));
                }
            }
        }
        Ok(Progress::Continue)
    }
}

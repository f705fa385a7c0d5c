//! How the view is tilted, and levelling it.

use crate::{JobError, UseCase, Work};
use scopeservo_scope::{Objective, ObjectiveId};
use scopeservo_servo::{
    Bring, Calibration, FocusOptions, Level, LevelOptions, LevelReport, Progress, VisionOptions,
};
use serde::{Deserialize, Serialize};

/// What is asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LevelInput {
    /// The objective; the active one when none is named.
    pub objective: Option<ObjectiveId>,
    /// How to focus first; `None` where the view is in focus.
    pub focus: Option<FocusOptions>,
    /// Whether to level, and how.
    pub level: LevelOptions,
    /// How to look, where an image has to show which objective is in.
    pub vision: VisionOptions,
    /// What storage knows: it tells how the camera lies in the stage's axes.
    pub calibrations: Vec<Calibration>,
}

impl Default for LevelInput {
    fn default() -> Self {
        Self {
            objective: None,
            focus: Some(FocusOptions::default()),
            level: LevelOptions::default(),
            vision: VisionOptions::default(),
            calibrations: Vec::new(),
        }
    }
}

/// What was seen, and done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LevelOutput {
    /// The tilt, and what levelling did.
    pub report: LevelReport,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum State {
    Begin,
    Bring(Box<Bring>, Objective),
    Level(Box<Level>),
}

/// The job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LevelJob {
    input: LevelInput,
    state: State,
}

impl LevelJob {
    /// Does what is asked.
    pub fn new(input: LevelInput) -> Self {
        Self {
            input,
            state: State::Begin,
        }
    }

    fn bring(&self, objective: Objective) -> State {
        let (focus, vision) = (self.input.focus.clone(), self.input.vision.clone());
        let bring = Bring::new(objective.id.clone(), focus, vision);
        State::Bring(Box::new(bring), objective)
    }
}

impl UseCase for LevelJob {
    type Output = LevelOutput;

    fn kind(&self) -> &'static str {
        "level"
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<LevelOutput>, JobError> {
        let input = &self.input;
        if let State::Level(level) = &self.state
            && !work.is_in(&level.objective().id)?
        {
            self.state = self.bring(level.objective().clone());
        }
        match &mut self.state {
            State::Begin => {
                let objective = work.objective(input.objective.as_ref())?;
                self.state = self.bring(objective);
            }
            State::Bring(bring, objective) => {
                if let Progress::Done(_) = work.step(&mut **bring)? {
                    let level = Level::new(objective.clone(), input.level.clone());
                    let known = input
                        .calibrations
                        .iter()
                        .find(|c| c.objective == objective.id);
                    let level = match known {
                        Some(calibration) => level.knowing(calibration),
                        None => level,
                    };
                    self.state = State::Level(Box::new(level));
                }
            }
            State::Level(level) => {
                if let Progress::Done(report) = work.step(&mut **level)? {
                    return Ok(Progress::Done(LevelOutput { report }));
                }
            }
        }
        Ok(Progress::Continue)
    }
}

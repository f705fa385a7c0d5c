//! An objective and the stage, checked by a pattern slide.

use crate::{JobError, UseCase, Work};
use scopeservo_scope::{Objective, ObjectiveId};
use scopeservo_servo::{
    Bring, Calibration, Comparison, FocusOptions, GridCheck, GridOptions, GridReport, Progress,
    VisionOptions, compare_with,
};
use serde::{Deserialize, Serialize};

/// What is asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GridInput {
    /// The objective; the active one when none is named.
    pub objective: Option<ObjectiveId>,
    /// How to focus first; `None` where the view is in focus.
    pub focus: Option<FocusOptions>,
    /// The pattern, and how far to go.
    pub grid: GridOptions,
    /// How to look, where an image has to show which objective is in.
    pub vision: VisionOptions,
    /// What storage knows, to be compared with.
    pub calibrations: Vec<Calibration>,
}

impl Default for GridInput {
    fn default() -> Self {
        Self {
            objective: None,
            focus: Some(FocusOptions::default()),
            grid: GridOptions::default(),
            vision: VisionOptions::default(),
            calibrations: Vec::new(),
        }
    }
}

/// What the grid said. It is not to be kept as a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GridOutput {
    /// By the grid.
    pub report: GridReport,
    /// Beside the calibration of the objective, where there is one.
    pub comparison: Option<Comparison>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum State {
    Begin,
    Bring(Box<Bring>, Objective),
    Check(Box<GridCheck>),
}

/// The job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GridJob {
    input: GridInput,
    state: State,
}

impl GridJob {
    /// Does what is asked.
    pub fn new(input: GridInput) -> Self {
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

    fn told(&self, report: GridReport) -> GridOutput {
        let known = calibration_of(&self.input.calibrations, report.objective());
        GridOutput {
            comparison: known.map(|c| compare_with(&report, c)),
            report,
        }
    }
}

fn calibration_of<'a>(all: &'a [Calibration], objective: &ObjectiveId) -> Option<&'a Calibration> {
    all.iter().find(|c| c.objective == *objective)
}

impl UseCase for GridJob {
    type Output = GridOutput;

    fn kind(&self) -> &'static str {
        "grid"
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<GridOutput>, JobError> {
        let input = &self.input;
        if let State::Check(check) = &self.state
            && !work.is_in(&check.objective().id)?
        {
            self.state = self.bring(check.objective().clone());
        }
        match &mut self.state {
            State::Begin => {
                let objective = work.objective(input.objective.as_ref())?;
                self.state = self.bring(objective);
            }
            State::Bring(bring, objective) => {
                if let Progress::Done(_) = work.step(&mut **bring)? {
                    let check = GridCheck::new(objective.clone(), input.grid.clone());
                    let check = match calibration_of(&input.calibrations, &objective.id) {
                        Some(calibration) => check.knowing(calibration),
                        None => check,
                    };
                    self.state = State::Check(Box::new(check));
                }
            }
            State::Check(check) => {
                if let Progress::Done(report) = work.step(&mut **check)? {
                    return Ok(Progress::Done(self.told(report)));
                }
            }
        }
        Ok(Progress::Continue)
    }
}

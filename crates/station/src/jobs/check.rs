//! Kept calibrations tested by two moves, one objective after the other, from the lowest magnification up.

use crate::{JobError, UseCase, Work};
use scopeservo_scope::{Objective, ObjectiveId, by_immersion};
use scopeservo_servo::{
    Bring, Calibration, ErrorCode, ErrorKind, FocusOptions, Progress, SelfTest, SelfTestReport,
    Together, VisionOptions, together,
};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// What is asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CheckInput {
    /// The calibrations to test, as storage has them: one of an objective.
    pub calibrations: Vec<Calibration>,
    /// How to focus each first; `None` where the view is in focus.
    pub focus: Option<FocusOptions>,
    /// How to look.
    pub vision: VisionOptions,
}

impl Default for CheckInput {
    fn default() -> Self {
        Self {
            calibrations: Vec::new(),
            focus: Some(FocusOptions::default()),
            vision: VisionOptions::default(),
        }
    }
}

/// What came of one objective.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Checked {
    /// What was seen.
    Told(Box<SelfTestReport>),
    /// Nothing could be said of it.
    Unclear {
        /// The objective.
        objective: ObjectiveId,
        /// Why, for programs.
        code: ErrorCode,
        /// Why, for people.
        message: String,
    },
}

/// What was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CheckOutput {
    /// Objective by objective.
    pub checked: Vec<Checked>,
    /// Which of them disagree.
    pub together: Together,
}

impl CheckOutput {
    /// Whether all was seen to be good.
    pub fn all_good(&self) -> bool {
        let told = |c: &Checked| matches!(c, Checked::Told(_));
        self.together == Together::None && self.checked.iter().all(told)
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum State {
    Begin,
    Next,
    Bring(Box<Bring>),
    Test(Box<SelfTest>),
}

/// The job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CheckJob {
    input: CheckInput,
    state: State,
    /// Those to come; the first is under way.
    left: VecDeque<(Objective, Calibration)>,
    checked: Vec<Checked>,
}

impl CheckJob {
    /// Does what is asked.
    pub fn new(input: CheckInput) -> Self {
        Self {
            input,
            state: State::Begin,
            left: VecDeque::new(),
            checked: Vec::new(),
        }
    }

    fn plan(&mut self, work: &Work<'_>) -> Result<(), JobError> {
        let kept = self.input.calibrations.iter();
        let mut wanted = kept
            .map(|c| Ok((work.scope().objective(&c.objective)?.clone(), c.clone())))
            .collect::<Result<Vec<_>, JobError>>()?;
        by_immersion(&mut wanted, work.immersion()?, |(objective, _)| objective);
        self.left = wanted.into();
        Ok(())
    }

    /// One step of the objective that is under way; its report when it is there.
    fn advance(&mut self, work: &mut Work<'_>) -> Result<Option<SelfTestReport>, JobError> {
        let Some((objective, calibration)) = self.left.front() else {
            return Ok(None);
        };
        let input = &self.input;
        if matches!(self.state, State::Test(_)) && !work.is_in(&objective.id)? {
            self.state = State::Next;
        }
        match &mut self.state {
            State::Begin | State::Next => {
                // What fails from now on goes back to where this one began.
                work.scope().command_begins();
                let (focus, vision) = (input.focus.clone(), input.vision.clone());
                let bring = Bring::new(objective.id.clone(), focus, vision);
                self.state = State::Bring(Box::new(bring));
            }
            State::Bring(bring) => {
                if let Progress::Done(_) = work.step(&mut **bring)? {
                    let (objective, calibration) = (objective.clone(), calibration.clone());
                    let test = SelfTest::new(objective, calibration, input.vision.clone());
                    self.state = State::Test(Box::new(test));
                }
            }
            State::Test(test) => {
                if let Progress::Done(report) = work.step(&mut **test)? {
                    return Ok(Some(report));
                }
            }
        }
        Ok(None)
    }

    fn told(&mut self, checked: Checked) {
        self.checked.push(checked);
        self.left.pop_front();
        self.state = State::Next;
    }
}

impl UseCase for CheckJob {
    type Output = CheckOutput;

    fn kind(&self) -> &'static str {
        "check"
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<CheckOutput>, JobError> {
        if matches!(self.state, State::Begin) {
            self.plan(work)?;
            self.state = State::Next;
            return Ok(Progress::Continue);
        }
        let Some((objective, _)) = self.left.front() else {
            let checked = std::mem::take(&mut self.checked);
            let told = checked.iter().filter_map(|c| match c {
                Checked::Told(report) => Some((**report).clone()),
                Checked::Unclear { .. } => None,
            });
            let told: Vec<SelfTestReport> = told.collect();
            let together = together(&told);
            return Ok(Progress::Done(CheckOutput { checked, together }));
        };
        let objective = objective.id.clone();
        match self.advance(work) {
            Ok(Some(report)) => self.told(Checked::Told(Box::new(report))),
            Ok(None) => {}
            // What could not be seen with one objective may be with the next.
            Err(JobError::Procedure(error))
                if error.kind() == ErrorKind::Answer
                    || error.code() == ErrorCode::OutsideLimits =>
            {
                self.told(Checked::Unclear {
                    objective,
                    code: error.code(),
                    message: error.to_string(),
                });
            }
            Err(error) => return Err(error),
        }
        Ok(Progress::Continue)
    }
}

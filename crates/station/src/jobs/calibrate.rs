//! Objectives calibrated one after the other, from the lowest magnification up, those that work in one medium together; at the end all of them as
//! one instrument.

use crate::{JobError, Kept, MadeCalibration, UseCase, Work};
use scopeservo_scope::{Immersion, Objective, ObjectiveId, by_immersion};
use scopeservo_servo::{
    Alone, Bring, Calibrate, CalibrateOptions, Calibration, CalibrationSet, Event, FocusOptions,
    NotOne, Phase, Progress, Stamped, Switching, SwitchingOptions, SwitchingReport, VisionOptions,
    agree, first_step, one_microscope,
};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// What is asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CalibrateInput {
    /// The objectives; all that there are when none is named.
    pub objectives: Vec<ObjectiveId>,
    /// How to focus each first; `None` where the view is in focus.
    pub focus: Option<FocusOptions>,
    /// How to calibrate.
    pub calibrate: CalibrateOptions,
    /// How often each objective then comes in turn with the one of the lowest magnification that works in the same medium; never with 0.
    pub switching: usize,
    /// How to look.
    pub vision: VisionOptions,
}

impl Default for CalibrateInput {
    fn default() -> Self {
        Self {
            objectives: Vec::new(),
            focus: Some(FocusOptions::default()),
            calibrate: CalibrateOptions::default(),
            switching: 0,
            vision: VisionOptions::default(),
        }
    }
}

/// What was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CalibrateOutput {
    /// The calibrations, to be kept.
    pub made: Vec<MadeCalibration>,
    /// What switching between objectives has shown, to be kept.
    #[serde(default)]
    pub switching: Vec<SwitchingReport>,
    /// Whether the objectives are one instrument; `None` of one objective, and of two steps.
    #[serde(default)]
    pub together: Option<Whole>,
}

/// Objectives as one instrument.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Whole {
    /// They are: what was made is what all of them say, to be kept.
    One(Box<CalibrationSet>),
    /// They contradict each other: each is kept as its own views say.
    NotOne(NotOne),
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum State {
    Begin,
    Next,
    Bring(Box<Bring>),
    Calibrate(Box<Calibrate>),
    Switch(Box<Switching>),
}

/// The job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CalibrateJob {
    input: CalibrateInput,
    state: State,
    /// Those to come; the first is under way.
    left: VecDeque<Objective>,
    made: Vec<MadeCalibration>,
    /// What each of them saw.
    #[serde(default)]
    alone: Vec<Alone>,
    /// What all of them say; asked once.
    #[serde(default)]
    together: Option<Whole>,
    /// What switching has shown so far.
    #[serde(default)]
    switched: Vec<SwitchingReport>,
}

impl CalibrateJob {
    /// Does what is asked.
    pub fn new(input: CalibrateInput) -> Self {
        Self {
            input,
            state: State::Begin,
            left: VecDeque::new(),
            made: Vec::new(),
            alone: Vec::new(),
            together: None,
            switched: Vec::new(),
        }
    }

    /// The switching that comes next, before the medium changes: each calibration of a medium with the first one of it.
    fn next_switching(&self, work: &Work<'_>) -> Result<Option<Switching>, JobError> {
        let Some(last) = self.made.last().filter(|_| self.input.switching > 0) else {
            return Ok(None);
        };
        let immersion = |made: &MadeCalibration| -> Result<Immersion, JobError> {
            Ok(work
                .scope()
                .objective(&made.calibration.objective)?
                .immersion)
        };
        let now = immersion(last)?;
        if self.left.front().is_some_and(|next| next.immersion == now) {
            return Ok(None);
        }
        let mut pairs = Vec::new();
        for (k, made) in self.made.iter().enumerate() {
            let own = immersion(made)?;
            let mut first = None;
            for before in &self.made[..k] {
                if first.is_none() && immersion(before)? == own {
                    first = Some(before.calibration.clone());
                }
            }
            pairs.extend(first.map(|first| [first, made.calibration.clone()]));
        }
        let options = SwitchingOptions {
            times: self.input.switching,
            focus: self.input.focus.clone(),
            vision: self.input.vision.clone(),
        };
        // Media come one after the other, and so do their pairs.
        let next = pairs.into_iter().nth(self.switched.len());
        Ok(next.map(|pair| Switching::new(pair, options)))
    }

    /// Makes one instrument of all, where that was not asked yet and there is more than one. What all of them say is kept beside what each said by
    /// itself, and counts.
    fn whole(&mut self, work: &mut Work<'_>) -> bool {
        if self.together.is_some() || self.alone.len() != self.made.len() {
            return false;
        }
        let kinematics = work.scope().gate().info().kinematics;
        let Some(said) = one_microscope(&self.alone, kinematics, &self.input.vision) else {
            return false;
        };
        self.together = Some(match said {
            Ok(set) => {
                for (made, calibration) in self.made.iter_mut().zip(&set.calibrations) {
                    made.calibration = calibration.clone();
                    work.keep(Kept::Calibration(Box::new(made.clone())));
                }
                let set = Box::new(set);
                work.keep(Kept::Set(set.clone()));
                Whole::One(set)
            }
            Err(why) => Whole::NotOne(why),
        });
        self.alone.clear();
        true
    }

    fn plan(&mut self, work: &Work<'_>) -> Result<(), JobError> {
        let scope = work.scope();
        let named = self.input.objectives.iter();
        let mut wanted = match self.input.objectives.is_empty() {
            true => scope.gate().objectives().to_vec(),
            false => named
                .map(|id| scope.objective(id).cloned())
                .collect::<Result<_, _>>()?,
        };
        by_immersion(&mut wanted, work.immersion()?, |objective| objective);
        self.left = wanted.into();
        Ok(())
    }
}

impl UseCase for CalibrateJob {
    type Output = CalibrateOutput;

    fn kind(&self) -> &'static str {
        "calibrate"
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<CalibrateOutput>, JobError> {
        let input = &self.input;
        if let (State::Calibrate(_), Some(objective)) = (&self.state, self.left.front())
            && !work.is_in(&objective.id)?
        {
            self.state = State::Next;
        }
        match &mut self.state {
            State::Begin => {
                self.plan(work)?;
                self.state = State::Next;
            }
            State::Next => {
                // What fails from now on goes back to where this one began.
                work.scope().command_begins();
                if let Some(switching) = self.next_switching(work)? {
                    self.state = State::Switch(Box::new(switching));
                    return Ok(Progress::Continue);
                }
                let Some(objective) = self.left.front() else {
                    // A step of its own: one that is made again after a kill keeps nothing twice.
                    if self.whole(work) {
                        return Ok(Progress::Continue);
                    }
                    return Ok(Progress::Done(CalibrateOutput {
                        made: std::mem::take(&mut self.made),
                        switching: std::mem::take(&mut self.switched),
                        together: self.together.take(),
                    }));
                };
                let (focus, vision) = (input.focus.clone(), input.vision.clone());
                let bring = Bring::new(objective.id.clone(), focus, vision);
                self.state = State::Bring(Box::new(bring));
            }
            State::Bring(bring) => {
                if let (Progress::Done(_), Some(objective)) =
                    (work.step(&mut **bring)?, self.left.front())
                {
                    let (options, vision) = (input.calibrate.clone(), input.vision.clone());
                    if self.made.is_empty() {
                        // A unit that is wrong by a thousand, before a step that leans on it.
                        first_step(work.scope(), &vision)?;
                    }
                    let calibrate = Calibrate::new(objective.clone(), options, vision);
                    let event = Event::PhaseStarted {
                        phase: Phase::Calibrate,
                        objective: objective.id.clone(),
                    };
                    let time_s = work.scope().clock().now().seconds();
                    work.sink().event(Stamped { time_s, event });
                    self.state = State::Calibrate(Box::new(calibrate));
                }
            }
            State::Calibrate(calibrate) => {
                if let Progress::Done(calibration) = work.step(&mut **calibrate)? {
                    // Before it is kept: those before it stay, and one of them may be the wrong one.
                    let before: Vec<&Calibration> =
                        self.made.iter().map(|m| &m.calibration).collect();
                    agree(work.scope().gate().objectives(), &before, &calibration)?;
                    self.alone.extend(calibrate.alone(&calibration));
                    self.made.push(work.keep_calibration(calibration));
                    self.left.pop_front();
                    self.state = State::Next;
                }
            }
            State::Switch(switching) => {
                if let Progress::Done(report) = work.step(&mut **switching)? {
                    work.keep(Kept::Switching(Box::new(report.clone())));
                    self.switched.push(report);
                    self.state = State::Next;
                }
            }
        }
        Ok(Progress::Continue)
    }
}

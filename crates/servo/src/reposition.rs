//! Algorithm 1 whole: from wherever the microscope stands to the saved view, with the answer arrived, not found or
//! refused.

use crate::event::tell;
use crate::procedure::{Procedure, Progress};
use crate::target::{MIN_TARGET_FEATURES, rival_in_words};
use crate::{
    Bring, Calibrate, CalibrateOptions, Calibration, Engine, Event, FocusOptions, Phase, Servo,
    ServoEnd, ServoError, ServoOptions, ServoTask, Sink, Target, VisionOptions,
};
use scopeservo_scope::{Instrument, ObjectiveId, ScopeError};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Settings of a run.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RepositionOptions {
    /// How to look.
    pub vision: VisionOptions,
    /// How to focus.
    pub focus: FocusOptions,
    /// How to calibrate.
    pub calibrate: CalibrateOptions,
    /// How to servo.
    pub servo: ServoOptions,
}

/// The three answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The saved view is back, checked on its own frames.
    Arrived,
    /// The saved view was not seen.
    NotFound,
    /// Something needed could not be done; nothing is claimed.
    Refused,
    /// The saved view was seen, and so was another place that looks like it; nothing is claimed.
    Ambiguous,
}

/// Why a run ended, for programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// The view is back.
    Converged,
    /// The target has too little texture to come back to.
    BlankTarget,
    /// No focus: nothing to see at the start.
    NoFocus,
    /// Another objective is in the beam than the one that was asked for, or it could not be seen which.
    WrongObjective,
    /// Calibration had too little to see or was implausible.
    CalibrationFailed,
    /// The target is not in the view.
    TargetNotInView,
    /// The iterations ran out.
    IterationLimit,
    /// The error grew.
    Diverged,
    /// The way leads outside the limits, or past another rule of the motion gate.
    OutsideLimits,
    /// The place is back, but the stage has no axis for the angle that is left.
    CannotTurn,
    /// Another place looks the same.
    Ambiguous,
    /// The stage moved, and nothing in the picture did: stuck, or all of it is on the camera.
    NothingMoves,
    /// What agrees with the target was not seen to move with the specimen.
    Unproven,
    /// The view does not rest.
    Drifting,
}

/// What happened at one magnification.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MagnificationResult {
    /// The objective.
    pub objective: ObjectiveId,
    /// Its magnification.
    pub magnification: f64,
    /// How the loop ended there.
    pub end: ServoEnd,
    /// The calibration used.
    pub calibration: Calibration,
}

/// The answer of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// The answer.
    pub verdict: Verdict,
    /// Why, for programs.
    pub reason: Reason,
    /// Why, for people.
    pub message: String,
    /// Last measured distance with its uncertainty added in quadrature, um.
    pub estimated_error_um: Option<f64>,
    /// Last measured angle, degrees.
    pub estimated_error_deg: Option<f64>,
    /// Width and height of the widest view, um on the specimen: what looks the same farther away could not be seen.
    #[serde(default)]
    pub unique_within_um: Option<[f64; 2]>,
    /// Every magnification that was servoed, in order.
    pub magnifications: Vec<MagnificationResult>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum State {
    Begin,
    Bring(Box<Bring>),
    Calibrate(Box<Calibrate>),
    Servo(Box<Servo>),
}

/// Algorithm 1 as a step machine. Serialise it between two steps to continue after a kill.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reposition {
    options: RepositionOptions,
    /// Kept apart from the state, which is small and written often; [`Reposition::with_target`] gives it back.
    #[serde(skip)]
    target: Option<Arc<Target>>,
    /// Size of a pixel of a target from another microscope, um.
    #[serde(default)]
    foreign_um_per_px: Option<f64>,
    /// Objectives still to visit, and whether to servo there; the first is for K_t alone.
    legs: Vec<(ObjectiveId, bool)>,
    state: State,
    calibrations: BTreeMap<ObjectiveId, Calibration>,
    /// Objectives whose calibration was known before the run.
    #[serde(default)]
    known: BTreeSet<ObjectiveId>,
    done: Vec<MagnificationResult>,
}

impl Reposition {
    /// A run that brings `target` back.
    pub fn new(target: impl Into<Arc<Target>>, options: RepositionOptions) -> Self {
        Self {
            options,
            target: Some(target.into()),
            foreign_um_per_px: None,
            legs: Vec::new(),
            state: State::Begin,
            calibrations: BTreeMap::new(),
            known: BTreeSet::new(),
            done: Vec::new(),
        }
    }

    /// Gives a stored run its target back.
    #[must_use]
    pub fn with_target(mut self, target: impl Into<Arc<Target>>) -> Self {
        self.target = Some(target.into());
        self
    }

    /// The target was taken by another microscope, where a pixel has this size on the specimen.
    #[must_use]
    pub fn with_foreign_scale(mut self, um_per_px: f64) -> Self {
        self.foreign_um_per_px = Some(um_per_px);
        self
    }

    fn target(&self) -> Result<Arc<Target>, ServoError> {
        let lacks = || ServoError::BadOption("a stored run needs its target".into());
        self.target.clone().ok_or_else(lacks)
    }

    /// K_t: the newest calibration of the target's objective, with the pixels of the camera that took it.
    fn target_calibration(&self, target: &Target) -> Option<Calibration> {
        let here = self.calibrations.get(&target.objective)?.clone();
        Some(match self.foreign_um_per_px {
            None => here,
            Some(um_per_px) => here.with_um_per_px(um_per_px),
        })
    }

    /// Takes calibrations that are known already: those objectives are not calibrated on the way.
    #[must_use]
    pub fn with_calibrations(
        mut self,
        known: impl IntoIterator<Item = (ObjectiveId, Calibration)>,
    ) -> Self {
        for (objective, calibration) in known {
            self.known.insert(objective.clone());
            self.calibrations.insert(objective, calibration);
        }
        self
    }

    /// The calibrations that were made on the way, the newest of each objective: worth keeping, however the run ends.
    pub fn calibrations_made(&self) -> impl Iterator<Item = (&ObjectiveId, &Calibration)> {
        let made = self.calibrations.iter();
        made.filter(|(objective, _)| !self.known.contains(*objective))
    }

    /// Algorithm 1, lines 2 and 6: the target's objective first, for K_t, unless that is known; then every objective up to the
    /// target's, from the lowest magnification on.
    fn plan(&mut self, scope: &Instrument) -> Result<(), ServoError> {
        let last = scope.objective(&self.target()?.objective)?.clone();
        let mut ladder: Vec<_> = scope
            .gate()
            .objectives()
            .iter()
            .filter(|o| o.id == last.id || o.magnification < last.magnification)
            .collect();
        ladder.sort_by(|a, b| a.magnification.total_cmp(&b.magnification));
        self.legs = ladder.iter().map(|o| (o.id.clone(), true)).collect();
        if self.legs.len() > 1 && !self.calibrations.contains_key(&last.id) {
            self.legs.insert(0, (last.id, false));
        }
        Ok(())
    }

    fn enter(&self, scope: &Instrument, sink: &mut dyn Sink, phase: Phase) {
        if let Some((objective, _)) = self.legs.first() {
            let objective = objective.clone();
            tell(scope, sink, Event::PhaseStarted { phase, objective });
        }
    }

    fn advance(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Option<Outcome>, ServoError> {
        let target = self.target()?;
        if let State::Begin = self.state {
            self.plan(scope)?;
            let engine = Engine::current();
            let event = Event::Started {
                objectives: self
                    .legs
                    .iter()
                    .filter(|l| l.1)
                    .map(|l| l.0.clone())
                    .collect(),
                target_objective: target.objective.clone(),
                engine: engine.name,
                cpu_level: engine.cpu_level,
            };
            tell(scope, sink, event);
            let features = target.features.len();
            if features < MIN_TARGET_FEATURES && target.moved.is_none() {
                let message = format!(
                    "the target has {features} features and at least {MIN_TARGET_FEATURES} are needed to recognise it: \
                     save a view with more tissue in focus"
                );
                return Ok(Some(self.outcome(
                    Verdict::Refused,
                    Reason::BlankTarget,
                    message,
                )));
            }
            self.state = self.bring();
            return Ok(None);
        }
        let Some((objective, servo_here)) = self.legs.first().cloned() else {
            return Err(ServoError::BadOption(
                "this run has ended already; start a new one".into(),
            ));
        };
        // A run that goes on after a kill may find another objective than it left, or one that nobody has looked at.
        if matches!(self.state, State::Calibrate(_) | State::Servo(_))
            && (scope.gate().current_objective()?.as_ref() != Some(&objective)
                || scope.gate().objective_is_reported())
        {
            self.state = self.bring();
            return Ok(None);
        }
        let target_calibration = self.target_calibration(&target);
        match &mut self.state {
            State::Begin => {}
            State::Bring(bring) => {
                if let Progress::Done(_) = bring.step(scope, sink)? {
                    if servo_here && self.known.contains(&objective) {
                        self.enter(scope, sink, Phase::Servo);
                        self.state = State::Servo(Box::default());
                        return Ok(None);
                    }
                    let calibrate = Calibrate::new(
                        scope.objective(&objective)?.clone(),
                        self.options.calibrate.clone(),
                        self.options.vision.clone(),
                    );
                    self.enter(scope, sink, Phase::Calibrate);
                    self.state = State::Calibrate(Box::new(calibrate));
                }
            }
            State::Calibrate(calibrate) => {
                if let Progress::Done(calibration) = calibrate.step(scope, sink)? {
                    self.calibrations.insert(objective, calibration);
                    if servo_here {
                        self.enter(scope, sink, Phase::Servo);
                        self.state = State::Servo(Box::default());
                    } else {
                        self.next_leg();
                    }
                }
            }
            State::Servo(servo) => {
                let missing = || {
                    ServoError::BadOption("a stored run lacks a calibration; start it anew".into())
                };
                // After the last leg's calibration K_t is the newer of its two measurements.
                let task = ServoTask {
                    target: &target,
                    view_calibration: self.calibrations.get(&objective).ok_or_else(missing)?,
                    target_calibration: target_calibration.as_ref().ok_or_else(missing)?,
                    vision: &self.options.vision,
                    options: &self.options.servo,
                    law: None,
                };
                if let Progress::Done(end) = servo.step(&task, scope, sink)? {
                    self.done.push(MagnificationResult {
                        magnification: scope.objective(&objective)?.magnification,
                        calibration: task.view_calibration.clone(),
                        objective,
                        end: end.clone(),
                    });
                    let seen = servo.seen();
                    return Ok(self.after_servo(end, seen));
                }
            }
        }
        Ok(None)
    }

    /// The beginning of the leg that comes; without one the run is over.
    fn bring(&self) -> State {
        match self.legs.first() {
            Some((objective, _)) => State::Bring(Box::new(Bring::new(
                objective.clone(),
                Some(self.options.focus.clone()),
                self.options.vision.clone(),
            ))),
            None => State::Begin,
        }
    }

    fn next_leg(&mut self) {
        self.legs.remove(0);
        self.state = self.bring();
    }

    /// The answer when a loop's end is the run's end. A target that was seen and lost again may be seen better by the next objective.
    fn after_servo(&mut self, end: ServoEnd, seen: bool) -> Option<Outcome> {
        let at = self.done.last().map_or(0.0, |d| d.magnification);
        match end {
            ServoEnd::Converged(_) if self.legs.len() > 1 => {
                self.next_leg();
                None
            }
            ServoEnd::Lost(_) if seen && self.legs.len() > 1 => {
                self.next_leg();
                None
            }
            ServoEnd::Converged(result)
                if result.error.angle_deg().abs() - 2.0 * result.sigma_deg
                    > self.options.servo.angle_deg.max(0.02) =>
            {
                let message = format!(
                    "the place is back, {:.2} um off, but {:.3} deg are left and this stage cannot turn: turn the specimen \
                     by hand and try again",
                    result.error.distance_um(),
                    result.error.angle_deg()
                );
                Some(self.outcome(Verdict::Refused, Reason::CannotTurn, message))
            }
            ServoEnd::Converged(result) => {
                let message = format!(
                    "the saved view is back, {:.2} um and {:.4} deg off by its own measurement",
                    result.error.distance_um(),
                    result.error.angle_deg().abs()
                );
                Some(self.outcome(Verdict::Arrived, Reason::Converged, message))
            }
            ServoEnd::Lost(reason) => {
                let advice = if self.done.len() > 1 {
                    "It was seen at a lower magnification, so look for a bubble, poor focus or a slipping stage"
                } else {
                    "Bring the specimen so that the place lies in the field at the lowest magnification"
                };
                let message = format!(
                    "the saved view was not found at {at}x: {reason}. {advice}, and try again"
                );
                Some(self.outcome(Verdict::NotFound, Reason::TargetNotInView, message))
            }
            ServoEnd::IterationLimit(result) => {
                let message = format!(
                    "at {at}x the view was still {:.2} um off after {} iterations; raise the limit or lambda, or look for \
                     vibration",
                    result.error.distance_um(),
                    result.iterations
                );
                Some(self.outcome(Verdict::Refused, Reason::IterationLimit, message))
            }
            ServoEnd::Ambiguous { rival, um_per_px } => {
                let message = format!(
                    "at {at}x another place looks just like the saved view, {} away, and which is which could not be told: save a view \
                     with something that is there only once, a defect or an edge",
                    rival_in_words(&rival, Some(um_per_px))
                );
                Some(self.outcome(Verdict::Ambiguous, Reason::Ambiguous, message))
            }
            ServoEnd::NothingMoves { moved_um } => {
                let message = format!(
                    "at {at}x the stage moved by {moved_um:.1} um, and nothing in the picture moved with it: the stage is stuck, or all that \
                     agrees with the saved view is on the camera (dust, a reticle, burnt-in text)"
                );
                Some(self.outcome(Verdict::Refused, Reason::NothingMoves, message))
            }
            ServoEnd::Unproven(_) => {
                let message = format!(
                    "at {at}x the picture agrees with the saved view, but too little of what agrees was seen to move with the specimen: the \
                     rest may be on the camera. Clean it, or save a view with more tissue"
                );
                Some(self.outcome(Verdict::Refused, Reason::Unproven, message))
            }
            ServoEnd::Drifting { um_per_s, .. } => {
                let message = format!(
                    "the view drifts by {um_per_s:.2} um per second while the stage stands: wait until it rests, and look for what slips or \
                     warms up, then try again"
                );
                Some(self.outcome(Verdict::Refused, Reason::Drifting, message))
            }
            ServoEnd::Diverged(result) => {
                let message = format!(
                    "at {at}x the view moved away, to {:.0} um, and the run was stopped: calibrate again and check that \
                     nothing slips",
                    result.error.distance_um()
                );
                Some(self.outcome(Verdict::Refused, Reason::Diverged, message))
            }
        }
    }

    fn outcome(&self, verdict: Verdict, reason: Reason, message: String) -> Outcome {
        let last = self.done.last().and_then(|d| d.end.result());
        Outcome {
            verdict,
            reason,
            message,
            estimated_error_um: last.map(|r| f64::hypot(r.error.distance_um(), r.sigma_um)),
            estimated_error_deg: last.map(|r| r.error.angle_deg().abs()),
            unique_within_um: self.done.first().map(|widest| {
                let size = widest.calibration.image_size_px;
                size.map(|px| px as f64 * widest.calibration.um_per_px())
            }),
            magnifications: self.done.clone(),
        }
    }

    /// Turns what the method or the limits refuse into an answer; faults and interruptions stay errors.
    fn answer(&self, error: ServoError) -> Result<Outcome, ServoError> {
        match Reason::of(&error) {
            Some(reason) => Ok(self.outcome(Verdict::Refused, reason, error.to_string())),
            None => Err(error),
        }
    }
}

impl Reason {
    /// The reason why a run that ends with this error is refused; `None` for a fault or an interruption.
    pub fn of(error: &ServoError) -> Option<Self> {
        Some(match error {
            ServoError::NoFocus { .. } => Reason::NoFocus,
            ServoError::PoorTarget { .. } => Reason::BlankTarget,
            ServoError::NothingMoves { .. } => Reason::NothingMoves,
            ServoError::Repeats { .. } => Reason::Ambiguous,
            ServoError::WrongObjective { .. }
            | ServoError::ObjectiveUnclear { .. }
            | ServoError::PictureStays { .. }
            | ServoError::StageTooCoarse { .. } => Reason::WrongObjective,
            ServoError::CalibrationViews { .. }
            | ServoError::CalibrationImplausible { .. }
            | ServoError::CalibrationInconsistent { .. } => Reason::CalibrationFailed,
            ServoError::Scope(
                ScopeError::OutsideLimits { .. }
                | ScopeError::StandsOutside { .. }
                | ScopeError::OutsideWorkspace { .. }
                | ScopeError::TooClose { .. }
                | ScopeError::StepTooLarge { .. }
                | ScopeError::NotRetracted { .. },
            ) => Reason::OutsideLimits,
            _ => return None,
        })
    }
}

impl Procedure for Reposition {
    type Output = Outcome;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Outcome>, ServoError> {
        let ended = match self.advance(scope, sink) {
            Ok(ended) => ended,
            Err(error) => Some(self.answer(error)?),
        };
        Ok(match ended {
            None => Progress::Continue,
            Some(outcome) => {
                self.legs.clear();
                let event = Event::Finished {
                    outcome: outcome.clone(),
                };
                tell(scope, sink, event);
                Progress::Done(outcome)
            }
        })
    }
}

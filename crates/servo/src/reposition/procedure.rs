//! The run as a step machine.

use super::{
    Ladder, Leg, LegPolicy, MagnificationResult, Outcome, Reason, Shortest, SoFar, Verdict,
};
mod ending;
mod known;
mod legs;
mod recover;
mod sharpen;
mod visit;

use super::parcentric::Beside;
use super::places::Visit;
use super::sharpening::Sharpening;
use super::{ahead, parcentric, words};
use crate::attempt::Tried;
use crate::event::tell;
use crate::procedure::{Procedure, Progress};
use crate::servo::places::MayLieAt;
use crate::servo::watch::Watch;
use crate::target::MIN_TARGET_FEATURES;
use crate::{
    Bring, Calibrate, CalibrateOptions, Calibration, Event, FeatureLocalizer, Focus, FocusOptions,
    Identify, Law, Localizer, Parcentric, Phase, PlanarPose, Remark, Servo, ServoError,
    ServoOptions, ServoTask, Sink, SwitchingReport, Target, VisionOptions,
};
use scopeservo_scope::{Immersion, Instrument, ObjectiveId};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// Settings of a run.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RepositionOptions {
    /// How to look.
    pub vision: VisionOptions,
    /// How to focus.
    pub focus: FocusOptions,
    /// An objective that was focused since the instrument was opened goes to where that was, and no sweep is made, as in the paper's repeated
    /// runs: for a slide that was not exchanged for one of another thickness.
    pub reuse_focus: bool,
    /// How to calibrate.
    pub calibrate: CalibrateOptions,
    /// How to servo.
    pub servo: ServoOptions,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum State {
    Begin,
    Under { leg: Leg, work: Work },
    Ended,
}

/// What is under way in a leg.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Work {
    Bring(Box<Bring>),
    Calibrate(Box<Calibrate>),
    Servo(Box<Servo>),
    /// The view was less sharp than the target: the servo waits for another height.
    Focus {
        focus: Box<Focus>,
        servo: Box<Servo>,
    },
    /// Nothing was seen: is it the objective that it is said to be?
    Identify(Box<Identify>),
    /// Places where the target may lie are looked at.
    Visit,
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
    state: State,
    calibrations: BTreeMap<ObjectiveId, Calibration>,
    /// Objectives whose calibration was known before the run.
    #[serde(default)]
    known: BTreeSet<ObjectiveId>,
    /// What is known of the nosepiece.
    #[serde(default)]
    switchings: Vec<SwitchingReport>,
    /// Where objectives look beside each other, by calibrations that were made together.
    #[serde(default)]
    parcentric: Vec<Parcentric>,
    /// What was on the specimen at the beginning, where that was known.
    #[serde(default)]
    immersion: Option<Immersion>,
    done: Vec<MagnificationResult>,
    /// Where the stage stood when the run began.
    #[serde(default)]
    began: Option<PlanarPose>,
    /// What the moves of the legs before have shown.
    #[serde(default)]
    watch: Watch,
    /// What was seen of the instrument.
    #[serde(default)]
    remarks: Vec<Remark>,
    /// What was tried between loops.
    #[serde(default)]
    tried: Tried,
    /// What was done about a view that was less sharp than the target.
    #[serde(default)]
    sharpening: Sharpening,
    /// Where the stage stood when the last leg ended.
    #[serde(default)]
    ended_at: Option<PlanarPose>,
    /// Whether a change of objective has led where nothing is in focus, and the stage went back.
    #[serde(default)]
    came_back: bool,
    /// How the camera exposed before the run changed that.
    #[serde(default)]
    exposure_before: Option<Duration>,
    /// How the camera was exposed when the run began.
    #[serde(default)]
    exposed: Option<Duration>,
    /// A killed step may have exposed it otherwise, and written nothing down.
    #[serde(skip)]
    exposed_anyhow: bool,
    /// How it exposes since.
    #[serde(default)]
    exposes: Option<Duration>,
    /// Where the target may lie, by the last loop that did not find it.
    #[serde(default)]
    may_lie_at: Option<MayLieAt>,
    /// The places that are looked at.
    #[serde(default)]
    visit: Option<Visit>,
    /// The objective that did not tell, and where it did not.
    #[serde(default)]
    visited_from: Option<(ObjectiveId, PlanarPose)>,
}

impl Reposition {
    /// A run that brings `target` back.
    pub fn new(target: impl Into<Arc<Target>>, options: RepositionOptions) -> Self {
        Self {
            options,
            target: Some(target.into()),
            foreign_um_per_px: None,
            state: State::Begin,
            calibrations: BTreeMap::new(),
            known: BTreeSet::new(),
            switchings: Vec::new(),
            parcentric: Vec::new(),
            immersion: None,
            done: Vec::new(),
            began: None,
            watch: Watch::default(),
            remarks: Vec::new(),
            tried: Tried::default(),
            sharpening: Sharpening::default(),
            exposure_before: None,
            exposed: None,
            exposed_anyhow: false,
            exposes: None,
            ended_at: None,
            came_back: false,
            may_lie_at: None,
            visit: None,
            visited_from: None,
        }
    }

    /// Gives a stored run its target back.
    #[must_use]
    pub fn with_target(mut self, target: impl Into<Arc<Target>>) -> Self {
        self.target = Some(target.into());
        self
    }

    /// A run that another process began: what this one arrives at it has seen itself.
    #[must_use]
    pub fn after_a_kill(mut self) -> Self {
        self.exposed_anyhow = true;
        if let State::Under {
            work: Work::Servo(servo) | Work::Focus { servo, .. },
            ..
        } = &mut self.state
        {
            servo.go_on_after_a_kill();
        }
        self
    }

    fn target(&self) -> Result<Arc<Target>, ServoError> {
        let lacks = || ServoError::CannotGoOn("a stored run needs its target".into());
        self.target.clone().ok_or_else(lacks)
    }

    /// The target with all that looking for it takes.
    fn prepared(&mut self) -> Result<Arc<Target>, ServoError> {
        let target = self.target()?;
        let vision = &self.options.vision;
        let ready = match (FeatureLocalizer { vision }).prepare(&target)? {
            Cow::Borrowed(_) => return Ok(target),
            Cow::Owned(ready) => Arc::new(ready),
        };
        self.target = Some(ready.clone());
        Ok(ready)
    }

    /// Leaves the camera exposed as it was found, when the run is not stepped any more before its end: whoever goes on with it adapts it again.
    pub fn leave(&mut self, scope: &Instrument) {
        self.exposes_as_before(scope);
    }

    /// K_t: the newest calibration of the target's objective, with the pixels of the camera that took it.
    fn target_calibration(&self, target: &Target) -> Option<Calibration> {
        let here = self.calibrations.get(&target.objective)?.clone();
        Some(match self.foreign_um_per_px {
            None => here,
            Some(um_per_px) => here.with_um_per_px(um_per_px),
        })
    }

    /// The calibrations that were made on the way, the newest of each objective: worth keeping, however the run ends.
    pub fn calibrations_made(&self) -> impl Iterator<Item = (&ObjectiveId, &Calibration)> {
        let made = self.calibrations.iter();
        made.filter(|(objective, _)| !self.known.contains(*objective))
    }

    fn policy(&self) -> &dyn LegPolicy {
        match self.options.servo.law {
            Law::Direct => &Shortest,
            Law::Proportional => &Ladder,
        }
    }

    /// What the policy goes by.
    fn so_far<'a>(&'a self, scope: &'a Instrument, target: &'a Target) -> SoFar<'a> {
        SoFar {
            objectives: scope.gate().objectives(),
            target: &target.objective,
            target_is_calibrated: self.calibrations.contains_key(&target.objective),
            immersion: self.immersion,
            done: &self.done,
        }
    }

    fn enter(&self, scope: &Instrument, sink: &mut dyn Sink, phase: Phase, leg: &Leg) {
        let objective = leg.objective().clone();
        tell(scope, sink, Event::PhaseStarted { phase, objective });
    }

    /// Begins a leg, whatever was under way before.
    fn bring(&mut self, scope: &Instrument, leg: Leg) {
        let known =
            self.options.reuse_focus && scope.focus_positions().contains_key(leg.objective());
        let focus = (!known).then(|| self.options.focus.clone());
        self.bring_within(leg, focus);
    }

    fn bring_within(&mut self, leg: Leg, focus: Option<FocusOptions>) {
        let bring = Bring::new(leg.objective().clone(), focus, self.options.vision.clone());
        let work = Work::Bring(Box::new(bring));
        self.state = State::Under { leg, work };
    }

    fn begin(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        target: &Target,
    ) -> Result<Option<Outcome>, ServoError> {
        scope.objective(&target.objective)?;
        let media = scope.gate().immersions()?;
        self.immersion = media.first().copied().filter(|_| media.len() == 1);
        self.began = Some(PlanarPose::from(&scope.gate().position()?));
        self.exposed = scope.camera().exposure().ok();
        let so_far = self.so_far(scope, target);
        let first = self.policy().next(&so_far);
        let engine = self.options.vision.engine.info();
        let event = Event::Started {
            objectives: self.policy().outlook(&so_far),
            target_objective: target.objective.clone(),
            engine: engine.name,
            cpu_level: engine.cpu_level,
        };
        tell(scope, sink, event);
        let features = target.features.len();
        if features < MIN_TARGET_FEATURES && target.moved.is_none() {
            let message = words::blank_target(features);
            return Ok(Some(self.outcome(
                Verdict::Refused,
                Reason::BlankTarget,
                message,
            )));
        }
        if let Some(leg) = first {
            self.bring(scope, leg);
        }
        Ok(None)
    }

    fn advance(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Option<Outcome>, ServoError> {
        let target = self.prepared()?;
        // Under direct control all objectives after this one may take over.
        let above = match self.options.servo.law {
            Law::Direct => self.policy().outlook(&self.so_far(scope, &target)),
            Law::Proportional => Vec::new(),
        };
        let centres_hold = parcentric::centres_hold(&self.done);
        // After the last leg's calibration K_t is the newer of its two measurements.
        let target_calibration = self.target_calibration(&target);
        let (leg, work) = match &mut self.state {
            State::Begin => return self.begin(scope, sink, &target),
            State::Under { leg, work } => (leg.clone(), work),
            State::Ended => {
                return Err(cannot_go_on("this run has ended already; start a new one"));
            }
        };
        // A run that goes on after a kill may find another objective than it left, or one that nobody has looked at.
        if !matches!(work, Work::Bring(_) | Work::Visit)
            && (scope.gate().current_objective()?.as_ref() != Some(leg.objective())
                || scope.gate().objective_is_reported())
        {
            self.bring(scope, leg);
            return Ok(None);
        }
        match work {
            Work::Bring(bring) => {
                if let Progress::Done(_) = bring.step(scope, sink)? {
                    self.brought(scope, sink, leg)?;
                }
                Ok(None)
            }
            Work::Calibrate(calibrate) => {
                if let Progress::Done(calibration) = calibrate.step(scope, sink)? {
                    self.calibrated(scope, sink, (leg, calibration), &target);
                }
                Ok(None)
            }
            Work::Servo(servo) => {
                let missing = || cannot_go_on("a stored run lacks a calibration; start it anew");
                let here = self.calibrations.get(leg.objective());
                let here = here.ok_or_else(missing)?;
                let at_target = target_calibration.as_ref().ok_or_else(missing)?;
                let trusted = centres_hold.then_some(&self.calibrations);
                let beside = Beside::of(&self.switchings, &self.parcentric, trusted);
                let hand_overs = ahead::hand_overs(scope, &above, &beside, (here, at_target));
                let task = ServoTask {
                    target: &target,
                    view_calibration: here,
                    target_calibration: at_target,
                    hand_overs: &hand_overs,
                    vision: &self.options.vision,
                    options: &self.options.servo,
                    law: None,
                    localizer: None,
                };
                let Progress::Done(end) = servo.step(&task, scope, sink)? else {
                    self.sharpens(scope, sink)?;
                    return Ok(None);
                };
                let seen = servo.seen();
                self.may_lie_at = servo.may_lie_at().cloned();
                self.watch = servo.watch().clone();
                self.remarks.extend(self.watch.remarks());
                self.done.push(MagnificationResult {
                    magnification: scope.objective(leg.objective())?.magnification,
                    calibration: task.view_calibration.clone(),
                    objective: leg.objective().clone(),
                    end: end.clone(),
                });
                self.ended_at = Some(PlanarPose::from(&scope.gate().position()?));
                self.go_back(scope, &end)?;
                self.servoed(scope, sink, &target, (leg, &end), seen)
            }
            Work::Focus { focus, .. } => {
                let ended = focus.step(scope, sink);
                self.focused(scope, sink, ended)
            }
            Work::Identify(identify) => {
                let seen = identify.step(scope, sink);
                self.looked_at(scope, sink, leg.objective(), seen)
            }
            Work::Visit => self.visited(scope, sink, &target, leg),
        }
    }
}

fn cannot_go_on(why: &str) -> ServoError {
    ServoError::CannotGoOn(why.into())
}

impl Procedure for Reposition {
    type Output = Outcome;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Outcome>, ServoError> {
        let exposed = self.exposes_as_adapted(scope);
        let ended = match exposed.and_then(|()| self.advance(scope, sink)) {
            Ok(ended) => ended,
            Err(error) => self.failed(scope, sink, error)?,
        };
        Ok(match ended {
            None => Progress::Continue,
            Some(outcome) => {
                self.state = State::Ended;
                self.exposes_as_before(scope);
                let event = Event::Finished {
                    outcome: outcome.clone(),
                };
                tell(scope, sink, event);
                Progress::Done(outcome)
            }
        })
    }
}

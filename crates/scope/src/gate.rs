//! The motion gate: the one way to move a stage or turn a nosepiece. It refuses with a reason, and never clips.

use crate::judge::{Judge, at_most};
use crate::knowledge::Knowledge;
use crate::{
    Axis, AxisInfo, AxisRange, CancelToken, ChangeRule, ErrorKind, GateEvent, Motion, Nosepiece,
    Objective, ObjectiveId, Observer, PositiveZ, Rules, ScopeError, Stage, StageInfo, StagePose,
};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard};

/// A height that is this much nearer to the specimen is still the one that a rule names, however the stage scatters: 1 um.
const SAME_HEIGHT_M: f64 = 1e-6;

/// A stage that stands where the nosepiece may not turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AtWork {
    /// Its height, m.
    pub here_m: f64,
    /// From where on the nosepiece may turn, m.
    pub retracted_m: f64,
    /// Where to go for that: farther by what z may miss, m.
    pub retreat_m: f64,
}

/// What the stage was sent on.
#[derive(Debug, Clone, Copy)]
enum Way {
    /// A move.
    Between { from: StagePose, to: StagePose },
    /// To its reference, wherever that is.
    Homing,
}

/// Stage and nosepiece behind their rules. There is no way to move an [`crate::Instrument`] but through this type: a request is
/// carried out whole, or refused whole with the reason.
///
/// What is checked is still true when the move begins: checking and beginning happen under one lock, for stage and nosepiece
/// together. Stopping never waits for it, and what begins while somebody stops is stopped as well.
pub struct MotionGate {
    stage: Box<dyn Stage>,
    nosepiece: Box<dyn Nosepiece>,
    rules: Rules,
    /// Limits for all objectives, one for each axis that the stage has.
    ranges: Vec<AxisRange>,
    begin: Mutex<()>,
    /// What was begun last.
    way: Mutex<Option<Way>>,
    stops: AtomicU64,
    knowledge: Knowledge,
    /// Once cancelled, nothing begins any more.
    cancel: CancelToken,
    /// That of the work under way: once cancelled, nothing of it begins any more.
    job: Mutex<Option<CancelToken>>,
    /// Is told of every command.
    observer: Mutex<Option<Observer>>,
}

impl MotionGate {
    /// Puts stage and nosepiece behind the stage's own travel and the user's rules, whichever is narrower.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] when a rule makes no sense for them, [`ScopeError::NoSuchAxis`] when it names an axis that the
    /// stage lacks.
    pub fn new(
        stage: Box<dyn Stage>,
        nosepiece: Box<dyn Nosepiece>,
        rules: Rules,
    ) -> Result<Self, ScopeError> {
        let ids: Vec<ObjectiveId> = nosepiece
            .objectives()
            .iter()
            .map(|o| o.id.clone())
            .collect();
        let ranges = rules.ranges(stage.info(), &ids)?;
        let knowledge = Knowledge::new(nosepiece.known_by());
        Ok(Self {
            stage,
            nosepiece,
            rules,
            ranges,
            begin: Mutex::new(()),
            way: Mutex::new(None),
            stops: AtomicU64::new(0),
            knowledge,
            cancel: CancelToken::new(),
            job: Mutex::new(None),
            observer: Mutex::new(None),
        })
    }

    /// From now on nothing begins after `cancel` was cancelled.
    pub(crate) fn obey(&mut self, cancel: CancelToken) {
        self.cancel = cancel;
    }

    /// The token that ends everything.
    pub(crate) fn own_token(&self) -> &CancelToken {
        &self.cancel
    }

    pub(crate) fn job_mut(&self) -> MutexGuard<'_, Option<CancelToken>> {
        self.job.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// Whether a stop was asked for, of everything or of the work under way.
    pub(crate) fn is_cancelled(&self) -> bool {
        let job = || self.job_mut().as_ref().is_some_and(|j| j.is_cancelled());
        self.cancel.is_cancelled() || job()
    }

    /// From now on `observer` is told of every command; nobody with `None`. See [`Observer`] for what it may do.
    pub fn observe(&self, observer: Option<Observer>) {
        *self.observer.lock().unwrap_or_else(|e| e.into_inner()) = observer;
    }

    fn tell(&self, event: impl FnOnce() -> GateEvent) {
        let observer = self.observer.lock();
        let observer = observer.unwrap_or_else(|e| e.into_inner()).clone();
        if let Some(observer) = observer {
            observer(event());
        }
    }

    /// What the stage is.
    pub fn info(&self) -> &StageInfo {
        self.stage.info()
    }

    /// The rules in force.
    pub fn rules(&self) -> &Rules {
        &self.rules
    }

    /// The limits for all objectives, one for each axis that the stage has.
    pub fn ranges(&self) -> &[AxisRange] {
        &self.ranges
    }

    /// The objectives there are.
    pub fn objectives(&self) -> &[Objective] {
        self.nosepiece.objectives()
    }

    /// The objective in the beam; `None` while turning or unknown, and after a picture has contradicted what is reported.
    pub fn current_objective(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        let told = self.nosepiece.current()?;
        Ok(told.filter(|_| !self.knowledge.is_contradicted()))
    }

    /// Whether the objective in the beam is only reported: no sensor tells, and no picture has borne it out.
    pub fn objective_is_reported(&self) -> bool {
        self.knowledge.is_reported()
    }

    /// A picture has shown that the objective in the beam is the one that [`MotionGate::current_objective`] tells.
    pub fn confirm_objective(&self) {
        self.knowledge.confirm();
    }

    /// A picture has shown that it is another. Returns whether changing to it once more may help.
    pub fn contradict_objective(&self) -> bool {
        self.knowledge.contradict()
    }

    /// What the instrument has learnt.
    pub(crate) fn knowledge(&self) -> &Knowledge {
        &self.knowledge
    }

    /// Where the stage says it is, all of its axes.
    ///
    /// # Errors
    /// What the stage reports; [`ScopeError::ImpossiblePlace`] when that is where it cannot be by what it says of itself.
    pub fn position(&self) -> Result<StagePose, ScopeError> {
        let at = self.stage.position()?;
        for info in &self.info().axes {
            let axis = info.axis;
            let si = at.si(axis).unwrap_or(f64::NAN);
            let slack = info.tolerance();
            // What is no number is nowhere.
            if !(info.min - slack..=info.max + slack).contains(&si) {
                return Err(ScopeError::ImpossiblePlace {
                    axis,
                    at: axis.to_display(si),
                    min: axis.to_display(info.min),
                    max: axis.to_display(info.max),
                });
            }
        }
        Ok(at)
    }

    /// Whether the stage knows where it is.
    ///
    /// # Errors
    /// What the stage reports.
    pub fn is_homed(&self) -> Result<bool, ScopeError> {
        self.stage.is_homed()
    }

    /// What the stage is doing.
    pub fn poll(&self) -> Result<Motion, ScopeError> {
        self.stage.poll()
    }

    /// What the nosepiece is doing.
    pub fn poll_nosepiece(&self) -> Result<Motion, ScopeError> {
        let motion = self.nosepiece.poll()?;
        if motion != Motion::Moving {
            self.knowledge.change_ended(motion == Motion::Settled);
        }
        Ok(motion)
    }

    /// Stops stage and nosepiece at once, from any thread. Harmless when nothing moves.
    ///
    /// # Errors
    /// What the devices report; both were told all the same.
    pub fn stop(&self) -> Result<(), ScopeError> {
        self.stops.fetch_add(1, Ordering::SeqCst);
        self.knowledge.change_ended(false);
        // Neither waits for the other: they may be on different boards, and one may be past hearing.
        let told = std::thread::scope(|s| {
            let nosepiece = s.spawn(|| self.nosepiece.stop());
            let stage = self.stage.stop();
            let nosepiece = nosepiece.join().unwrap_or_else(|_| {
                Err(ScopeError::Device {
                    device: "nosepiece",
                    detail: "its driver broke down".into(),
                })
            });
            nosepiece.and(stage)
        });
        self.tell(|| GateEvent::Stopped {
            fault: told.as_ref().err().map(ToString::to_string),
        });
        told
    }

    /// Whether the stage may go there from where it stands, with the objective that is in the beam: limits, workspace, zones. The way
    /// there is judged when the move begins.
    ///
    /// # Errors
    /// [`ScopeError::OutsideLimits`], [`ScopeError::OutsideWorkspace`], [`ScopeError::TooClose`], [`ScopeError::StandsOutside`],
    /// [`ScopeError::NoSuchAxis`] or [`ScopeError::NotFinite`]; and those of [`MotionGate::position`].
    pub fn check(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.info().check_axes(to)?;
        let here = self.position()?;
        self.judge(&self.in_beam()?).check_goal(&here, to)
    }

    /// Whether the stage may go to each of these places from where it stands, as [`MotionGate::check`] tells. The devices are asked
    /// once.
    ///
    /// # Errors
    /// What the devices report, and those of [`MotionGate::position`].
    pub fn allowed(&self, places: &[StagePose]) -> Result<Vec<bool>, ScopeError> {
        let here = self.position()?;
        let in_beam = self.in_beam()?;
        let may = |to: &StagePose| {
            let goal = self.judge(&in_beam).check_goal(&here, to);
            self.info().check_axes(to).and(goal).is_ok()
        };
        Ok(places.iter().map(may).collect())
    }

    /// Whether the last move that was begun ended where it was sent, and the whole stage stands where it may; after homing, whether the
    /// stage knows where it is, and that is a place where it can be. To be asked when the stage has settled. Returns where it says it is. This is the one place that judges arrivals, of all drivers.
    ///
    /// # Errors
    /// [`ScopeError::NotArrived`], [`ScopeError::Strayed`], [`ScopeError::Device`] for a reference that was not found, and those of
    /// [`MotionGate::position`]; the stage was then told to stop.
    pub fn arrived(&self) -> Result<StagePose, ScopeError> {
        let answer = self.judge_arrival();
        if answer.is_err() {
            // Why is the news.
            let _ = self.stop();
        }
        self.tell(|| match &answer {
            Ok(at) => GateEvent::Arrived { at: *at },
            Err(why) => GateEvent::NotArrived {
                why: why.to_string(),
            },
        });
        answer
    }

    fn judge_arrival(&self) -> Result<StagePose, ScopeError> {
        let way = *self.way.lock().unwrap_or_else(|e| e.into_inner());
        if matches!(way, Some(Way::Homing)) && !self.stage.is_homed()? {
            return Err(ScopeError::Device {
                device: "stage",
                detail: "it was homed and still does not know where it is".into(),
            });
        }
        let at = self.position()?;
        let Some(Way::Between { from, to }) = way else {
            // A reference may lie outside the user's limits: from there only moves back inside begin.
            return Ok(at);
        };
        for info in &self.info().axes {
            let axis = info.axis;
            let (Some(goal), Some(there)) = (to.si(axis), at.si(axis)) else {
                continue;
            };
            if !at_most((there - goal).abs(), info.tolerance()) {
                return Err(ScopeError::NotArrived {
                    axis,
                    goal: axis.to_display(goal),
                    at: axis.to_display(there),
                });
            }
        }
        match self.judge(&self.in_beam()?).strayed(&from, &at) {
            Some(breach) => Err(ScopeError::Strayed { breach }),
            None => Ok(at),
        }
    }

    /// Starts a move if the rules allow it.
    ///
    /// # Errors
    /// Those of [`MotionGate::check`]; [`ScopeError::StepTooLarge`], [`ScopeError::Busy`] while stage or nosepiece move,
    /// [`ScopeError::NotHomed`], [`ScopeError::Interrupted`] when somebody stopped meanwhile; and what the devices report. Unless it is one of the stage's
    /// own faults, nothing moved.
    pub fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.tell(|| GateEvent::MoveAsked { to: *to });
        let begun = self.begin_move(to);
        self.tell(|| match &begun {
            Ok(()) => GateEvent::MoveBegan { to: *to },
            Err(why) => GateEvent::MoveRefused {
                to: *to,
                why: why.to_string(),
            },
        });
        begun
    }

    fn begin_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.info().check_axes(to)?;
        let _begin = self.begin();
        let stops = self.stops.load(Ordering::SeqCst);
        self.check_cancel()?;
        self.check_idle()?;
        self.check_homed()?;
        let here = self.position()?;
        let in_beam = self.in_beam()?;
        let judge = self.judge(&in_beam);
        judge.check_goal(&here, to)?;
        judge.check_way(&here, to)?;
        self.begun(self.stage.start_move(to))?;
        self.begun_way(Way::Between {
            from: here,
            to: *to,
        });
        self.stopped_meanwhile(stops)
    }

    /// Starts to find the stage's reference. This may move anything anywhere, which no rule can see beforehand: only with the user's
    /// consent. [`MotionGate::arrived`] judges where it ended.
    ///
    /// # Errors
    /// [`ScopeError::Busy`] while stage or nosepiece move, [`ScopeError::Interrupted`] when somebody stopped meanwhile;
    /// [`ScopeError::Refused`] where there is nothing to find; and what the devices report.
    pub fn start_homing(&self) -> Result<(), ScopeError> {
        let _begin = self.begin();
        let stops = self.stops.load(Ordering::SeqCst);
        self.check_cancel()?;
        self.check_idle()?;
        self.begun(self.stage.start_homing())?;
        self.begun_way(Way::Homing);
        self.stopped_meanwhile(stops)
    }

    /// Starts to change the objective if the rules allow it.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchObjective`], [`ScopeError::NotHomed`], [`ScopeError::NotRetracted`], [`ScopeError::StandsOutside`] and those of the places where the
    /// objective that comes may not be, [`ScopeError::Busy`] while stage or nosepiece move,
    /// [`ScopeError::Interrupted`] when somebody stopped meanwhile; and what the devices report.
    pub fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        let begun = self.begin_change(to);
        self.tell(|| match &begun {
            Ok(()) => GateEvent::ChangeBegan { to: to.clone() },
            Err(why) => GateEvent::ChangeRefused {
                to: to.clone(),
                why: why.to_string(),
            },
        });
        begun
    }

    fn begin_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        self.objective(to)?;
        let _begin = self.begin();
        let stops = self.stops.load(Ordering::SeqCst);
        self.check_cancel()?;
        self.check_idle()?;
        self.check_homed()?;
        if let Some(work) = self.at_work()? {
            return Err(ScopeError::NotRetracted {
                at_um: work.here_m * 1e6,
                needed_um: work.retracted_m * 1e6,
            });
        }
        let here = self.position()?;
        if let Some(breach) = self.judge(&self.in_beam()?).breach(&here) {
            return Err(ScopeError::StandsOutside { breach });
        }
        // The objective that comes must be allowed there, too.
        if let Some(breach) = self.judge(std::slice::from_ref(to)).breach(&here) {
            return Err(breach.into());
        }
        let answer = self.nosepiece.start_change(to);
        if !answer.as_ref().is_err_and(is_refusal) {
            self.knowledge.change_begun();
        }
        self.begun(answer)?;
        self.stopped_meanwhile(stops)
    }

    /// Where the stage is when the nosepiece may not turn there; `None` when it may.
    ///
    /// # Errors
    /// What the stage reports; [`ScopeError::NoSuchAxis`] when a rule names a height and the stage tells none.
    pub fn at_work(&self) -> Result<Option<AtWork>, ScopeError> {
        let ChangeRule::Retracted { z, .. } = self.rules.change else {
            return Ok(None);
        };
        let here = self.position()?.si(Axis::Z);
        let here_m = here.ok_or(ScopeError::NoSuchAxis { axis: Axis::Z })?;
        let nearer = self.positive_z().nearer_by(here_m, z);
        let clearance = self.info().axis(Axis::Z).map_or(0.0, AxisInfo::clearance);
        Ok((!at_most(nearer, SAME_HEIGHT_M)).then_some(AtWork {
            here_m,
            retracted_m: z,
            retreat_m: self.positive_z().away(z, clearance),
        }))
    }

    /// The data of one objective.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchObjective`].
    pub fn objective(&self, id: &ObjectiveId) -> Result<&Objective, ScopeError> {
        let all = self.objectives();
        all.iter()
            .find(|o| o.id == *id)
            .ok_or_else(|| ScopeError::NoSuchObjective {
                asked: id.clone(),
                available: all
                    .iter()
                    .map(|o| o.id.0.as_str())
                    .collect::<Vec<_>>()
                    .join(", "),
            })
    }

    pub(crate) fn positive_z(&self) -> PositiveZ {
        self.info().positive_z
    }

    fn begin(&self) -> MutexGuard<'_, ()> {
        // The lock guards no data: whoever panicked under it left none half written.
        self.begin.lock().unwrap_or_else(|e| e.into_inner())
    }

    fn check_cancel(&self) -> Result<(), ScopeError> {
        match self.is_cancelled() {
            true => Err(ScopeError::Interrupted { at: None }),
            false => Ok(()),
        }
    }

    fn check_idle(&self) -> Result<(), ScopeError> {
        let idle = |motion: Motion, device| match motion {
            Motion::Moving => Err(ScopeError::Busy { device }),
            Motion::Settled | Motion::Stopped => Ok(()),
        };
        idle(self.nosepiece.poll()?, "nosepiece")?;
        idle(self.stage.poll()?, "stage")
    }

    /// Of a stage that does not know where it is nobody knows what a move would do, nor how far it is from the specimen.
    fn check_homed(&self) -> Result<(), ScopeError> {
        match self.stage.is_homed()? {
            true => Ok(()),
            false => Err(ScopeError::NotHomed { device: "stage" }),
        }
    }

    fn begun_way(&self, way: Way) {
        *self.way.lock().unwrap_or_else(|e| e.into_inner()) = Some(way);
    }

    /// A device that failed to begin may have begun in part: what moves is stopped. A refusal moved nothing.
    fn begun(&self, answer: Result<(), ScopeError>) -> Result<(), ScopeError> {
        if answer.as_ref().is_err_and(|e| !is_refusal(e)) {
            // Its own fault is the news.
            let _ = self.stop();
        }
        answer
    }

    /// A stop that came between the check and the beginning of a move may have found nothing to stop.
    fn stopped_meanwhile(&self, stops: u64) -> Result<(), ScopeError> {
        if self.stops.load(Ordering::SeqCst) == stops && !self.is_cancelled() {
            return Ok(());
        }
        self.stop()?;
        Err(ScopeError::Interrupted { at: None })
    }

    fn judge<'a>(&'a self, in_beam: &'a [ObjectiveId]) -> Judge<'a> {
        Judge {
            info: self.info(),
            rules: &self.rules,
            ranges: &self.ranges,
            in_beam,
        }
    }

    /// Whether a rule depends on the objective.
    fn narrows(&self) -> bool {
        !self.rules.objective_limits.is_empty() || !self.rules.zones.is_empty()
    }

    /// Objectives that may be in the beam: all of them when nobody knows, or it is only reported.
    fn in_beam(&self) -> Result<Vec<ObjectiveId>, ScopeError> {
        if !self.narrows() {
            // Nobody asks.
            return Ok(Vec::new());
        }
        let told = self.current_objective()?;
        Ok(match told.filter(|_| !self.objective_is_reported()) {
            Some(id) => vec![id],
            None => self.objectives().iter().map(|o| o.id.clone()).collect(),
        })
    }
}

fn is_refusal(error: &ScopeError) -> bool {
    error.kind() == ErrorKind::Refused
}

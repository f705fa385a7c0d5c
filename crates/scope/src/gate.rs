//! The motion gate: the one way to move a stage or turn a nosepiece. It refuses with a reason, and never clips.

use crate::rules::narrowed;
use crate::{
    Axis, AxisRange, CancelToken, ChangeRule, ErrorKind, Motion, Nosepiece, Objective, ObjectiveId,
    PositiveZ, Rules, ScopeError, Stage, StageInfo, StagePose, Workspace, Zone,
};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard};

/// Two heights nearer to each other than this are the same: 1 um.
const SAME_HEIGHT_M: f64 = 1e-6;

/// A stage that stands where the nosepiece may not turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AtWork {
    /// Its height, m.
    pub here_m: f64,
    /// From where on the nosepiece may turn, m.
    pub retracted_m: f64,
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
    stops: AtomicU64,
    /// Once cancelled, nothing begins any more.
    cancel: CancelToken,
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
        Ok(Self {
            stage,
            nosepiece,
            rules,
            ranges,
            begin: Mutex::new(()),
            stops: AtomicU64::new(0),
            cancel: CancelToken::new(),
        })
    }

    /// From now on nothing begins after `cancel` was cancelled.
    pub(crate) fn obey(&mut self, cancel: CancelToken) {
        self.cancel = cancel;
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

    /// The objective in the beam; `None` while turning or unknown.
    pub fn current_objective(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        self.nosepiece.current()
    }

    /// Whether only somebody's word tells which objective is in the beam.
    pub fn objective_is_unproven(&self) -> bool {
        self.nosepiece.is_unproven()
    }

    /// A picture has shown that the objective in the beam is the one that [`MotionGate::current_objective`] tells.
    pub fn prove_objective(&self) {
        self.nosepiece.prove();
    }

    /// A picture has shown that it is another. Returns whether changing to it once more may help.
    pub fn disprove_objective(&self) -> bool {
        self.nosepiece.disprove()
    }

    /// Where the stage says it is.
    pub fn position(&self) -> Result<StagePose, ScopeError> {
        self.stage.position()
    }

    /// What the stage is doing.
    pub fn poll(&self) -> Result<Motion, ScopeError> {
        self.stage.poll()
    }

    /// What the nosepiece is doing.
    pub fn poll_nosepiece(&self) -> Result<Motion, ScopeError> {
        self.nosepiece.poll()
    }

    /// Stops stage and nosepiece at once, from any thread. Harmless when nothing moves.
    ///
    /// # Errors
    /// What the devices report; both were told all the same.
    pub fn stop(&self) -> Result<(), ScopeError> {
        self.stops.fetch_add(1, Ordering::SeqCst);
        // Neither waits for the other: they may be on different boards, and one may be past hearing.
        std::thread::scope(|s| {
            let nosepiece = s.spawn(|| self.nosepiece.stop());
            let stage = self.stage.stop();
            let nosepiece = nosepiece.join().unwrap_or_else(|_| {
                Err(ScopeError::Device {
                    device: "nosepiece",
                    detail: "its driver broke down".into(),
                })
            });
            nosepiece.and(stage)
        })
    }

    /// Whether the stage may stand there, with the objective that is in the beam: limits, workspace, zones. The way there is
    /// judged when the move begins.
    ///
    /// # Errors
    /// [`ScopeError::OutsideLimits`], [`ScopeError::OutsideWorkspace`], [`ScopeError::TooClose`], [`ScopeError::NoSuchAxis`] or
    /// [`ScopeError::NotFinite`].
    pub fn check(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.check_numbers(to)?;
        let here = match self.needs_place() {
            true => self.stage.position()?,
            false => StagePose::default(),
        };
        self.check_place(&self.in_beam()?, &here, to)
    }

    /// Starts a move if the rules allow it.
    ///
    /// # Errors
    /// Those of [`MotionGate::check`], [`ScopeError::StepTooLarge`], [`ScopeError::Busy`] while stage or nosepiece move,
    /// [`ScopeError::Interrupted`] when somebody stopped meanwhile; and what the devices report. Unless it is one of the stage's
    /// own faults, nothing moved.
    pub fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.check_numbers(to)?;
        let _begin = self.begin();
        let stops = self.stops.load(Ordering::SeqCst);
        self.check_cancel()?;
        if self.nosepiece.poll()? == Motion::Moving {
            return Err(ScopeError::Busy {
                device: "nosepiece",
            });
        }
        if self.stage.poll()? == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        let here = match self.needs_place() {
            true => self.stage.position()?,
            false => StagePose::default(),
        };
        let in_beam = self.in_beam()?;
        self.check_place(&in_beam, &here, to)?;
        if self.needs_place() {
            self.check_way(&in_beam, &here, to)?;
        }
        self.begun(self.stage.start_move(to))?;
        self.stopped_meanwhile(stops)
    }

    /// Starts to change the objective if the rules allow it.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchObjective`], [`ScopeError::NotRetracted`], [`ScopeError::Busy`] while stage or nosepiece move,
    /// [`ScopeError::Interrupted`] when somebody stopped meanwhile; and what the devices report.
    pub fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        self.objective(to)?;
        let _begin = self.begin();
        let stops = self.stops.load(Ordering::SeqCst);
        self.check_cancel()?;
        if self.stage.poll()? == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        if self.nosepiece.poll()? == Motion::Moving {
            return Err(ScopeError::Busy {
                device: "nosepiece",
            });
        }
        if let Some(work) = self.at_work()? {
            return Err(ScopeError::NotRetracted {
                at_um: work.here_m * 1e6,
                needed_um: work.retracted_m * 1e6,
            });
        }
        if self.narrows() {
            // Where the stage stands the objective that comes must be allowed, too.
            let here = self.stage.position()?;
            self.check_place(std::slice::from_ref(to), &here, &here)?;
        }
        self.begun(self.nosepiece.start_change(to))?;
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
        let here = self.stage.position()?.si(Axis::Z);
        let here_m = here.ok_or(ScopeError::NoSuchAxis { axis: Axis::Z })?;
        let nearer = self.positive_z().nearer_by(here_m, z);
        let retracted = at_most(nearer, self.same_height_m());
        Ok((!retracted).then_some(AtWork {
            here_m,
            retracted_m: z,
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
        match self.cancel.is_cancelled() {
            true => Err(ScopeError::Interrupted {
                at: self.stage.position().ok(),
            }),
            false => Ok(()),
        }
    }

    /// A device that failed to begin may have begun in part: what moves is stopped. A refusal moved nothing.
    fn begun(&self, answer: Result<(), ScopeError>) -> Result<(), ScopeError> {
        if answer
            .as_ref()
            .is_err_and(|e| e.kind() != ErrorKind::Refused)
        {
            // Its own fault is the news.
            let _ = self.stop();
        }
        answer
    }

    /// Two heights nearer to each other than this are the same.
    fn same_height_m(&self) -> f64 {
        let scatter = self.info().axis(Axis::Z).map_or(0.0, |z| z.repeatability);
        SAME_HEIGHT_M.max(4.0 * scatter)
    }

    /// A stop that came between the check and the beginning of a move may have found nothing to stop.
    fn stopped_meanwhile(&self, stops: u64) -> Result<(), ScopeError> {
        if self.stops.load(Ordering::SeqCst) == stops && !self.cancel.is_cancelled() {
            return Ok(());
        }
        self.stop()?;
        Err(ScopeError::Interrupted {
            at: self.stage.position().ok(),
        })
    }

    /// Whether a rule looks at more than the axes that are asked to move.
    fn needs_place(&self) -> bool {
        self.narrows()
            || self.rules.workspace != Workspace::Box
            || !self.rules.largest_steps.is_empty()
    }

    /// Whether a rule depends on the objective.
    fn narrows(&self) -> bool {
        !self.rules.objective_limits.is_empty() || !self.rules.zones.is_empty()
    }

    fn check_numbers(&self, to: &StagePose) -> Result<(), ScopeError> {
        for axis in Axis::ALL {
            let Some(asked) = to.si(axis) else { continue };
            if self.info().axis(axis).is_none() {
                return Err(ScopeError::NoSuchAxis { axis });
            }
            if !asked.is_finite() {
                return Err(ScopeError::NotFinite { axis });
            }
        }
        Ok(())
    }

    /// Objectives that may be in the beam: all of them when nobody knows, or only somebody's word tells.
    fn in_beam(&self) -> Result<Vec<ObjectiveId>, ScopeError> {
        if !self.narrows() {
            // Nobody asks.
            return Ok(Vec::new());
        }
        let told = self.nosepiece.current()?;
        Ok(match told.filter(|_| !self.nosepiece.is_unproven()) {
            Some(id) => vec![id],
            None => self.objectives().iter().map(|o| o.id.clone()).collect(),
        })
    }

    fn check_place(
        &self,
        in_beam: &[ObjectiveId],
        here: &StagePose,
        to: &StagePose,
    ) -> Result<(), ScopeError> {
        within(&self.ranges, to)?;
        // Axes that are not asked to move stand where they are; a retreat is allowed from anywhere.
        let whole = to.or(here);
        let retreat = self.retreats(here, to);
        let judged = if retreat { to } else { &whole };
        for id in in_beam {
            if let Some(limits) = self.rules.objective_limits.get(id) {
                within(&narrowed(&self.ranges, limits, self.info())?, judged)?;
            }
        }
        if self.rules.workspace == Workspace::Ellipsoid {
            let share = |axis: &crate::AxisInfo| {
                let at = whole.si(axis.axis);
                let (middle, half) = ((axis.max + axis.min) / 2.0, (axis.max - axis.min) / 2.0);
                at.map(|at| ((at - middle) / half).powi(2))
            };
            // An axis whose place is not known may be anywhere.
            let load = self
                .info()
                .axes
                .iter()
                .map(|axis| share(axis).unwrap_or(f64::INFINITY))
                .sum::<f64>()
                .sqrt();
            if !at_most(load, 1.0) {
                return Err(ScopeError::OutsideWorkspace { share: load });
            }
        }
        if retreat {
            return Ok(());
        }
        // A height that nobody knows is not known to be clear.
        let z = whole.si(Axis::Z).unwrap_or(f64::NAN);
        let [x, y] = [Axis::X, Axis::Y].map(|axis| [whole.si(axis); 2]);
        for zone in self.zones_for(in_beam) {
            if reaches(zone.x, x) && reaches(zone.y, y) {
                self.clear(zone, z)?;
            }
        }
        Ok(())
    }

    /// The axes may go one after the other, in any order: the whole box between start and goal counts.
    fn check_way(
        &self,
        in_beam: &[ObjectiveId],
        here: &StagePose,
        to: &StagePose,
    ) -> Result<(), ScopeError> {
        let retreat = self.retreats(here, to);
        for largest in &self.rules.largest_steps {
            let axis = largest.axis;
            let Some(goal) = to.si(axis) else { continue };
            let step = here
                .si(axis)
                .map_or(f64::INFINITY, |from| (goal - from).abs());
            let retreats = retreat && axis == Axis::Z;
            if !retreats && !at_most(step, largest.step) {
                return Err(ScopeError::StepTooLarge {
                    axis,
                    step: axis.to_display(step),
                    largest: axis.to_display(largest.step),
                });
            }
        }
        if retreat {
            // Away from the specimen is the way out of everything.
            return Ok(());
        }
        let whole = to.or(here);
        let from = here.si(Axis::Z).unwrap_or(f64::NAN);
        let goal = to.si(Axis::Z).unwrap_or(from);
        // Neither is known to be the nearer one when one is unknown: then it is the unknown one.
        let nearest = match self.positive_z().nearer_by(from, goal) <= 0.0 {
            true => goal,
            false => from,
        };
        let both = |axis| [here.si(axis), whole.si(axis)];
        for zone in self.zones_for(in_beam) {
            if reaches(zone.x, both(Axis::X)) && reaches(zone.y, both(Axis::Y)) {
                self.clear(zone, nearest)?;
            }
        }
        Ok(())
    }

    /// Whether a move goes away from the specimen and nowhere else: the way out of everything.
    fn retreats(&self, here: &StagePose, to: &StagePose) -> bool {
        let rests = |axis: Axis| to.si(axis).is_none_or(|goal| Some(goal) == here.si(axis));
        let mut others = Axis::ALL.into_iter().filter(|a| *a != Axis::Z);
        let heights = here.si(Axis::Z).zip(to.si(Axis::Z));
        others.all(rests)
            && heights.is_some_and(|(from, goal)| self.positive_z().nearer_by(goal, from) < 0.0)
    }

    fn zones_for<'a>(&'a self, in_beam: &'a [ObjectiveId]) -> impl Iterator<Item = &'a Zone> {
        self.rules.zones.iter().filter(move |zone| {
            zone.objectives.is_empty() || zone.objectives.iter().any(|id| in_beam.contains(id))
        })
    }

    fn clear(&self, zone: &Zone, z: f64) -> Result<(), ScopeError> {
        if at_most(self.positive_z().nearer_by(z, zone.closest_z), 0.0) {
            return Ok(());
        }
        Err(ScopeError::TooClose {
            zone: zone.name.clone(),
            z_um: z * 1e6,
            closest_um: zone.closest_z * 1e6,
        })
    }
}

/// What is no number is not known to be small.
fn at_most(value: f64, limit: f64) -> bool {
    value <= limit
}

/// Whether anything between two coordinates lies in a range; unknown ones may lie anywhere.
fn reaches(range: [f64; 2], between: [Option<f64>; 2]) -> bool {
    let [Some(a), Some(b)] = between else {
        return true;
    };
    !(a.max(b) < range[0] || a.min(b) > range[1])
}

fn within(ranges: &[AxisRange], to: &StagePose) -> Result<(), ScopeError> {
    for range in ranges {
        let Some(asked) = to.si(range.axis) else {
            continue;
        };
        if !(asked >= range.min && asked <= range.max) {
            return Err(ScopeError::OutsideLimits {
                axis: range.axis,
                asked: range.axis.to_display(asked),
                min: range.axis.to_display(range.min),
                max: range.axis.to_display(range.max),
            });
        }
    }
    Ok(())
}

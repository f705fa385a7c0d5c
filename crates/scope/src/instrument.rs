//! A whole microscope: what moves, behind its gate, camera and clock, with the waiting that every procedure needs.

use crate::{
    Absent, Axis, AxisInfo, Camera, CancelToken, ChangeRule, Clock, Devices, ErrorKind, FlatField,
    Frame, Length, Light, Motion, MotionGate, Obeying, Objective, ObjectiveId, Rules, ScopeError,
    StagePose, stand_still,
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// How often a running move is asked whether it has ended.
const POLL: Duration = Duration::from_millis(5);
/// How often one who waits for a frame looks whether a stop was asked for.
const POLL_CANCEL: Duration = Duration::from_millis(20);
/// No move of these instruments takes longer.
const MOVE_TIMEOUT: Duration = Duration::from_secs(120);
/// Nor homing.
const HOMING_TIMEOUT: Duration = Duration::from_secs(180);
/// Nor an objective change, also by somebody who has to come from next door.
const CHANGE_TIMEOUT: Duration = Duration::from_secs(1800);

/// What an instrument has done so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    /// Stage moves carried out.
    pub moves: u64,
    /// Frames grabbed.
    pub frames: u64,
    /// Objective changes carried out.
    pub objective_changes: u64,
}

/// Everything that a procedure may touch.
pub struct Instrument {
    gate: MotionGate,
    camera: Arc<dyn Camera>,
    light: Option<Box<dyn Light>>,
    clock: Arc<dyn Clock>,
    /// What lies on the camera, as far as it was seen.
    flat_field: Mutex<Option<Arc<FlatField>>>,
    /// Where the present command's first move found the stage.
    began: Mutex<Option<StagePose>>,
    moves: AtomicU64,
    frames: AtomicU64,
    objective_changes: AtomicU64,
    /// A frame that nobody waits for any more.
    given_up: Mutex<Option<std::thread::JoinHandle<()>>>,
    /// Let go last, after the devices.
    kept: Vec<Box<dyn std::any::Any + Send + Sync>>,
}

/// A driver that hangs over a frame is given so long to be noticed as such, and ended, before the instrument is gone.
const LAST_FRAME: Duration = Duration::from_secs(8);

impl Drop for Instrument {
    fn drop(&mut self) {
        let given_up = self.given_up.get_mut().ok().and_then(Option::take);
        let Some(frame) = given_up else { return };
        // A long exposure ends by itself.
        if self.camera.exposure().is_ok_and(|e| e > LAST_FRAME / 4) {
            return;
        }
        let start = std::time::Instant::now();
        while !frame.is_finished() && start.elapsed() < LAST_FRAME {
            std::thread::sleep(POLL);
        }
    }
}

impl Instrument {
    /// Puts the devices together, what moves behind a gate that keeps the rules. Of one that is missing, nothing is had. After `cancel`
    /// was cancelled nothing begins any more.
    ///
    /// # Errors
    /// Those of [`MotionGate::new`].
    pub fn new(devices: Devices, rules: Rules, cancel: CancelToken) -> Result<Self, ScopeError> {
        let none = Absent::new;
        let mut gate = MotionGate::new(
            devices.stage.unwrap_or_else(|| Box::new(none())),
            devices.nosepiece.unwrap_or_else(|| Box::new(none())),
            rules,
        )?;
        gate.obey(cancel);
        Ok(Self {
            gate,
            camera: devices.camera.unwrap_or_else(|| Box::new(none())).into(),
            light: devices.light,
            clock: devices.clock,
            flat_field: Mutex::new(None),
            began: Mutex::new(None),
            moves: AtomicU64::new(0),
            frames: AtomicU64::new(0),
            objective_changes: AtomicU64::new(0),
            given_up: Mutex::new(None),
            kept: Vec::new(),
        })
    }

    /// Keeps something for as long as the instrument is there, and lets it go after the devices: that nobody else may drive them.
    #[must_use]
    pub fn keeping(mut self, what: impl std::any::Any + Send + Sync) -> Self {
        self.kept.push(Box::new(what));
        self
    }

    /// A stop for one piece of work on this instrument: cancelling it leaves the instrument as it is for the next. Cancelling the
    /// instrument's own token cancels it as well.
    pub fn job_token(&self) -> CancelToken {
        self.gate.own_token().child()
    }

    /// From now on nothing begins after `cancel` or the instrument's own token was cancelled, until the guard is dropped: then only
    /// the instrument's own counts.
    ///
    /// # Errors
    /// [`ScopeError::Busy`] while another piece of work is under way.
    pub fn obey(&self, cancel: &CancelToken) -> Result<Obeying<'_>, ScopeError> {
        Obeying::begin(&self.gate, cancel)
    }

    /// Stage and nosepiece, behind their rules.
    pub fn gate(&self) -> &MotionGate {
        &self.gate
    }

    /// The camera.
    pub fn camera(&self) -> &dyn Camera {
        &*self.camera
    }

    /// The light, where it can be set.
    pub fn light(&self) -> Option<&dyn Light> {
        self.light.as_deref()
    }

    /// The clock that all devices share.
    pub fn clock(&self) -> &dyn Clock {
        &*self.clock
    }

    /// What was done so far.
    pub fn counters(&self) -> Counters {
        Counters {
            moves: self.moves.load(Ordering::SeqCst),
            frames: self.frames.load(Ordering::SeqCst),
            objective_changes: self.objective_changes.load(Ordering::SeqCst),
        }
    }

    /// The data of one objective.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchObjective`].
    pub fn objective(&self, id: &ObjectiveId) -> Result<&Objective, ScopeError> {
        self.gate.objective(id)
    }

    /// Tells at which z of the stage an objective is in focus. The differences between objectives predict where the next one
    /// will be.
    pub fn focus_found(&self, id: &ObjectiveId, z: Length) {
        self.gate.knowledge().focus().insert(id.clone(), z);
    }

    /// Where each objective was last in focus.
    pub fn focus_positions(&self) -> BTreeMap<ObjectiveId, Length> {
        self.gate.knowledge().focus().clone()
    }

    /// What lies on the camera, as far as it was seen: every procedure divides it out of what it sees.
    pub fn flat_field(&self) -> Option<Arc<FlatField>> {
        let kept = self.flat_field.lock();
        kept.unwrap_or_else(|e| e.into_inner()).clone()
    }

    /// Keeps what lies on the camera, as it was seen now or before; tells what was kept until then.
    pub fn set_flat_field(&self, seen: Option<Arc<FlatField>>) -> Option<Arc<FlatField>> {
        let kept = self.flat_field.lock();
        std::mem::replace(&mut *kept.unwrap_or_else(|e| e.into_inner()), seen)
    }

    /// Takes back what [`Instrument::focus_found`] told: it was another objective.
    pub fn forget_focus(&self, id: &ObjectiveId) {
        self.gate.knowledge().focus().remove(id);
    }

    /// Moves and waits until the stage has settled, and sees that it is where it was sent. Returns where it says it is.
    ///
    /// # Errors
    /// Refused moves as in [`MotionGate::start_move`]; [`ScopeError::NotArrived`] and [`ScopeError::Strayed`] as in
    /// [`MotionGate::arrived`]; [`ScopeError::Interrupted`] after the token was cancelled (the stage was stopped first);
    /// [`ScopeError::MoveAborted`]; [`ScopeError::Timeout`].
    pub fn move_to(&self, to: &StagePose) -> Result<StagePose, ScopeError> {
        self.check_cancel()?;
        self.remember_beginning()?;
        self.gate.start_move(to).map_err(|e| self.seen(e))?;
        self.moves.fetch_add(1, Ordering::SeqCst);
        match self.wait("stage", MOVE_TIMEOUT, || self.gate.poll())? {
            Motion::Settled => self.gate.arrived(),
            _ => Err(ScopeError::MoveAborted {
                at: self.gate.position().ok(),
            }),
        }
    }

    /// Lets the stage find its reference, which may move anything anywhere: only with the user's consent. Returns where it says it is
    /// then.
    ///
    /// # Errors
    /// Those of [`MotionGate::start_homing`] and, of where it ended, [`MotionGate::arrived`]; [`ScopeError::Interrupted`] after the
    /// token was cancelled (the stage was stopped first); [`ScopeError::MoveAborted`]; [`ScopeError::Timeout`].
    pub fn home(&self) -> Result<StagePose, ScopeError> {
        self.check_cancel()?;
        self.gate.start_homing().map_err(|e| self.seen(e))?;
        match self.wait("stage", HOMING_TIMEOUT, || self.gate.poll())? {
            Motion::Settled => self.gate.arrived(),
            _ => Err(ScopeError::MoveAborted { at: None }),
        }
    }

    /// Another command begins: what fails from now on goes back to the height at which its first move will find the stage. A new
    /// instrument is at the beginning of its first.
    pub fn command_begins(&self) {
        *self.began_mut() = None;
    }

    fn began_mut(&self) -> std::sync::MutexGuard<'_, Option<StagePose>> {
        self.began.lock().unwrap_or_else(|e| e.into_inner())
    }

    fn remember_beginning(&self) -> Result<(), ScopeError> {
        let mut began = self.began_mut();
        if began.is_none() {
            *began = Some(self.gate.position()?);
        }
        Ok(())
    }

    /// Goes to a height from the side away from the specimen, so that play leaves the stage farther and never nearer than the height
    /// says. Where the last of the way is refused, it stays farther away.
    ///
    /// # Errors
    /// As [`Instrument::move_to`].
    pub fn return_to_height(&self, z: Length) -> Result<(), ScopeError> {
        let to = |z: f64| StagePose::default().with_si(Axis::Z, z);
        let clearance = self
            .gate
            .info()
            .axis(Axis::Z)
            .map_or(0.0, AxisInfo::clearance);
        let beyond = to(self.gate.positive_z().away(z.m(), clearance));
        if self.gate.check(&beyond).is_ok() {
            self.move_to(&beyond)?;
            return match self.move_to(&to(z.m())) {
                Err(error) if error.kind() == ErrorKind::Refused => Ok(()),
                ended => ended.map(drop),
            };
        }
        self.move_to(&to(z.m())).map(drop)
    }

    /// What a command that failed leaves: the stage goes back to the height at which the command found it, where it stands nearer to
    /// the specimen. Elsewhere it stays, and so it does once somebody has asked for a stop.
    ///
    /// # Errors
    /// As [`Instrument::move_to`], and [`ScopeError::StillMoves`].
    pub fn withdraw(&self) -> Result<(), ScopeError> {
        let began = self.began_mut().and_then(|at| at.z);
        let Some(began) = began.filter(|_| !self.gate.is_cancelled()) else {
            return Ok(());
        };
        let here = self.stand_still()?.z.unwrap_or(began);
        match self.gate.positive_z().nearer_by(here.m(), began.m()) > 0.0 {
            true => self.return_to_height(began),
            false => Ok(()),
        }
    }

    /// Waits until the stage was seen to stand. Returns where.
    ///
    /// # Errors
    /// As [`stand_still`].
    pub fn stand_still(&self) -> Result<StagePose, ScopeError> {
        let (poll, position) = (|| self.gate.poll(), || self.gate.position());
        stand_still(self.gate.info(), self.clock(), &poll, &position)
    }

    /// Stops everything, and tells whether it was seen to stand.
    fn stopped(&self) -> ScopeError {
        let stood = self.gate.stop().and_then(|()| self.stand_still());
        match stood {
            Ok(at) => ScopeError::Interrupted { at: Some(at) },
            // One that was stopped on the way to its reference stands somewhere.
            Err(ScopeError::NotHomed { .. }) => ScopeError::Interrupted { at: None },
            Err(error) => error,
        }
    }

    /// An interruption that nobody has looked at, seen to.
    fn seen(&self, error: ScopeError) -> ScopeError {
        match error {
            ScopeError::Interrupted { .. } => self.stopped(),
            error => error,
        }
    }

    /// Brings an objective into the beam and waits for it. Does nothing when it is there already.
    ///
    /// Where the rules say so, the stage retracts first, and afterwards comes back to where the new objective is expected in focus:
    /// as much higher or lower as it was found to be in focus before, or short of the old height by the rule's margin. A
    /// stage that was retracted already stays so.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchObjective`], and as [`Instrument::move_to`]. When the way back is refused the stage stays retracted.
    pub fn select_objective(&self, id: &ObjectiveId) -> Result<(), ScopeError> {
        self.check_cancel()?;
        self.gate.objective(id)?;
        self.remember_beginning()?;
        let before = self.gate.current_objective()?;
        if before.as_ref() == Some(id) {
            return Ok(());
        }
        let ChangeRule::Retracted { margin, .. } = self.gate.rules().change else {
            return self.turn(id);
        };
        let to = |z: f64| StagePose::default().with_si(Axis::Z, z);
        let side = self.gate.positive_z();
        let work = self.gate.at_work()?;
        if let Some(work) = work {
            self.move_to(&to(work.retreat_m))?;
        }
        self.turn(id).map_err(|error| match (error, work) {
            (ScopeError::ChangeEnded { asked, .. }, Some(work)) => ScopeError::ChangeEnded {
                asked,
                retracted_from_um: Some(work.here_m * 1e6),
            },
            (error, _) => error,
        })?;
        if let Some(work) = work {
            let here = work.here_m;
            let focus = self.focus_positions();
            let known = before.and_then(|old| Some((focus.get(&old)?, focus.get(id)?)));
            let expected = match known {
                Some((old, new)) => here + (new.m() - old.m()),
                None => side.away(here, margin),
            };
            // In steps that are allowed.
            let longest = self.gate.rules().largest_steps.iter();
            let longest = longest
                .filter(|l| l.axis == Axis::Z)
                .map(|l| l.step)
                .fold(f64::INFINITY, f64::min);
            let mut at = work.retreat_m;
            while side.nearer_by(expected, at) > longest {
                // A little less, so that rounding is no reason to refuse.
                at = side.away(at, -0.999 * longest);
                self.move_to(&to(at))?;
            }
            if side.nearer_by(expected, at) > 0.0 {
                self.move_to(&to(expected))?;
            }
        }
        Ok(())
    }

    fn turn(&self, id: &ObjectiveId) -> Result<(), ScopeError> {
        self.gate.start_change(id).map_err(|e| self.seen(e))?;
        self.objective_changes.fetch_add(1, Ordering::SeqCst);
        let settled = self.wait("nosepiece", CHANGE_TIMEOUT, || self.gate.poll_nosepiece())?;
        if settled == Motion::Stopped {
            return Err(ScopeError::ChangeEnded {
                asked: id.clone(),
                retracted_from_um: None,
            });
        }
        let now = self.gate.current_objective()?;
        if settled != Motion::Settled || now.as_ref() != Some(id) {
            return Err(ScopeError::Device {
                device: "nosepiece",
                detail: format!(
                    "asked for {id}, but {} is in the beam",
                    now.map_or("nothing known".to_string(), |o| o.0)
                ),
            });
        }
        Ok(())
    }

    /// Grabs a fresh frame.
    ///
    /// # Errors
    /// [`ScopeError::Interrupted`], or what the camera reports.
    pub fn grab(&self) -> Result<Frame, ScopeError> {
        self.check_cancel()?;
        let (tell, told) = mpsc::channel();
        let camera = self.camera.clone();
        // Whoever asks for a stop need not wait for a long exposure: the camera ends it by itself, and nobody looks.
        let frame = std::thread::spawn(move || {
            // Whoever asked may have gone.
            let _ = tell.send(camera.grab());
        });
        loop {
            match told.recv_timeout(POLL_CANCEL) {
                Ok(frame) => {
                    let frame = frame?;
                    self.frames.fetch_add(1, Ordering::SeqCst);
                    return Ok(frame);
                }
                Err(RecvTimeoutError::Timeout) => {
                    if let Err(interrupted) = self.check_cancel() {
                        *self.given_up.lock().unwrap_or_else(|e| e.into_inner()) = Some(frame);
                        return Err(interrupted);
                    }
                }
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(ScopeError::Device {
                        device: "camera",
                        detail: "its driver broke down".into(),
                    });
                }
            }
        }
    }

    /// An error when a stop was asked for.
    pub fn check_cancel(&self) -> Result<(), ScopeError> {
        match self.gate.is_cancelled() {
            true => Err(self.stopped()),
            false => Ok(()),
        }
    }

    fn wait(
        &self,
        device: &'static str,
        limit: Duration,
        poll: impl Fn() -> Result<Motion, ScopeError>,
    ) -> Result<Motion, ScopeError> {
        let start = self.clock.now();
        loop {
            self.check_cancel()?;
            match poll() {
                Ok(Motion::Moving) => {}
                // Stopped from the side that also asked for the stop: the next turn says so.
                Ok(Motion::Stopped) if self.gate.is_cancelled() => continue,
                Ok(ended) => return Ok(ended),
                Err(fault) => {
                    // A device that cannot say what it does must not go on doing it; its own fault is the news.
                    let _ = self.gate.stop();
                    return Err(fault);
                }
            }
            if self.clock.now().since(start) > limit {
                self.gate.stop()?;
                return Err(ScopeError::Timeout {
                    device,
                    seconds: limit.as_secs_f64(),
                });
            }
            self.clock.sleep(POLL);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{AxisInfo, Kinematics, PositiveZ, Stage, StageInfo, Timestamp};
    use std::sync::Mutex;

    /// A stage of one axis that goes 1 mm/s, or never arrives, or cannot say what it does.
    struct Slow {
        info: StageInfo,
        clock: Arc<Ticks>,
        fault: bool,
        /// Start (s, m) and goal of the move under way, or where it stands.
        state: Arc<Mutex<Place>>,
    }

    #[derive(Clone, Copy, Debug, PartialEq)]
    enum Place {
        Stands { at: f64, stopped: bool },
        Moves { from: f64, to: f64, since: f64 },
    }

    impl Slow {
        fn x(&self) -> f64 {
            match *self.state.lock().unwrap() {
                Place::Stands { at, .. } => at,
                Place::Moves { from, to, since } => {
                    let way = 1e-3 * (self.clock.now().seconds() - since);
                    (from + way).min(to)
                }
            }
        }
    }

    impl Stage for Slow {
        fn info(&self) -> &StageInfo {
            &self.info
        }
        fn position(&self) -> Result<StagePose, ScopeError> {
            Ok(StagePose::default().with_si(Axis::X, self.x()))
        }
        fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
            let (from, since) = (self.x(), self.clock.now().seconds());
            let to = to.si(Axis::X).unwrap();
            *self.state.lock().unwrap() = Place::Moves { from, to, since };
            Ok(())
        }
        fn poll(&self) -> Result<Motion, ScopeError> {
            let moves = matches!(*self.state.lock().unwrap(), Place::Moves { .. });
            if self.fault && moves {
                return Err(ScopeError::Device {
                    device: "stage",
                    detail: "cable".into(),
                });
            }
            Ok(match *self.state.lock().unwrap() {
                Place::Stands { stopped: true, .. } => Motion::Stopped,
                Place::Stands { stopped: false, .. } => Motion::Settled,
                Place::Moves { .. } => Motion::Moving,
            })
        }
        fn stop(&self) -> Result<(), ScopeError> {
            let at = self.x();
            *self.state.lock().unwrap() = Place::Stands { at, stopped: true };
            Ok(())
        }
    }

    /// A virtual clock that cancels after a number of sleeps.
    struct Ticks {
        clock: crate::VirtualClock,
        left: Mutex<i64>,
        cancel: CancelToken,
    }

    impl Clock for Ticks {
        fn now(&self) -> Timestamp {
            self.clock.now()
        }
        fn sleep(&self, duration: Duration) {
            self.clock.sleep(duration);
            let mut left = self.left.lock().unwrap();
            *left -= 1;
            if *left == 0 {
                self.cancel.cancel();
            }
        }
    }

    /// Sends the stage 10 mm away; it is cancelled after `sleeps` waits (never for 0). Returns what the move answered,
    /// the stage's state and the time.
    fn send(sleeps: i64, fault: bool) -> (Result<StagePose, ScopeError>, Place, f64) {
        let cancel = CancelToken::new();
        let clock = Arc::new(Ticks {
            clock: crate::VirtualClock::new(),
            left: Mutex::new(sleeps),
            cancel: cancel.clone(),
        });
        let state = Arc::new(Mutex::new(Place::Stands {
            at: 0.0,
            stopped: false,
        }));
        let stage = Slow {
            info: StageInfo {
                name: "slow".into(),
                axes: vec![AxisInfo {
                    axis: Axis::X,
                    min: -1.0,
                    max: 1.0,
                    repeatability: 0.0,
                    arrival_tolerance: None,
                }],
                kinematics: Kinematics::MovesMicroscope,
                positive_z: PositiveZ::Closer,
            },
            clock: clock.clone(),
            fault,
            state: state.clone(),
        };
        let devices = Devices {
            stage: Some(Box::new(stage)),
            ..Devices::none(clock.clone())
        };
        let rules = Rules::travel_only(ChangeRule::Anywhere);
        let scope = Instrument::new(devices, rules, cancel).unwrap();
        let answer = scope.move_to(&StagePose::default().with_si(Axis::X, 1e-2));
        let place = *state.lock().unwrap();
        (answer, place, clock.now().seconds())
    }

    #[test]
    fn a_stop_on_the_way_halts_the_stage_between_start_and_goal() {
        let (answer, place, _) = send(100, false);
        let Err(ScopeError::Interrupted { at: Some(at) }) = answer else {
            panic!("{answer:?}");
        };
        assert!(
            matches!(place, Place::Stands { stopped: true, .. }),
            "{place:?}"
        );
        let x = at.si(Axis::X).unwrap();
        assert!(x > 1e-4 && x < 9e-3, "{x}");
    }

    #[test]
    fn a_stage_that_cannot_say_what_it_does_is_stopped_and_its_own_fault_is_told() {
        let (answer, place, _) = send(0, true);
        assert!(
            matches!(answer, Err(ScopeError::Device { .. })),
            "{answer:?}"
        );
        assert!(
            matches!(place, Place::Stands { stopped: true, .. }),
            "{place:?}"
        );
    }

    #[test]
    fn a_stage_that_never_arrives_is_stopped_after_the_time_out() {
        let (answer, place, seconds) = send(0, false);
        assert!(
            matches!(answer, Err(ScopeError::Timeout { .. })),
            "{answer:?}"
        );
        assert!(
            matches!(place, Place::Stands { stopped: true, .. }),
            "{place:?}"
        );
        assert!((seconds - MOVE_TIMEOUT.as_secs_f64()).abs() < 1.0);
    }

    /// A camera that exposes for a minute.
    struct Night(Absent);

    impl Camera for Night {
        fn info(&self) -> &crate::CameraInfo {
            Camera::info(&self.0)
        }
        fn exposure(&self) -> Result<Duration, ScopeError> {
            Ok(Duration::from_secs(60))
        }
        fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError> {
            Ok(exposure)
        }
        fn grab(&self) -> Result<Frame, ScopeError> {
            std::thread::sleep(Duration::from_secs(60));
            self.0.grab()
        }
    }

    #[test]
    fn a_stop_does_not_wait_for_a_long_exposure() {
        let cancel = CancelToken::new();
        let rules = Rules::travel_only(ChangeRule::Anywhere);
        let clock = Arc::new(crate::SystemClock::new());
        let devices = Devices {
            camera: Some(Box::new(Night(Absent::new()))),
            ..Devices::none(clock.clone())
        };
        let scope = Instrument::new(devices, rules, cancel.clone()).unwrap();
        std::thread::scope(|s| {
            let grab = s.spawn(|| scope.grab());
            std::thread::sleep(Duration::from_millis(50));
            cancel.cancel();
            let answer = grab.join().unwrap();
            assert!(
                matches!(answer, Err(ScopeError::Interrupted { .. })),
                "{answer:?}"
            );
        });
        assert!(clock.now().seconds() < 5.0);
    }
}

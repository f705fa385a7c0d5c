//! Moves of the stage, waited for and judged, and the way back of a command that failed.

use super::Instrument;
use crate::{Axis, AxisInfo, ErrorKind, Length, Motion, ScopeError, StagePose};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// No move of these instruments takes longer.
const MOVE_TIMEOUT: Duration = Duration::from_secs(120);
/// Nor homing.
const HOMING_TIMEOUT: Duration = Duration::from_secs(180);

impl Instrument {
    /// Moves and waits until the stage has settled, and sees that it is where it was sent. Returns where it says it is.
    ///
    /// # Errors
    /// Refused moves as in [`MotionGate::start_move`](crate::MotionGate::start_move); [`ScopeError::NotArrived`] and [`ScopeError::Strayed`] as in
    /// [`MotionGate::arrived`](crate::MotionGate::arrived); [`ScopeError::Interrupted`] after the token was cancelled (the stage was stopped first);
    /// [`ScopeError::MoveAborted`]; [`ScopeError::Timeout`].
    pub fn move_to(&self, to: &StagePose) -> Result<StagePose, ScopeError> {
        self.check_cancel()?;
        self.remember_beginning()?;
        self.gate.start_move(to).map_err(|e| self.seen(e))?;
        self.moves.fetch_add(1, Ordering::SeqCst);
        let ended = self.wait("stage", MOVE_TIMEOUT, || self.gate.poll())?;
        self.ended(ended)
    }

    /// Where a move ended, if it is where it was sent.
    fn ended(&self, motion: Motion) -> Result<StagePose, ScopeError> {
        match motion {
            Motion::Settled => self.gate.arrived(),
            _ => Err(self.aborted(self.gate.position().ok())),
        }
    }

    /// Moves at a speed, m/s, as [`Stage::start_move_at`](crate::Stage::start_move_at), and calls `look` again and again while the stage moves: to grab
    /// frames, and to ask where it is. What `look` fails with stops the stage. Returns where it says it is at the end.
    ///
    /// # Errors
    /// As [`Instrument::move_to`]; [`ScopeError::Refused`] by a stage that has one speed, and nothing moved; what `look` fails with.
    pub fn move_looking<E: From<ScopeError>>(
        &self,
        to: &StagePose,
        m_per_s: f64,
        mut look: impl FnMut() -> Result<(), E>,
    ) -> Result<StagePose, E> {
        self.check_cancel()?;
        self.remember_beginning()?;
        let begun = self.gate.start_move_at(to, m_per_s);
        begun.map_err(|e| self.seen(e))?;
        self.moves.fetch_add(1, Ordering::SeqCst);
        let mut failed = None;
        let ended = self.wait("stage", MOVE_TIMEOUT, || {
            let motion = self.gate.poll()?;
            if motion == Motion::Moving
                && let Err(error) = look()
            {
                failed = Some(error);
                return Ok(Motion::Stopped);
            }
            Ok(motion)
        });
        match failed {
            Some(error) => {
                // Why is the news.
                let _ = self.gate.stop().and_then(|()| self.stand_still());
                Err(error)
            }
            None => Ok(self.ended(ended?)?),
        }
    }

    /// Lets the stage find its reference, which may move anything anywhere: only with the user's consent. Returns where it says it is
    /// then.
    ///
    /// # Errors
    /// Those of [`MotionGate::start_homing`](crate::MotionGate::start_homing) and, of where it ended, [`MotionGate::arrived`](crate::MotionGate::arrived); [`ScopeError::Interrupted`] after the
    /// token was cancelled (the stage was stopped first); [`ScopeError::MoveAborted`]; [`ScopeError::Timeout`].
    pub fn home(&self) -> Result<StagePose, ScopeError> {
        self.check_cancel()?;
        self.gate.start_homing().map_err(|e| self.seen(e))?;
        match self.wait("stage", HOMING_TIMEOUT, || self.gate.poll())? {
            Motion::Settled => self.gate.arrived(),
            _ => Err(self.aborted(None)),
        }
    }

    /// A motion that ended before its goal, and not because we stopped it.
    fn aborted(&self, at: Option<StagePose>) -> ScopeError {
        let error = ScopeError::MoveAborted { at };
        self.gate.tell_not_arrived(&error);
        error
    }

    /// Another command begins: what fails from now on goes back to the height at which its first move will find the stage. A new
    /// instrument is at the beginning of its first.
    pub fn command_begins(&self) {
        *self.began_mut() = None;
    }

    /// Where the stage stood before the first move of the present command; `None` before that.
    pub fn began(&self) -> Option<StagePose> {
        *self.began_mut()
    }

    fn began_mut(&self) -> std::sync::MutexGuard<'_, Option<StagePose>> {
        self.began.lock().unwrap_or_else(|e| e.into_inner())
    }

    pub(super) fn remember_beginning(&self) -> Result<(), ScopeError> {
        let mut began = self.began_mut();
        if began.is_none() {
            *began = Some(self.gate.position()?);
        }
        Ok(())
    }

    /// Goes to a height from the side away from the specimen, so that backlash leaves the stage farther and never nearer than the height
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
            self.move_in_steps(&beyond)?;
            return match self.move_in_steps(&to(z.m())) {
                Err(error) if error.kind() == ErrorKind::Refused => Ok(()),
                ended => ended.map(drop),
            };
        }
        self.move_in_steps(&to(z.m())).map(drop)
    }

    /// What a command that failed leaves: the stage goes back to the height at which the command found it, where it stands nearer to
    /// the specimen. Elsewhere it stays, and so it does once somebody has asked for a stop.
    ///
    /// # Errors
    /// As [`Instrument::move_to`], and [`ScopeError::StillMoves`].
    pub fn withdraw(&self) -> Result<(), ScopeError> {
        let began = self.began().and_then(|at| at.z);
        let Some(began) = began.filter(|_| !self.gate.is_cancelled()) else {
            return Ok(());
        };
        let here = self.stand_still()?.z.unwrap_or(began);
        match self.gate.positive_z().nearer_by(here.m(), began.m()) > 0.0 {
            true => self.return_to_height(began),
            false => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        CancelToken, ChangeRule, Clock, Devices, Kinematics, PositiveZ, Rules, Stage, StageInfo,
        Timestamp,
    };
    use std::sync::{Arc, Mutex};

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
}

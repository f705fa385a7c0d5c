//! Beginnings: a move, a homing, a change of the objective. Checking and beginning happen under one lock.

use super::{MotionGate, Way};
use crate::{ErrorKind, GateEvent, Motion, ObjectiveId, ScopeError, Stage, StagePose};
use std::sync::MutexGuard;
use std::sync::atomic::Ordering;

impl MotionGate {
    /// Starts a move if the rules allow it.
    ///
    /// # Errors
    /// Those of [`MotionGate::check`]; [`ScopeError::StepTooLarge`], [`ScopeError::Busy`] while stage or nosepiece move,
    /// [`ScopeError::NotHomed`], [`ScopeError::Interrupted`] when somebody stopped meanwhile; and what the devices report. Unless it is one of the stage's
    /// own faults, nothing moved.
    pub fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.start(to, |stage| stage.start_move(to))
    }

    /// The same at a speed, m/s, as [`Stage::start_move_at`].
    ///
    /// # Errors
    /// Those of [`MotionGate::start_move`]; [`ScopeError::Refused`] by a stage that has one speed.
    pub fn start_move_at(&self, to: &StagePose, m_per_s: f64) -> Result<(), ScopeError> {
        self.start(to, |stage| stage.start_move_at(to, m_per_s))
    }

    /// As [`Stage::knows_speeds`].
    pub fn knows_speeds(&self) -> bool {
        self.stage.knows_speeds()
    }

    fn start(
        &self,
        to: &StagePose,
        go: impl FnOnce(&dyn Stage) -> Result<(), ScopeError>,
    ) -> Result<(), ScopeError> {
        self.tell(|| GateEvent::MoveAsked { to: *to });
        let begun = self.begin_move(to, go);
        self.tell(|| match &begun {
            Ok(()) => GateEvent::MoveBegan { to: *to },
            Err(why) => GateEvent::MoveRefused {
                to: *to,
                why: why.to_string(),
            },
        });
        begun
    }

    fn begin_move(
        &self,
        to: &StagePose,
        go: impl FnOnce(&dyn Stage) -> Result<(), ScopeError>,
    ) -> Result<(), ScopeError> {
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
        self.reported.departs();
        self.begun(go(&*self.stage))?;
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
        let begun = self.begin_homing();
        self.tell(|| match &begun {
            Ok(()) => GateEvent::HomingBegan {
                axes: self.info().axes.iter().map(|info| info.axis).collect(),
            },
            Err(why) => GateEvent::HomingRefused {
                why: why.to_string(),
            },
        });
        begun
    }

    fn begin_homing(&self) -> Result<(), ScopeError> {
        let _begin = self.begin();
        let stops = self.stops.load(Ordering::SeqCst);
        self.check_cancel()?;
        self.check_idle()?;
        self.reported.departs();
        self.begun(self.stage.start_homing())?;
        self.begun_way(Way::Homing);
        self.stopped_meanwhile(stops)
    }

    /// Starts to change the objective if the rules allow it.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchObjective`], [`ScopeError::NotHomed`], [`ScopeError::NotRetracted`], [`ScopeError::StandsOutside`] and those of the places where the
    /// objective that comes may not be, [`ScopeError::ImmersionNotAgreed`], [`ScopeError::Busy`] while stage or nosepiece move,
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
        self.check_immersion(to)?;
        let answer = self.nosepiece.start_change(to);
        if !answer.as_ref().is_err_and(is_refusal) {
            self.knowledge.change_begun(to);
        }
        self.begun(answer)?;
        self.stopped_meanwhile(stops)
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
        idle(self.poll()?, "stage")
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
}

fn is_refusal(error: &ScopeError) -> bool {
    error.kind() == ErrorKind::Refused
}

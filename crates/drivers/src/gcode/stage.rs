//! The stage: what the driver has asked of it, and the contract over the parts that home, move and turn it.

use crate::gcode::settings::{GcodeSettings, Motor};
use crate::gcode::talk::{Talk, steps_of};
use crate::session::{Exchange, Session, device, lock};
use crate::turret::Part;
use scopeservo_scope::{Motion, ScopeError, Stage, StageInfo, StagePose, check_speed};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// How long a look at whether homing has ended may take.
pub(super) const GLANCE: Duration = Duration::from_millis(2);

/// What the driver has asked of the stage.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Doing {
    Nothing,
    /// On the way to a goal, in steps; where it was last seen, and since when it has stood there.
    Moving {
        goal: Vec<Option<i64>>,
        seen: Vec<i64>,
        since: Instant,
    },
    /// Homing: what, for a nosepiece where all stood before, the line's number, answers to earlier stops that come first, the stops before it, and
    /// when to give up.
    Homing {
        part: Part,
        before: Vec<i64>,
        number: Option<u32>,
        owed: u32,
        stops: u64,
        give_up: Instant,
    },
    /// Stopped on the way.
    Stopped,
}

/// A stage on a G-code board, or a nosepiece, or both.
///
/// A stop ends the step pulses at once. Fast and heavy axes can run on by some steps that the board does not count; where
/// that can be, home again after a stop.
pub struct GcodeStage {
    pub(super) session: Session,
    pub(super) talk: Talk,
    pub(super) info: StageInfo,
    pub(super) motors: Vec<Motor>,
    pub(super) feed_mm_per_min: f64,
    pub(super) homing_timeout: Duration,
    pub(super) stop_timeout: Duration,
    pub(super) stall_timeout: Duration,
    /// Steppers that have not moved for so long stand still.
    pub(super) still_window: Duration,
    pub(super) settings: GcodeSettings,
    pub(super) homed: Mutex<Homed>,
    pub(super) doing: Mutex<Doing>,
}

/// What was homed over this connection.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Homed {
    pub(super) stage: bool,
    pub(super) nosepiece: bool,
}

impl Homed {
    pub(super) fn of(&mut self, part: Part) -> &mut bool {
        match part {
            Part::Stage => &mut self.stage,
            Part::Nosepiece => &mut self.nosepiece,
        }
    }
}

impl GcodeStage {
    pub(super) fn steps(&self, ex: &mut Exchange<'_>) -> Result<Vec<i64>, ScopeError> {
        let report = self.talk.position(ex)?;
        let all = self.motors.iter();
        all.map(|motor| steps_of(ex, &report, motor)).collect()
    }
}

impl Stage for GcodeStage {
    fn info(&self) -> &StageInfo {
        &self.info
    }

    fn position(&self) -> Result<StagePose, ScopeError> {
        let mut ex = self.session.exchange()?;
        if !self.homing_ended(&mut ex, GLANCE)? {
            return Err(ScopeError::Busy { device: "stage" });
        }
        self.check_homed()?;
        let steps = self.steps(&mut ex)?;
        let set = |pose: StagePose, (motor, steps): (&Motor, i64)| match motor.axis {
            Some(axis) => pose.with_si(axis, motor.units(steps) * 1e-3),
            None => pose,
        };
        let all = self.motors.iter().zip(steps);
        Ok(all.fold(StagePose::default(), set))
    }

    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        let targets = self.targets(to)?;
        self.start(Part::Stage, &targets, self.feed_mm_per_min)
    }

    fn start_move_at(&self, to: &StagePose, m_per_s: f64) -> Result<(), ScopeError> {
        check_speed(m_per_s)?;
        let targets = self.targets(to)?;
        let feed = self.feed_mm_per_min.min(m_per_s * 60e3);
        self.start(Part::Stage, &targets, feed)
    }

    fn knows_speeds(&self) -> bool {
        true
    }

    fn poll(&self) -> Result<Motion, ScopeError> {
        let mut ex = self.session.exchange()?;
        self.poll_in(&mut ex)
    }

    fn stop(&self) -> Result<(), ScopeError> {
        self.session.send_stop()?;
        let mut ex = self.session.exchange()?;
        if !self.homing_ended(&mut ex, self.stop_timeout)? {
            return Err(device(
                "it goes on homing and does not take the stop; switch it off if it must stand",
            ));
        }
        self.talk.settle_owed(&mut ex)?;
        if !self.wait_still(&mut ex)? {
            return Err(device(
                "it goes on moving after the command to stop; use the emergency stop",
            ));
        }
        let mut doing = lock(&self.doing);
        if *doing != Doing::Nothing {
            *doing = Doing::Stopped;
        }
        Ok(())
    }

    fn is_homed(&self) -> Result<bool, ScopeError> {
        self.is_part_homed(Part::Stage)
    }

    fn start_homing(&self) -> Result<(), ScopeError> {
        self.home_part(Part::Stage)
    }
}

impl Drop for GcodeStage {
    fn drop(&mut self) {
        let doing = lock(&self.doing).clone();
        self.session
            .abandon(matches!(doing, Doing::Moving { .. } | Doing::Homing { .. }));
    }
}

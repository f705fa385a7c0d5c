//! The stage: what the driver has asked of it, and the contract over the parts that home, move and turn it.

use crate::gcs2::codec::{self, AxisName, Command};
use crate::gcs2::settings::{AxisPlan, Gcs2Nosepiece};
use crate::gcs2::talk::{STOPPED_BY_COMMAND, error_number, not_homed, read, values};
use crate::gcs2::unit::Unit;
use crate::session::{Exchange, Session, device, lock};
use crate::turret::Part;
use scopeservo_scope::{Axis, Motion, ScopeError, Stage, StageInfo, StagePose, check_speed};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// What the driver has asked of the stage.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Doing {
    Nothing,
    /// On the way to a goal, and since when the axes stand still without being on target.
    Moving {
        part: Part,
        goal: Vec<Goal>,
        still_since: Option<Instant>,
    },
    /// On a reference move.
    Homing(Part),
    /// Stopped on the way.
    Stopped,
}

/// Where an axis goes, in the controller's units, and how near it counts as there.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Goal {
    pub(super) name: AxisName,
    pub(super) to: f64,
    pub(super) tolerance: f64,
}

/// A nosepiece on an axis of the controller.
pub(super) struct Nosepiece {
    pub(super) name: AxisName,
    pub(super) settings: Gcs2Nosepiece,
    pub(super) unit: Unit,
}

/// A stage on a GCS 2 controller, and a nosepiece on another of its axes.
pub struct Gcs2Stage {
    pub(super) session: Session,
    pub(super) info: StageInfo,
    pub(super) plans: Vec<AxisPlan>,
    pub(super) names: Vec<AxisName>,
    /// What the controller said that it counts them in; empty words where it does not say.
    pub(super) units_said: Vec<String>,
    pub(super) nosepiece: Option<Nosepiece>,
    pub(super) coupled: bool,
    pub(super) stop_timeout: Duration,
    pub(super) settle_timeout: Duration,
    pub(super) doing: Mutex<Doing>,
    /// The line that puts a velocity back which a slow move has changed.
    pub(super) velocity_owed: Mutex<Option<Vec<u8>>>,
    /// Whether the controller has said that it knows where its axes are.
    pub(super) homed: Mutex<bool>,
    /// Whether it knows of reference moves. One that does not has axes that always know where they are.
    pub(super) knows_reference: bool,
}

impl Gcs2Stage {
    pub(super) fn names_of(&self, part: Part) -> &[AxisName] {
        match (part, &self.nosepiece) {
            (Part::Nosepiece, Some(nosepiece)) => std::slice::from_ref(&nosepiece.name),
            (Part::Nosepiece, None) => &[],
            (Part::Stage, _) => &self.names,
        }
    }

    pub(super) fn plan(&self, axis: Axis) -> Result<&AxisPlan, ScopeError> {
        self.plans
            .iter()
            .find(|p| p.axis == axis)
            .ok_or(ScopeError::NoSuchAxis { axis })
    }

    pub(super) fn is_homing(&self) -> bool {
        matches!(*lock(&self.doing), Doing::Homing(_))
    }

    pub(super) fn exchange_unless_homing(&self) -> Result<Exchange<'_>, ScopeError> {
        let mut ex = self.session.exchange()?;
        if self.is_homing() && self.poll_in(&mut ex)? == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        Ok(ex)
    }

    pub(super) fn mark_stopped(&self) {
        let mut doing = lock(&self.doing);
        if *doing != Doing::Nothing {
            *doing = Doing::Stopped;
        }
    }

    pub(super) fn poses_in(&self, ex: &mut Exchange<'_>) -> Result<StagePose, ScopeError> {
        let at = values(ex, &Command::Positions(&self.names), &self.names)?;
        let set =
            |pose: StagePose, (plan, v): (&AxisPlan, f64)| pose.with_si(plan.axis, plan.si(v));
        Ok(self.plans.iter().zip(at).fold(StagePose::default(), set))
    }
}

impl Stage for Gcs2Stage {
    fn info(&self) -> &StageInfo {
        &self.info
    }

    fn position(&self) -> Result<StagePose, ScopeError> {
        let mut ex = self.exchange_unless_homing()?;
        // An axis that does not know where it is reads zero.
        let known = *lock(&self.homed);
        if !known && !self.referenced(&mut ex, Part::Stage)? {
            return Err(not_homed());
        }
        self.poses_in(&mut ex)
    }

    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.start(Part::Stage, self.targets(to)?, None)
    }

    fn start_move_at(&self, to: &StagePose, m_per_s: f64) -> Result<(), ScopeError> {
        check_speed(m_per_s)?;
        self.start(Part::Stage, self.targets(to)?, Some(m_per_s))
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
        if !self.wait_still(&mut ex)? {
            let line = read(&ex, Command::Stop.encode())?;
            ex.send(&line)?;
            if !self.wait_still(&mut ex)? {
                return Err(device(
                    "it goes on moving after two commands to stop; use the emergency stop",
                ));
            }
        }
        let number = error_number(&mut ex)?;
        self.mark_stopped();
        self.put_velocity_back(&mut ex)?;
        match number {
            0 | STOPPED_BY_COMMAND => Ok(()),
            other => Err(device(codec::error_in_words(other))),
        }
    }

    fn is_homed(&self) -> Result<bool, ScopeError> {
        self.is_part_homed(Part::Stage)
    }

    fn start_homing(&self) -> Result<(), ScopeError> {
        self.home_part(Part::Stage)
    }
}

impl Drop for Gcs2Stage {
    fn drop(&mut self) {
        let moving = matches!(*lock(&self.doing), Doing::Moving { .. } | Doing::Homing(_));
        self.session.abandon(moving);
    }
}

//! What stage and nosepiece say of themselves: where they are, and what they do.

use super::MotionGate;
use crate::judge::at_most;
use crate::{Axis, AxisInfo, ChangeRule, Motion, ScopeError, StagePose};

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

impl MotionGate {
    /// Where the stage says it is, all of its axes.
    ///
    /// # Errors
    /// What the stage reports; [`ScopeError::ImpossiblePlace`] when that is where it cannot be by what it says of itself.
    pub fn position(&self) -> Result<StagePose, ScopeError> {
        let at = self.reported.place(|| self.stage.position())?;
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

    /// Where the stage stands by what it last said at rest; `None` when a motion has begun since, or nobody has asked it yet. Nothing is
    /// asked of the stage.
    pub fn last_reported(&self) -> Option<StagePose> {
        self.reported.last()
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
        self.reported.motion(|| self.stage.poll())
    }

    /// What the nosepiece is doing.
    pub fn poll_nosepiece(&self) -> Result<Motion, ScopeError> {
        let motion = self.nosepiece.poll()?;
        if motion != Motion::Moving && self.knowledge.is_changing() {
            let settled = match motion {
                Motion::Settled => self.nosepiece.current()?,
                _ => None,
            };
            self.knowledge.change_ended(settled.as_ref());
        }
        Ok(motion)
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
}

//! Verdicts: whether the stage may go somewhere, and whether it arrived where it was sent.

use super::{MotionGate, Way};
use crate::judge::{Judge, at_most};
use crate::{GateEvent, ObjectiveId, ScopeError, StagePose};

/// Where the stage may go from where it stood; by [`MotionGate::goals`].
pub struct Goals<'a> {
    gate: &'a MotionGate,
    /// Where it stood.
    pub here: StagePose,
    in_beam: Vec<ObjectiveId>,
}

impl Goals<'_> {
    /// Whether the stage may go there, as [`MotionGate::check`] tells.
    pub fn allow(&self, to: &StagePose) -> bool {
        let goal = self.gate.judge(&self.in_beam).check_goal(&self.here, to);
        self.gate.info().check_axes(to).and(goal).is_ok()
    }
}

impl MotionGate {
    /// Whether the stage may go there from where it stands, with the active objective: limits, workspace, zones. The way
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
        let goals = self.goals()?;
        Ok(places.iter().map(|to| goals.allow(to)).collect())
    }

    /// A judge of goals for the stage where it stands now, with the active objective, who asks no device again.
    ///
    /// # Errors
    /// What the devices report, and those of [`MotionGate::position`].
    pub fn goals(&self) -> Result<Goals<'_>, ScopeError> {
        Ok(Goals {
            gate: self,
            here: self.position()?,
            in_beam: self.in_beam()?,
        })
    }

    /// As much of the way from where the stage stands as it may go in one step.
    pub(crate) fn first_part(&self, to: &StagePose) -> Result<StagePose, ScopeError> {
        let here = self.position()?;
        Ok(self.judge(&self.in_beam()?).first_part(&here, to))
    }

    /// A place that the stage has reported, as a goal. A place is judged with the slack of its axes and a goal is not: what stands beyond a limit by
    /// no more than its slack is sent to that limit.
    ///
    /// # Errors
    /// What the nosepiece reports.
    pub fn as_goal(&self, at: &StagePose) -> Result<StagePose, ScopeError> {
        Ok(self.judge(&self.in_beam()?).as_goal(at))
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
        match &answer {
            Ok(at) => self.tell(|| match self.way() {
                Some(Way::Homing) => GateEvent::HomingEnded { at: *at },
                _ => GateEvent::Arrived { at: *at },
            }),
            Err(why) => self.tell_not_arrived(why),
        }
        answer
    }

    /// Tells that the last motion of the stage did not end where it should.
    pub(crate) fn tell_not_arrived(&self, why: &ScopeError) {
        let why = why.to_string();
        self.tell(|| match self.way() {
            Some(Way::Homing) => GateEvent::HomingFailed { why },
            _ => GateEvent::NotArrived { why },
        });
    }

    fn way(&self) -> Option<Way> {
        *self.way.lock().unwrap_or_else(|e| e.into_inner())
    }

    fn judge_arrival(&self) -> Result<StagePose, ScopeError> {
        let way = self.way();
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

    pub(super) fn judge<'a>(&'a self, in_beam: &'a [ObjectiveId]) -> Judge<'a> {
        Judge {
            info: self.info(),
            rules: &self.rules,
            ranges: &self.ranges,
            in_beam,
        }
    }
}

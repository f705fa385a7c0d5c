//! Moves: started where the controller knows where its axes are, polled to the goal, halted, and waited for after a stop.

use crate::gcs2::codec::{self, AxisName, Command};
use crate::gcs2::stage::{Doing, Gcs2Stage, Goal};
use crate::gcs2::talk::{
    STOPPED_BY_COMMAND, all_set, ask, error_number, moving, not_homed, read, ready, refusal, values,
};
use crate::session::{Exchange, device, lock, refused};
use crate::turret::Part;
use scopeservo_scope::{Axis, Motion, ScopeError, StagePose};
use std::time::{Duration, Instant};

/// How often the axes are asked whether they stand still after a stop.
const STOP_POLL: Duration = Duration::from_millis(2);

impl Gcs2Stage {
    /// Ends the motion smoothly, where [`Stage::stop`](scopeservo_scope::Stage::stop) ends it abruptly. Returns when the command was taken.
    ///
    /// # Errors
    /// As [`Gcs2Stage::pivot`]; a reference move can only be stopped.
    pub fn halt(&self) -> Result<(), ScopeError> {
        let mut ex = self.exchange_unless_homing()?;
        let bytes = read(&ex, Command::Halt(&self.names).encode())?;
        ex.send(&bytes)?;
        match error_number(&mut ex)? {
            0 | STOPPED_BY_COMMAND => {
                self.mark_stopped();
                Ok(())
            }
            number => Err(refusal(number)),
        }
    }

    pub(super) fn poll_in(&self, ex: &mut Exchange<'_>) -> Result<Motion, ScopeError> {
        let doing = lock(&self.doing).clone();
        if let Doing::Homing(_) = doing {
            if !ready(ex)? {
                return Ok(Motion::Moving);
            }
            let number = error_number(ex)?;
            if number != 0 {
                *lock(&self.doing) = Doing::Stopped;
                return match number {
                    STOPPED_BY_COMMAND => Ok(Motion::Stopped),
                    other => Err(device(codec::error_in_words(other))),
                };
            }
        }
        if moving(ex)? {
            if let Doing::Moving { still_since, .. } = &mut *lock(&self.doing) {
                *still_since = None;
            }
            return Ok(Motion::Moving);
        }
        let (ended, outcome) = match doing {
            Doing::Nothing => return Ok(Motion::Settled),
            Doing::Stopped => {
                self.put_velocity_back(ex)?;
                return Ok(Motion::Stopped);
            }
            Doing::Homing(part) => (true, self.referenced(ex, part)?),
            Doing::Moving {
                part,
                goal,
                still_since,
            } => {
                let names = self.names_of(part);
                let on_target = all_set(ex, &Command::OnTarget(names), names)?;
                let since = still_since.unwrap_or_else(Instant::now);
                if let Doing::Moving { still_since, .. } = &mut *lock(&self.doing) {
                    *still_since = Some(since);
                }
                let late = since.elapsed() > self.settle_timeout;
                // Others can stop the controller too, and it then counts as on target where it stands.
                (on_target || late, on_target && at(ex, &goal)?)
            }
        };
        if !ended {
            return Ok(Motion::Moving);
        }
        let (next, motion) = if outcome {
            (Doing::Nothing, Motion::Settled)
        } else {
            (Doing::Stopped, Motion::Stopped)
        };
        *lock(&self.doing) = next;
        self.put_velocity_back(ex)?;
        Ok(motion)
    }

    /// The request in the controller's names and units, inside the travel.
    pub(super) fn targets(&self, to: &StagePose) -> Result<Vec<Goal>, ScopeError> {
        self.info.check_goal(to)?;
        let mut targets = Vec::new();
        for axis in Axis::ALL {
            let Some(asked) = to.si(axis) else { continue };
            let plan = self.plan(axis)?;
            targets.push(Goal {
                name: plan.name.clone(),
                to: plan.wire(asked),
                tolerance: plan.wire(plan.tolerance_si),
            });
        }
        Ok(targets)
    }

    /// Starts a move of axes of one part, at a speed of its own, m/s, where one is given.
    pub(super) fn start(
        &self,
        part: Part,
        goal: Vec<Goal>,
        m_per_s: Option<f64>,
    ) -> Result<(), ScopeError> {
        let stops = self.session.stops();
        let mut ex = self.session.exchange()?;
        if self.poll_in(&mut ex)? == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        if !self.referenced(&mut ex, part)? {
            return Err(not_homed());
        }
        if goal.is_empty() {
            return Ok(());
        }
        if part == Part::Stage {
            self.check_units(&mut ex)?;
        }
        let targets: Vec<_> = goal.iter().map(|g| (g.name.clone(), g.to)).collect();
        if self.coupled && part == Part::Stage {
            let lines = ask(&mut ex, &Command::CanReach(&targets))?;
            if !read(&ex, codec::decode_reachable(&lines))? {
                return Err(refused(
                    "the pose cannot be reached: what one axis can do depends on the others; nothing moved. \
                     Move nearer to the middle of the travel",
                ));
            }
        }
        let bytes = read(&ex, Command::Move(&targets).encode())?;
        let slowed = m_per_s.map_or(Ok(()), |v| self.slow_down(&mut ex, &goal, v));
        let begun = slowed.and_then(|()| self.begin(&mut ex, part, goal, &bytes, stops));
        if begun.is_err() {
            // Why it did not begin is the news.
            let _ = self.put_velocity_back(&mut ex);
        }
        begun
    }

    /// Sends a move, and asks how the controller took it.
    fn begin(
        &self,
        ex: &mut Exchange<'_>,
        part: Part,
        goal: Vec<Goal>,
        bytes: &[u8],
        stops: u64,
    ) -> Result<(), ScopeError> {
        ex.send_unless_stopped(bytes, stops)?;
        // Moving from here on, should the next answer not come.
        *lock(&self.doing) = Doing::Moving {
            part,
            goal,
            still_since: None,
        };
        let number = error_number(ex)?;
        if number == STOPPED_BY_COMMAND {
            // It may speak of a stop before the move.
            *lock(&self.doing) = Doing::Stopped;
            self.session.send_stop()?;
        } else if number != 0 {
            *lock(&self.doing) = Doing::Nothing;
        }
        match number {
            0 => Ok(()),
            number => Err(refusal(number)),
        }
    }

    /// Waits until the axes stand still, and says whether they do.
    pub(super) fn wait_still(&self, ex: &mut Exchange<'_>) -> Result<bool, ScopeError> {
        let homing = self.is_homing();
        let give_up = Instant::now() + self.stop_timeout;
        loop {
            if !moving(ex)? && (!homing || ready(ex)?) {
                return Ok(true);
            }
            if Instant::now() >= give_up {
                return Ok(false);
            }
            std::thread::sleep(STOP_POLL);
        }
    }
}

/// Whether axes stand where they were sent, within the tolerances.
fn at(ex: &mut Exchange<'_>, goal: &[Goal]) -> Result<bool, ScopeError> {
    let names: Vec<AxisName> = goal.iter().map(|g| g.name.clone()).collect();
    let there = values(ex, &Command::Positions(&names), &names)?;
    let near = |(goal, there): (&Goal, f64)| (goal.to - there).abs() <= goal.tolerance;
    Ok(goal.iter().zip(there).all(near))
}

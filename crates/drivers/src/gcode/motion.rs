//! Moves: started behind the stage's own limits, polled to the goal, and waited for after a stop.

use crate::gcode::codec::Command;
use crate::gcode::stage::{Doing, GLANCE, GcodeStage};
use crate::gcode::talk::PLAN_TOLERANCE_MM;
use crate::session::{Exchange, device, lock};
use crate::turret::Part;
use scopeservo_scope::{Axis, Motion, ScopeError, Stage, StagePose};
use std::time::{Duration, Instant};

/// From its "ok" to a move a board takes so long at most until the move is in its plan; it is asked so often.
const PLANS_WITHIN: Duration = Duration::from_millis(150);
const PLAN_ASKINGS: u32 = 6;

impl GcodeStage {
    pub(super) fn poll_in(&self, ex: &mut Exchange<'_>) -> Result<Motion, ScopeError> {
        if !self.homing_ended(ex, GLANCE)? {
            return Ok(Motion::Moving);
        }
        let doing = lock(&self.doing).clone();
        let (goal, seen, since) = match doing {
            Doing::Stopped => return Ok(Motion::Stopped),
            Doing::Moving { goal, seen, since } => (goal, seen, since),
            _ => return Ok(Motion::Settled),
        };
        let now = self.steps(ex)?;
        let at = |(goal, now): (&Option<i64>, &i64)| goal.is_none_or(|g| (g - now).abs() <= 1);
        if goal.iter().zip(&now).all(at) {
            self.talk.ask(ex, &Command::Finish, None)?;
            *lock(&self.doing) = Doing::Nothing;
            return Ok(Motion::Settled);
        }
        if now == seen && since.elapsed() > self.stall_timeout {
            *lock(&self.doing) = Doing::Stopped;
            return Ok(Motion::Stopped);
        }
        let since = if now == seen { since } else { Instant::now() };
        *lock(&self.doing) = Doing::Moving {
            goal,
            seen: now,
            since,
        };
        Ok(Motion::Moving)
    }

    /// The motors asked for and their places in the board's units, inside the travel.
    pub(super) fn targets(&self, to: &StagePose) -> Result<Vec<(usize, f64)>, ScopeError> {
        self.info.check_goal(to)?;
        let mut targets = Vec::new();
        for axis in Axis::ALL {
            let Some(asked) = to.si(axis) else { continue };
            let set = self.motors.iter().position(|m| m.axis == Some(axis));
            let set = set.ok_or(ScopeError::NoSuchAxis { axis })?;
            targets.push((set, asked * 1e3));
        }
        Ok(targets)
    }

    /// Starts a move of motors to places in the board's units.
    pub(super) fn start(
        &self,
        part: Part,
        targets: &[(usize, f64)],
        feed: f64,
    ) -> Result<(), ScopeError> {
        let stops = self.session.stops();
        let mut ex = self.session.exchange()?;
        if self.poll_in(&mut ex)? == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        if part == Part::Stage {
            self.check_homed()?;
        }
        if targets.is_empty() {
            return Ok(());
        }
        let mut goal = vec![None; self.motors.len()];
        for (at, place) in targets {
            goal[*at] = Some(self.motors[*at].steps(*place));
        }
        let seen = self.steps(&mut ex)?;
        // Moving from here on, should the answer not come.
        let before = std::mem::replace(
            &mut *lock(&self.doing),
            Doing::Moving {
                goal,
                seen,
                since: Instant::now(),
            },
        );
        let named = targets.iter().map(|(at, v)| (self.motors[*at].letter, *v));
        let named: Vec<(char, f64)> = named.collect();
        let go = Command::Move {
            to_mm: &named,
            feed_mm_per_min: feed,
        };
        if let Err(e) = self.talk.ask(&mut ex, &go, Some(stops)) {
            *lock(&self.doing) = before;
            return Err(e);
        }
        // Firmware clips to its own limits without a word; and some says "ok" a moment before it plans.
        let mut is_planned = false;
        for asking in 0..PLAN_ASKINGS {
            if asking > 0 {
                std::thread::sleep(PLANS_WITHIN / PLAN_ASKINGS);
            }
            let report = self.talk.position(&mut ex)?;
            is_planned = named.iter().all(|(letter, place)| {
                let there = report.planned_mm_of(*letter).unwrap_or(f64::NAN);
                (there - place).abs() <= PLAN_TOLERANCE_MM
            });
            // A stop meanwhile has changed the plan.
            if is_planned || self.session.stops() != stops {
                break;
            }
        }
        if self.session.stops() == stops && !is_planned {
            drop(ex);
            self.stop()?;
            return Err(device(
                "the board shortened the move to limits of its own; it was stopped. \
                 Bring the limits in the settings inside those of the firmware",
            ));
        }
        Ok(())
    }

    /// Waits until the steppers stand still, and says whether they do.
    pub(super) fn wait_still(&self, ex: &mut Exchange<'_>) -> Result<bool, ScopeError> {
        let give_up = Instant::now() + self.stop_timeout;
        let mut seen = self.steps(ex)?;
        loop {
            std::thread::sleep(self.still_window);
            let now = self.steps(ex)?;
            if now == seen {
                return Ok(true);
            }
            if Instant::now() > give_up {
                return Ok(false);
            }
            seen = now;
        }
    }
}

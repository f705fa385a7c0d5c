//! What a loop tries, once each, before it ends: it waits for a drift to settle, and comes from the other side.

use super::convergence::Standing;
use super::criteria::Criteria;
use super::sight::{Located, Sight};
use super::state::Servo;
use crate::event::tell;
use crate::one_side::{move_from_below, move_from_one_side};
use crate::{Attempt, Event, Remark, ServoEnd, ServoError, ServoTask, Sink, Velocity};
use scopeservo_scope::{Goals, Instrument, StagePose};

/// A drift is waited for so long, s...
const SETTLES_S: f64 = 20.0;
/// ...while the target lies within this share of the view's shorter side from its middle.
const IN_VIEW: f64 = 0.3;

impl Servo {
    /// Where a loop stands, unless something is left to try first.
    pub(crate) fn unless_tried(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sink: &mut dyn Sink,
        test: &Criteria<'_>,
        standing: Standing,
    ) -> Standing {
        match standing {
            Standing::Ended(ServoEnd::Drifting { um_per_s, ref last }) => {
                let side_um = 1e6 * task.view_calibration.shorter_side_m();
                let in_view = last.error.distance_um() <= IN_VIEW * side_um;
                match in_view && self.waits(task, scope, sink, um_per_s) {
                    true => Standing::Inside,
                    false => standing,
                }
            }
            // From below, where that was not tried; else as near as moves do come may be near enough.
            Standing::Scattered(spread, _) => {
                self.convergence.scatter.clear();
                if self.tries(task, scope, sink, Attempt::OtherSide) {
                    self.from_below = true;
                    return Standing::Outside;
                }
                if self.convergence.spread.is_none() && test.may_scatter(&spread) {
                    self.convergence.spread = Some(spread);
                    return Standing::Outside;
                }
                standing
            }
            _ => standing,
        }
    }

    /// Whether a drift is waited for.
    fn waits(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sink: &mut dyn Sink,
        um_per_s: f64,
    ) -> bool {
        // How far it drifts meanwhile is no divergence.
        self.convergence.begin_anew();
        let now_s = scope.clock().now().seconds();
        match self.convergence.settles_until_s {
            // A clock that was started anew after a kill knows nothing of the time before.
            Some(until_s) => (0.0..=SETTLES_S).contains(&(until_s - now_s)),
            None => {
                let waits = self.tries(task, scope, sink, Attempt::DriftWaitedFor { um_per_s });
                self.convergence.settles_until_s = waits.then_some(now_s + SETTLES_S);
                waits
            }
        }
    }

    /// From now on moves come from below, where that was not tried: the stage goes where it stands once more.
    pub(crate) fn comes_from_below(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<bool, ServoError> {
        if !self.tries(task, scope, sink, Attempt::OtherSide) {
            return Ok(false);
        }
        self.from_below = true;
        let present = scope.gate().position()?;
        move_from_below(scope, &present, task.view_calibration)?;
        // Seen from the other side all lies elsewhere.
        self.watch.promise = None;
        self.convergence.begin_anew();
        self.expected.forget_angle();
        self.proof.asks_again();
        Ok(true)
    }

    /// Goes to a place, from below where moves do.
    pub(crate) fn goes(
        &self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        to: &StagePose,
    ) -> Result<StagePose, ServoError> {
        match self.from_below {
            true => move_from_below(scope, to, task.view_calibration),
            false => Ok(scope.move_to(to)?),
        }
    }

    /// Takes an attempt, and tells it; whether it is the first of its kind in this run.
    fn tries(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sink: &mut dyn Sink,
        attempt: Attempt,
    ) -> bool {
        let objective = task.objective().clone();
        let first = self.watch.tries(&objective, &attempt);
        if first {
            let remark = Remark::Tried { objective, attempt };
            tell(scope, sink, Event::Remarked { remark });
        }
        first
    }

    /// What the stage does next, as far as moves are trusted, and where that leads: the first way that the rules allow.
    pub(crate) fn next_step(
        &self,
        task: &ServoTask<'_>,
        (sight, located): (&Sight<'_>, &Located),
        turns: bool,
        goals: &Goals<'_>,
    ) -> (Velocity, StagePose) {
        let velocity = task.velocity(&located.pose, turns);
        let ways = self.watch.limited(velocity, task.view_calibration);
        let steps = ways.map(|velocity| (velocity, sight.goal(&velocity)));
        let allowed = steps.iter().find(|(_, goal)| goals.allow(goal));
        *allowed.unwrap_or(&steps[0])
    }

    /// Stage: Eq. (5).
    pub(crate) fn go_on(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        test: &Criteria<'_>,
        (sight, located): (&Sight<'_>, &Located),
    ) -> Result<(), ServoError> {
        let goals = scope.gate().goals()?;
        let (velocity, goal) = self.next_step(task, (sight, located), test.turns, &goals);
        self.moving(task, scope, test, (sight, located), (&velocity, &goal));
        match self.from_below {
            true => move_from_below(scope, &goal, task.view_calibration)?,
            false => move_from_one_side(scope, &sight.present, &goal, task.view_calibration)?,
        };
        Ok(())
    }
}

//! Below the target's own magnification: one measurement and one move, where that surely brings the target into a higher objective's view.

use super::criteria::Criteria;
use super::sight::{Located, Sight};
use super::state::Servo;
use crate::one_side::move_from_one_side;
use crate::{HandOver, PoseEstimate, ServoEnd, ServoError, ServoTask, Velocity};
use scopeservo_geometry::Mat2;
use scopeservo_scope::Instrument;

/// So many standard deviations are sure.
const SIGMAS: f64 = 3.0;

impl HandOver {
    /// The velocity that hands over, and within how much of its goal the next view then lies for sure, m; `None` where one step does not do
    /// it, or nobody knows.
    pub(super) fn step(
        &self,
        task: &ServoTask<'_>,
        estimate: &PoseEstimate,
        turns: bool,
    ) -> Option<(Velocity, f64)> {
        let mut aimed = *estimate;
        // The next objective looks aside as the view is turned in the end.
        let left_rad = if turns { 0.0 } else { estimate.error.theta_rad };
        let offset_m = Mat2::rotation(left_rad) * self.offset_m;
        for (k, t) in aimed.error.t_m.iter_mut().enumerate() {
            *t -= self.beside_m[k] - offset_m[k];
        }
        let velocity = task.velocity(&aimed, turns);
        let all = |asked: f64, goes: f64| (asked.abs() - goes.abs()).abs() <= 1e-9;
        let (error, way_m) = (&aimed.error, velocity.distance_um() * 1e-6);
        if !all(error.distance_um() * 1e-6, way_m)
            || turns && !all(error.theta_rad, velocity.theta_rad)
        {
            return None;
        }
        let move_m = task
            .view_calibration
            .move_sigma_m(way_m, velocity.theta_rad)?;
        let [x, y, _] = estimate.sigma();
        let variance = 0.5 * (x * x + y * y) + move_m * move_m + self.change_m * self.change_m;
        let lands_m = SIGMAS * variance.sqrt();
        (lands_m <= self.within_m).then_some((velocity, lands_m))
    }
}

impl Servo {
    /// Moves to where another objective takes over, where one step surely does it: the highest one that can.
    pub(crate) fn hand_over(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        test: &Criteria<'_>,
        (sight, located): (&Sight<'_>, &Located),
    ) -> Result<Option<ServoEnd>, ServoError> {
        if !self.watch.trusts() {
            return Ok(None);
        }
        let goals = scope.gate().goals()?;
        let found = task.hand_overs.iter().find_map(|over| {
            let (velocity, lands_m) = over.step(task, &located.pose, test.turns)?;
            let goal = sight.goal(&velocity);
            // At the end of an axis there may be no room to look a little aside.
            goals.allow(&goal).then_some((over, goal, lands_m))
        });
        let Some((over, goal, lands_m)) = found else {
            return Ok(None);
        };
        let last = self.convergence.result(sight.measured(located, task));
        // As the next objective would have seen it.
        let mut seen = located.pose;
        let offset_m = Mat2::rotation(seen.error.theta_rad) * over.offset_m;
        for (t, offset) in seen.error.t_m.iter_mut().zip(offset_m) {
            *t += offset;
        }
        self.promise(task, scope, (sight, &seen), &goal, over.change_m);
        move_from_one_side(scope, &sight.present, &goal, task.view_calibration)?;
        Ok(Some(ServoEnd::HandedOver {
            to: over.to.clone(),
            lands_within_um: 1e6 * lands_m,
            last,
        }))
    }
}

//! Below the target's own magnification: one measurement and one move, where that surely brings the target into the next view.

use super::sight::{Located, Sight};
use super::state::Servo;
use crate::one_side::move_from_one_side;
use crate::{Calibration, Known, PoseEstimate, ServoEnd, ServoError, ServoTask, Velocity};
use scopeservo_geometry::Vec2;
use scopeservo_scope::{Instrument, Objective, ObjectiveId};

/// A place counts as in the next view when it surely lies within this share of the view's shorter side from its middle.
const WITHIN: f64 = 0.3;
/// So many standard deviations are sure.
const SIGMAS: f64 = 3.0;
/// How far the centres of two objectives may lie apart where nobody has measured it, and by how much each change of objective moves the view,
/// standard deviations, m.
const PARCENTRIC_M: f64 = 20e-6;
const CHANGE_M: f64 = 2e-6;
/// The view of the target's own objective begins so far from its goal, in pixels of the target: the last step then shows what moves with the
/// specimen, and what is on the camera.
const BESIDE_PX: f64 = 30.0;

/// An objective that may take over from one below it, and what that takes.
#[derive(Debug, Clone, PartialEq)]
pub struct HandOver {
    /// The objective.
    pub to: ObjectiveId,
    /// Where the view's centre is to lie from the target's, in camera axes of the target, m.
    pub aim_m: Vec2,
    /// Standard deviation of where its view lies from the one below, each coordinate, m.
    pub change_m: f64,
    /// How far from its goal the target is surely in its view, m.
    pub within_m: f64,
}

impl HandOver {
    /// From one objective to another above it. `offset_um`: where that looks beside this one, um in stage axes, where it is known.
    pub(crate) fn between(
        here: &Calibration,
        next: &Objective,
        offset_um: Option<[Known; 2]>,
        target: &Calibration,
    ) -> Self {
        let side_px = here.image_size_px[0].min(here.image_size_px[1]) as f64;
        let (offset_m, change_m) = match offset_um {
            Some(known) => {
                let sigma_m = known.map(|k| 1e-6 * k.sigma);
                let offset_m = known.map(|k| 1e-6 * k.value);
                (offset_m, sigma_m[0].max(sigma_m[1]).hypot(CHANGE_M))
            }
            None => ([0.0; 2], PARCENTRIC_M),
        };
        let beside_m = match next.id == target.objective {
            true => BESIDE_PX * target.um_per_px() * 1e-6 / std::f64::consts::SQRT_2,
            false => 0.0,
        };
        // What the next objective shows in its middle lies beside the middle of this one.
        let camera_from_stage = target.stage_from_camera().transpose();
        Self {
            to: next.id.clone(),
            aim_m: camera_from_stage * offset_m.map(|v| -v - beside_m),
            change_m,
            within_m: WITHIN * side_px * 1e-6 * next.nominal_um_per_px,
        }
    }

    /// The velocity that hands over, and within how much of its goal the next view then lies for sure, m; `None` where one step does not do
    /// it, or nobody knows.
    fn step(
        &self,
        task: &ServoTask<'_>,
        estimate: &PoseEstimate,
        turns: bool,
    ) -> Option<(Velocity, f64)> {
        let mut aimed = *estimate;
        for (t, aim) in aimed.error.t_m.iter_mut().zip(self.aim_m) {
            *t -= aim;
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
        sight: &Sight<'_>,
        located: &Located,
    ) -> Result<Option<ServoEnd>, ServoError> {
        let turns = task.criteria(scope).turns;
        let found = task.hand_overs.iter().find_map(|over| {
            let (velocity, lands_m) = over.step(task, &located.pose, turns)?;
            Some((over, velocity, lands_m))
        });
        let Some((over, velocity, lands_m)) = found else {
            return Ok(None);
        };
        let last = self.convergence.result(sight.measured(located, task));
        let goal = sight.goal(&velocity);
        let change_m = over.change_m;
        self.promise(task, scope, (sight, located), &goal, change_m);
        move_from_one_side(scope, &sight.present, &goal, task.view_calibration)?;
        Ok(Some(ServoEnd::HandedOver {
            to: over.to.clone(),
            lands_within_um: 1e6 * lands_m,
            last,
        }))
    }
}

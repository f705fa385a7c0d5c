//! Where the target may lie in a view that does not say so for sure, and where the stage goes to see it with a higher objective.

use super::places::{LEAST_HEIGHT, MayLie, MayLieAt};
use super::sight::View;
use super::state::Servo;
use super::turning::{goal, turning};
use crate::localize::says_nothing;
use crate::vision::centre_px;
use crate::{
    Expected, HandOver, Law, PlanarPose, PoseError, PoseEstimate, ServoEnd, ServoError, ServoTask,
    Velocity, control_law, pose_error,
};
use scopeservo_geometry::Affine2;
use scopeservo_registration::correlation::Perhaps;
use scopeservo_scope::{Axis, Instrument, ObjectiveId};

/// What is less like the target than [`LEAST_HEIGHT`], or than this share of what is most like it, is not looked at.
const LEAST_SHARE: f32 = 0.7;
/// Such a place is known to this, standard deviations, pixels of the view and rad.
const PLACE_PX: f64 = 3.0;
const PLACE_RAD: f64 = 0.02;

impl Servo {
    /// Where the target may lie after it was not found, by what another objective of the same medium sees.
    pub(crate) fn may_lie(
        &self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        view: &View,
        end: &ServoEnd,
    ) -> Result<Option<MayLieAt>, ServoError> {
        let unclear = matches!(end, ServoEnd::Lost(reason) if says_nothing(reason));
        if !unclear || self.seen() || task.options.law != Law::Direct {
            return Ok(None);
        }
        let medium = |id: &ObjectiveId| scope.objective(id).map(|o| o.immersion);
        let here = medium(task.objective())?;
        let of_same = |over: &&HandOver| medium(&over.to).is_ok_and(|there| there == here);
        if !task.hand_overs.iter().any(|over| of_same(&over)) {
            return Ok(None);
        }
        let looked = Expected {
            prior: task.before_any_frame(),
            fixed: &self.proof.fixed,
        };
        let all = task.perhaps(&view.image, &looked);
        let highest = all.first().map_or(0.0, |first| first.height);
        let likely = |p: &&Perhaps| p.height >= LEAST_HEIGHT.max(LEAST_SHARE * highest);
        let place_m = 1e-6 * PLACE_PX * task.view_calibration.um_per_px();
        let variances = [place_m, place_m, PLACE_RAD].map(|sigma| sigma * sigma);
        let size = [view.image.width(), view.image.height()];
        let estimate = |p: &Perhaps| {
            let mut covariance = [[0.0; 3]; 3];
            (0..3).for_each(|k| covariance[k][k] = variances[k]);
            let error = error_of(task, (&p.target_from_view, size))?;
            Some((PoseEstimate { error, covariance }, p.height))
        };
        let likely: Vec<(PoseEstimate, f32)> =
            all.iter().filter(likely).filter_map(estimate).collect();
        let turns = scope.gate().info().axis(Axis::Rz).is_some();
        // The highest that surely sees the most likely place.
        let first = likely.first().map(|(estimate, _)| estimate);
        let sees = |over: &&HandOver| first.is_some_and(|e| over.step(task, e, turns).is_some());
        let Some(over) = task.hand_overs.iter().filter(of_same).find(sees) else {
            return Ok(None);
        };
        let (goals, present) = (scope.gate().goals()?, scope.gate().position()?);
        let mut at = MayLieAt {
            to: over.to.clone(),
            places: Vec::new(),
            beyond: Vec::new(),
        };
        for (estimate, height) in likely {
            let step = over
                .step(task, &estimate, turns)
                .map(|(velocity, _)| velocity);
            let velocity =
                step.unwrap_or_else(|| control_law(&estimate.error, 1.0).on_stage_that(turns));
            let stage = goes(task, scope, &velocity, &PlanarPose::from(&present));
            let place = MayLie { stage, height };
            match step.is_some() && goals.allow(&stage.request(&present)) {
                true => at.places.push(place),
                false => at.beyond.push(place),
            }
        }
        Ok((!at.places.is_empty()).then_some(at))
    }
}

/// Where the stage goes for what is seen in a view from `present`, of so many pixels, to lie as the target was saved.
pub(crate) fn leads_to(
    task: &ServoTask<'_>,
    scope: &Instrument,
    seen: (&Affine2, [usize; 2]),
    present: &PlanarPose,
) -> Option<PlanarPose> {
    let turns = scope.gate().info().axis(Axis::Rz).is_some();
    // All the way in one step.
    let velocity = control_law(&error_of(task, seen)?, 1.0).on_stage_that(turns);
    Some(goes(task, scope, &velocity, present))
}

fn error_of(
    task: &ServoTask<'_>,
    (target_from_view, size): (&Affine2, [usize; 2]),
) -> Option<PoseError> {
    let target = &task.target.features;
    pose_error(
        target_from_view,
        task.view_calibration,
        task.target_calibration,
        centre_px(size[0], size[1]),
        centre_px(target.width, target.height),
    )
}

fn goes(
    task: &ServoTask<'_>,
    scope: &Instrument,
    velocity: &Velocity,
    present: &PlanarPose,
) -> PlanarPose {
    let turning = turning(scope);
    let goes = (scope.gate().info().kinematics, turning.as_ref());
    goal(goes, present, velocity, task.view_calibration)
}

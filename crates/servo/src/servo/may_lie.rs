//! Where the target may lie in a view that does not say so for sure, and where the stage goes to see it with a higher objective.

use super::hand_over::HandOver;
use super::places::{LEAST_HEIGHT, MayLie, MayLieAt};
use super::sight::View;
use super::state::Servo;
use super::turning::{goal, turning};
use crate::localize::says_nothing;
use crate::vision::centre_px;
use crate::{Expected, Law, PlanarPose, PoseEstimate, ServoEnd, ServoError, ServoTask, pose_error};
use scopeservo_geometry::{Affine2, Vec2};
use scopeservo_registration::correlation::Perhaps;
use scopeservo_scope::{Axis, Instrument, ObjectiveId};

/// What is less like the target than [`LEAST_HEIGHT`], or than this share of what is most like it, is not looked at,
const LEAST_SHARE: f32 = 0.7;
/// and no more places than these are.
const MOST: usize = 6;
/// Such a place is known to this, standard deviation, pixels of the view.
const PLACE_PX: f64 = 3.0;
/// So many standard deviations are sure.
const SIGMAS: f64 = 3.0;

impl Servo {
    /// Where the target may lie after it was not found: within the stage's reach, and by what another objective of the same medium sees.
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
        let place_m = 1e-6 * PLACE_PX * task.view_calibration.um_per_px();
        let sees = |over: &&HandOver| {
            medium(&over.to).is_ok_and(|there| there == here)
                && SIGMAS * f64::hypot(place_m, over.change_m) <= over.within_m
        };
        let Some(over) = task.hand_overs.iter().find(sees) else {
            return Ok(None);
        };
        let looked = Expected {
            prior: task.before_any_frame(),
            fixed: &self.proof.fixed,
        };
        let all = task.perhaps(&view.image, &looked);
        let highest = all.first().map_or(0.0, |first| first.height);
        let likely = |p: &&Perhaps| p.height >= LEAST_HEIGHT.max(LEAST_SHARE * highest);
        let (goals, present) = (scope.gate().goals()?, scope.gate().position()?);
        let size = [view.image.width(), view.image.height()];
        let mut places = Vec::new();
        for perhaps in all.iter().filter(likely).take(MOST) {
            let seen = (&perhaps.target_from_view, size);
            let to = leads_to(task, scope, seen, over.aim_m, &PlanarPose::from(&present));
            let stage = to.filter(|to| goals.allow(&to.request(&present)));
            places.extend(stage.map(|stage| MayLie {
                stage,
                height: perhaps.height,
            }));
        }
        Ok((!places.is_empty()).then(|| MayLieAt {
            to: over.to.clone(),
            places,
        }))
    }
}

/// Where the stage goes for what is seen in a view from `present`, of so many pixels, to lie as the target was saved, or beside that by `aim_m`.
pub(crate) fn leads_to(
    task: &ServoTask<'_>,
    scope: &Instrument,
    (target_from_view, size): (&Affine2, [usize; 2]),
    aim_m: Vec2,
    present: &PlanarPose,
) -> Option<PlanarPose> {
    let target = &task.target.features;
    let mut error = pose_error(
        target_from_view,
        task.view_calibration,
        task.target_calibration,
        centre_px(size[0], size[1]),
        centre_px(target.width, target.height),
    )?;
    for (t, aim) in error.t_m.iter_mut().zip(aim_m) {
        *t -= aim;
    }
    let info = scope.gate().info();
    let aimed = PoseEstimate {
        error,
        covariance: [[0.0; 3]; 3],
    };
    let velocity = task.velocity(&aimed, info.axis(Axis::Rz).is_some());
    let turning = turning(scope);
    let goes = (info.kinematics, turning.as_ref());
    Some(goal(goes, present, &velocity, task.view_calibration))
}

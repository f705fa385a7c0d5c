//! One frame of the loop, understood: features, the transform to the target, the pose error.

use super::convergence::Measured;
use crate::hand_eye::pose_sigma;
use crate::proof::{FixedPlaces, Station};
use crate::vision::{centre_px, features, gray};
use crate::{
    Event, PlanarPose, PoseEstimate, ServoError, ServoTask, Velocity, motion_of, pose_after,
    pose_estimate,
};
use scopeservo_registration::{Estimate, Matched, NotFound, Prior};
use scopeservo_scope::{Frame, Instrument, StagePose};
use scopeservo_sift::{Features, GrayImage};
use std::borrow::Cow;

/// A frame and its features.
pub(crate) struct View {
    pub(crate) image: GrayImage,
    /// All its features.
    pub(crate) all: Features,
    /// Those that are not known to be fixed to the camera, when some are.
    free: Option<Features>,
    pub(crate) sequence: u64,
    time_s: f64,
}

impl View {
    pub(crate) fn of(
        frame: &Frame,
        scope: &Instrument,
        task: &ServoTask<'_>,
        fixed: &FixedPlaces,
    ) -> Result<Self, ServoError> {
        let image = gray(scope, frame)?;
        let all = features(&image, &task.vision.view)?;
        let free = match fixed.without(&all) {
            Cow::Borrowed(_) => None,
            Cow::Owned(free) => Some(free),
        };
        Ok(Self {
            image,
            all,
            free,
            sequence: frame.sequence,
            time_s: frame.exposure_start.seconds(),
        })
    }

    /// The features that are not known to be fixed to the camera.
    pub(crate) fn features(&self) -> &Features {
        self.free.as_ref().unwrap_or(&self.all)
    }
}

/// The transform that is believed, and the pose error that it means.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Located {
    pub(crate) estimate: Estimate,
    pub(crate) pose: PoseEstimate,
}

/// A view that was found in the target.
pub(crate) struct Sight<'a> {
    pub(crate) view: &'a View,
    /// The target's features that are not known to be fixed to the camera.
    pub(crate) target: Cow<'a, Features>,
    pub(crate) matched: Matched,
    pub(crate) prior: Prior,
    /// Where the stage says that the frame was taken.
    pub(crate) present: StagePose,
    pub(crate) station: Station<'a>,
    pub(crate) located: Located,
}

impl<'a> Sight<'a> {
    /// Matches and fits the view to the target, and computes the pose error.
    pub(crate) fn of(
        view: &'a View,
        task: &ServoTask<'a>,
        scope: &Instrument,
        prior: Prior,
        present: StagePose,
        fixed: &FixedPlaces,
    ) -> Result<Self, NotFound> {
        let target = fixed.without(&task.target.features);
        let options = &task.vision.registration;
        let matched = Matched::of(view.features(), &target, &prior, options);
        let estimate = matched.registration.outcome.clone()?;
        let pose = pose_of(&estimate, view.features(), &target, task);
        let pose = pose.ok_or(NotFound::NoAgreement {
            matches: matched.registration.matches,
        })?;
        let info = scope.gate().info();
        Ok(Self {
            view,
            target,
            matched,
            prior,
            present,
            station: Station {
                pose: PlanarPose::from(&present),
                calibration: task.view_calibration,
                kinematics: info.kinematics,
                pose_sigma: pose_sigma(info),
                still: task.target.moved.is_none(),
            },
            located: Located { estimate, pose },
        })
    }

    /// The pose error that another transform means.
    pub(crate) fn pose(&self, estimate: &Estimate, task: &ServoTask<'_>) -> Option<PoseEstimate> {
        pose_of(estimate, self.view.features(), &self.target, task)
    }

    /// The same view with another transform to be believed.
    pub(crate) fn relocated(&self, estimate: Estimate, task: &ServoTask<'_>) -> Located {
        let pose = self.pose(&estimate, task);
        Located {
            pose: pose.unwrap_or(self.located.pose),
            estimate,
        }
    }

    /// The middle of the view and of the target.
    pub(crate) fn centres(&self) -> ([f64; 2], [f64; 2]) {
        centres(self.view.features(), &self.target)
    }

    /// What the convergence test takes of it.
    pub(crate) fn measured(&self, located: &Located, task: &ServoTask<'_>) -> Measured {
        let estimate = &located.estimate;
        let um_per_px = task.target_calibration.um_per_px();
        Measured {
            error: located.pose.error,
            sigma_um: estimate.sigma_px * std::f64::consts::SQRT_2 * um_per_px,
            sigma_deg: estimate.sigma_angle_rad.to_degrees(),
            inliers: self.matched.registration.inliers,
            time_s: self.view.time_s,
        }
    }

    /// Where the stage has to go to carry out `velocity` for one iteration: Eq. (5).
    pub(crate) fn goal(&self, velocity: &Velocity) -> StagePose {
        let motion = motion_of(velocity, self.station.calibration);
        let to = pose_after(self.station.kinematics, &self.station.pose, &motion);
        to.request(&self.present)
    }

    /// The event that tells of it, with the velocity that answers it.
    pub(crate) fn event(
        &self,
        task: &ServoTask<'_>,
        iteration: usize,
        velocity: Velocity,
        converged: bool,
    ) -> Event {
        let registration = &self.matched.registration;
        Event::Iteration {
            objective: task.objective().clone(),
            iteration,
            sequence: self.view.sequence,
            stage: self.present,
            error: self.located.pose.error,
            velocity,
            target_from_view: self.located.estimate.target_from_view,
            inliers: registration.inliers,
            matches: registration.matches,
            sigma_px: self.located.estimate.sigma_px,
            pairs: registration.pairs.clone(),
            converged,
        }
    }
}

fn centres(view: &Features, target: &Features) -> ([f64; 2], [f64; 2]) {
    (
        centre_px(view.width, view.height),
        centre_px(target.width, target.height),
    )
}

fn pose_of(
    estimate: &Estimate,
    view: &Features,
    target: &Features,
    task: &ServoTask<'_>,
) -> Option<PoseEstimate> {
    let (centre, target_centre) = centres(view, target);
    let (view, target) = (task.view_calibration, task.target_calibration);
    pose_estimate(estimate, view, target, centre, target_centre)
}

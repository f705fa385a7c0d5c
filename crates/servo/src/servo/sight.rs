//! One frame of the loop, understood: where it lies in the target, and the pose error.

use super::convergence::Measured;
use super::pixels::Pixels;
use super::turning::{goal, turning};
use crate::hand_eye::pose_sigma;
use crate::pixels_seen::PixelsSeen;
use crate::proof::{FixedPlaces, Station};
use crate::vision::{centre_px, gray};
use crate::{
    Event, Expected, Measurement, PlanarPose, PoseEstimate, Promised, ServoError, ServoTask,
    Velocity, pose_estimate,
};
use scopeservo_features::GrayImage;
use scopeservo_geometry::Vec2;
use scopeservo_registration::pixels::Sharpness;
use scopeservo_registration::{Estimate, NotFound, Prior};
use scopeservo_scope::{AxisRange, Frame, Instrument, StagePose};

/// A frame as it is looked at.
pub(crate) struct View {
    pub(crate) image: GrayImage,
    pub(crate) sequence: u64,
    time_s: f64,
}

impl View {
    pub(crate) fn of(frame: &Frame, scope: &Instrument) -> Result<Self, ServoError> {
        Ok(Self {
            image: gray(scope, frame)?,
            sequence: frame.sequence,
            time_s: frame.exposure_start.seconds(),
        })
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
    pub(crate) measured: Measurement,
    pub(crate) prior: Prior,
    /// Where the stage says that the frame was taken.
    pub(crate) present: StagePose,
    pub(crate) station: Station<'a>,
    pub(crate) located: Located,
    pixels: Option<PixelsSeen>,
    target_size: [usize; 2],
    /// Where the rotation may go.
    turning: Option<AxisRange>,
}

/// So near to its goal a view may have arrived, and the pixels are asked, too, pixels of the view.
const NEAR_PX: f64 = 12.0;
/// Two transforms are one within so many standard deviations of their difference, and so many pixels besides.
const ONE_SIGMAS: f64 = 3.0;
const ONE_PX: f64 = 0.05;

impl<'a> Sight<'a> {
    /// Locates the target in the view, and computes the pose error. The inner result has the reason when it is not found.
    pub(crate) fn of(
        view: &'a View,
        task: &ServoTask<'a>,
        scope: &Instrument,
        prior: Prior,
        present: StagePose,
        fixed: &FixedPlaces,
    ) -> Result<Result<Self, NotFound>, ServoError> {
        let expected = Expected { prior, fixed };
        let located = task.locate(&view.image, &expected)?;
        Ok(located.and_then(|measured| {
            let pixels = Pixels::of(&view.image, task, fixed);
            let seen = (measured, pixels.as_ref());
            Self::understood(view, task, scope, seen, (prior, present))
        }))
    }

    fn understood(
        view: &'a View,
        task: &ServoTask<'a>,
        scope: &Instrument,
        (measured, pixels): (Measurement, Option<&Pixels<'_>>),
        (prior, present): (Prior, StagePose),
    ) -> Result<Self, NotFound> {
        let mut estimate = measured.estimate.clone();
        let mut seen = PixelsSeen::default();
        match pixels.and_then(|pixels| pixels.refined(task, &measured)) {
            Some(Ok(refined)) => {
                seen.refined_blocks = Some(refined.blocks);
                estimate = refined.estimate;
            }
            Some(Err(why)) => seen.abstained = Some(why),
            None => {}
        }
        let target_size = [task.target.features.width, task.target.features.height];
        let centres = centres(&measured, target_size);
        let pose = pose_of(&estimate, centres, task).ok_or(NotFound::NoAgreement {
            matches: measured.registration.matches,
        })?;
        let near_um = NEAR_PX * task.view_calibration.um_per_px();
        if let Some(pixels) = pixels.filter(|_| pose.error.distance_um() <= near_um) {
            seen.evidence = Some(pixels.evidence(&estimate, &measured));
        }
        if let Some(reason) = seen.contradiction() {
            return Err(reason);
        }
        seen.sharpness = pixels.and_then(|pixels| pixels.sharpness(&estimate));
        let info = scope.gate().info();
        Ok(Self {
            view,
            measured,
            prior,
            present,
            station: Station {
                pose: PlanarPose::from(&present),
                calibration: task.view_calibration,
                kinematics: info.kinematics,
                pose_sigma: task.view_calibration.pose_sigma(pose_sigma(info)),
                still: task.target.moved.is_none(),
            },
            located: Located { estimate, pose },
            pixels: pixels.map(|_| seen),
            target_size,
            turning: turning(scope),
        })
    }

    /// The pose error that another transform means.
    pub(crate) fn pose(&self, estimate: &Estimate, task: &ServoTask<'_>) -> Option<PoseEstimate> {
        pose_of(estimate, self.centres(), task)
    }

    /// The same view with another transform to be believed.
    pub(crate) fn relocated(&self, estimate: Estimate, task: &ServoTask<'_>) -> Located {
        let pose = self.pose(&estimate, task);
        Located {
            pose: pose.unwrap_or(self.located.pose),
            estimate,
        }
    }

    /// The view with the transform of the places that moved; what the pixels made of all places is better, where that is the same.
    pub(crate) fn proved(&self, moved: Estimate, task: &ServoTask<'_>) -> Located {
        let is = &self.located.estimate;
        let refined = self
            .pixels
            .as_ref()
            .is_some_and(|p| p.refined_blocks.is_some());
        match refined && is_one(is, &moved, self.centres().0) {
            true => self.located.clone(),
            false => self.relocated(moved, task),
        }
    }

    /// How sharp the view is beside the target.
    pub(crate) fn sharpness(&self) -> Option<&Sharpness> {
        self.pixels.as_ref()?.sharpness.as_ref()
    }

    /// The middle of the view and of the target.
    pub(crate) fn centres(&self) -> (Vec2, Vec2) {
        centres(&self.measured, self.target_size)
    }

    /// What the convergence test takes of it.
    pub(crate) fn measured(&self, located: &Located, task: &ServoTask<'_>) -> Measured {
        let estimate = &located.estimate;
        let um_per_px = task.target_calibration.um_per_px();
        Measured {
            error: located.pose.error,
            sigma_um: estimate.sigma_px * std::f64::consts::SQRT_2 * um_per_px,
            sigma_deg: estimate.sigma_angle_rad.to_degrees(),
            inliers: self.measured.registration.inliers,
            time_s: self.view.time_s,
        }
    }

    /// Where the stage has to go to carry out `velocity` for one iteration.
    pub(crate) fn goal(&self, velocity: &Velocity) -> StagePose {
        let Station {
            pose,
            calibration,
            kinematics,
            ..
        } = &self.station;
        let goes = (*kinematics, self.turning.as_ref());
        goal(goes, pose, velocity, calibration).request(&self.present)
    }

    /// The event that tells of it, with the velocity that answers it, in an iteration; whether the stage turns, and whether it passes.
    pub(crate) fn event(
        &self,
        task: &ServoTask<'_>,
        (iteration, turns, converged): (usize, bool, bool),
        promised: Option<Promised>,
    ) -> Event {
        let registration = &self.measured.registration;
        Event::Iteration {
            objective: task.objective().clone(),
            iteration,
            sequence: self.view.sequence,
            stage: self.present,
            error: self.located.pose.error,
            velocity: task.velocity(&self.located.pose, turns),
            target_from_view: self.located.estimate.target_from_view,
            by: self.measured.by,
            inliers: registration.inliers,
            matches: registration.matches,
            sigma_px: self.located.estimate.sigma_px,
            pairs: registration.pairs.clone(),
            converged,
            pixels: self.pixels.clone().map(Box::new),
            promised: promised.map(Box::new),
        }
    }
}

/// Whether two transforms are the same within their uncertainties, by the middle of the view and by their angle.
fn is_one(a: &Estimate, b: &Estimate, centre: Vec2) -> bool {
    let [p, q] = [a, b].map(|e| e.target_from_view.apply(centre));
    let angle = |e: &Estimate| e.target_from_view.linear.rotation_angle();
    let Some((one, two)) = angle(a).zip(angle(b)) else {
        return false;
    };
    let turned = (one - two).sin().atan2((one - two).cos()).abs();
    let sigma_px = f64::hypot(a.sigma_px, b.sigma_px) * std::f64::consts::SQRT_2;
    f64::hypot(p[0] - q[0], p[1] - q[1]) <= ONE_SIGMAS * sigma_px + ONE_PX
        && turned <= ONE_SIGMAS * f64::hypot(a.sigma_angle_rad, b.sigma_angle_rad)
}

/// The middle of the view and of the target.
fn centres(measured: &Measurement, target: [usize; 2]) -> (Vec2, Vec2) {
    let [width, height] = measured.correspondences.view_size;
    (centre_px(width, height), centre_px(target[0], target[1]))
}

fn pose_of(
    estimate: &Estimate,
    (centre, target_centre): (Vec2, Vec2),
    task: &ServoTask<'_>,
) -> Option<PoseEstimate> {
    let (view, target) = (task.view_calibration, task.target_calibration);
    pose_estimate(estimate, view, target, centre, target_centre)
}

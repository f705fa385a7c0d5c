//! One view of a calibration: moved to, registered to the reference, without what is fixed to the camera.

use super::plan::STAYED;
use super::procedure::{TwoStep, no_reference};
use crate::event::tell;
use crate::hand_eye::Observation;
use crate::kinematics::PlanarPose;
use crate::proof::stays;
use crate::vision::{centre_px, grab, gray, same_objective};
use crate::{Event, FrameRole, ServoError, Sink};
use scopeservo_features::Features;
use scopeservo_geometry::Correspondence;
use scopeservo_registration::{Correspondences, Registration, register_correspondences};
use scopeservo_scope::Instrument;

impl TwoStep {
    /// Registers a view to the reference, without what is fixed to the camera: what stays where it is, when the view `moved` for sure;
    /// else what stayed in the translations.
    fn register(&mut self, view: &Features, moved: bool) -> Result<Registration, ServoError> {
        let reference = self.reference.as_ref().ok_or_else(no_reference)?;
        let options = &self.vision.registration;
        let prior = same_objective(1.5 * self.options.max_rotation_rad);
        let all = match Correspondences::of(&*self.vision.engine, view, reference, &prior, options)
        {
            Ok(all) => all,
            Err(reason) => return Ok(Registration::not_found(reason, 0)),
        };
        let on_camera = |&[_, train]: &[usize; 2], c: &Correspondence| match moved {
            true => stays(c),
            false => self.stayed.get(&train).is_some_and(|n| *n >= STAYED),
        };
        let fixed: Vec<usize> = all
            .those(on_camera)
            .indices
            .iter()
            .map(|pair| pair[1])
            .collect();
        let free = all.those(|[_, train], _| !fixed.contains(train));
        let registration = register_correspondences(&free, &prior, options);
        if moved {
            for k in fixed {
                *self.stayed.entry(k).or_default() += 1;
            }
        }
        Ok(registration)
    }

    /// Moves to `pose`, looks, and registers to the reference; `moved` is whether the view moves far enough to be seen to. `None` when
    /// the view is not found there.
    pub(super) fn observe(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        pose: &PlanarPose,
        moved: bool,
    ) -> Result<Option<Observation>, ServoError> {
        let present = scope.gate().position()?;
        let at = scope.move_to(&pose.request(&present))?;
        let frame = grab(scope, sink, FrameRole::Calibration, &self.objective.id)?;
        let view = self.vision.of_view(&gray(scope, &frame)?)?;
        let registration = self.register(&view, moved)?;
        let centre = centre_px(frame.width, frame.height);
        let observation = match &registration.outcome {
            Ok(estimate) => Some(Observation {
                pose: PlanarPose::from(&at),
                b_px: estimate.target_from_view.recentred(centre, centre).offset,
                sigma_px: estimate.sigma_px,
            }),
            Err(reason) => {
                self.last_reason = Some(reason.clone());
                None
            }
        };
        let event = Event::CalibrationView {
            index: self.views,
            stage: at,
            shift_px: observation.map(|o| o.b_px),
            inliers: registration.inliers,
            chain: None,
        };
        self.views += 1;
        tell(scope, sink, event);
        Ok(observation)
    }
}

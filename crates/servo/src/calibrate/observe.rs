//! One view of a calibration: moved to, registered to the reference, without what is fixed to the camera.

use super::plan::STAYED;
use super::procedure::{Calibrate, no_reference};
use crate::event::tell;
use crate::hand_eye::Observation;
use crate::kinematics::PlanarPose;
use crate::proof::LEAST_PX;
use crate::vision::{centre_px, features, grab, gray, same_objective};
use crate::{Event, FrameRole, ServoError, Sink};
use scopeservo_registration::{Matched, Registration};
use scopeservo_scope::Instrument;
use scopeservo_sift::{Features, Match};

impl Calibrate {
    /// Registers a view to the reference, without what is fixed to the camera: what stays where it is, when the view `moved` for sure;
    /// else what stayed in the translations.
    fn register(&mut self, view: &Features, moved: bool) -> Result<Registration, ServoError> {
        let reference = self.reference.as_ref().ok_or_else(no_reference)?;
        let options = &self.vision.registration;
        let prior = same_objective(1.5 * self.options.max_rotation_rad);
        let matched = Matched::of(view, reference, &prior, options);
        let way = |m: &Match| {
            let (v, t) = (&view.keypoints[m.query], &reference.keypoints[m.train]);
            f64::from(f32::hypot(v.x - t.x, v.y - t.y))
        };
        let fixed: Vec<usize> = matched
            .matches
            .iter()
            .filter(|m| match moved {
                true => way(m) <= LEAST_PX,
                false => self.stayed.get(&m.train).is_some_and(|n| *n >= STAYED),
            })
            .map(|m| m.train)
            .collect();
        if fixed.is_empty() {
            return Ok(matched.registration);
        }
        let free = |m: &Match| !fixed.contains(&m.train);
        let registration = matched.of_those((view, reference), &prior, options, |m, _| free(m));
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
        let view = features(&gray(scope, &frame)?, &self.vision.view)?;
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
        };
        self.views += 1;
        tell(scope, sink, event);
        Ok(observation)
    }
}

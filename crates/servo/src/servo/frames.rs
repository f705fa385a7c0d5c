//! What the loop's state takes from a frame: found and moved away from, lost, or to be looked at again.

use super::convergence::Criteria;
use super::sight::{Located, Sight};
use super::state::Servo;
use crate::event::tell;
use crate::pose::image_angle;
use crate::{Event, Progress, ServoEnd, ServoTask, Sink, Velocity};
use scopeservo_registration::NotFound;
use scopeservo_scope::Instrument;

impl Servo {
    /// Whether the target was seen at all.
    pub fn seen(&self) -> bool {
        self.convergence.seen()
    }

    pub(crate) fn found<'a>(&mut self, sight: Sight<'a>) -> Sight<'a> {
        let transform = &sight.located.estimate.target_from_view;
        if self.expected.found(transform.linear.rotation_angle()) {
            // The specimen turned meanwhile: that is no divergence.
            self.convergence.begin_anew();
        }
        sight
    }

    /// The stage is about to move.
    pub(crate) fn moving(
        &mut self,
        task: &ServoTask<'_>,
        test: &Criteria<'_>,
        located: &Located,
        velocity: &Velocity,
    ) {
        let error = &located.pose.error;
        let left_rad = error.theta_rad + velocity.theta_rad;
        let (view, target) = (task.view_calibration, task.target_calibration);
        self.expected.moving(image_angle(left_rad, view, target));
        let error_um = error.t_um();
        self.proof.moving(error_um, velocity.distance_um());
        let only_nearly = test.only_nearly(error, &located.estimate);
        self.convergence.nearly += usize::from(only_nearly);
        self.convergence.moving();
    }

    pub(crate) fn lost(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sink: &mut dyn Sink,
        sequence: u64,
        reason: &NotFound,
    ) -> Progress<ServoEnd> {
        let event = Event::Lost {
            objective: task.objective().clone(),
            iteration: self.convergence.iteration,
            sequence,
            reason: reason.clone(),
        };
        tell(scope, sink, event);
        let lost = self.expected.lost();
        self.convergence
            .lose(task.options, lost, reason)
            .map_or(Progress::Continue, Progress::Done)
    }

    /// Some inliers are fixed to the camera: the next frame is seen without them.
    pub(crate) fn look_again(
        &mut self,
        task: &ServoTask<'_>,
        sight: &Sight<'_>,
    ) -> Progress<ServoEnd> {
        let now = sight.measured(&sight.located, task);
        self.convergence
            .disbelieve(task.options, now)
            .map_or(Progress::Continue, Progress::Done)
    }
}

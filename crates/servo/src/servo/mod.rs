//! The servo loop at one magnification. The page to read first.
//!
//! It ends when the error passes the convergence test (`convergence.rs`) in several frames in a row without a move in between: arrival is
//! claimed by the image, on places that were seen to move with the specimen (`belief.rs`), and by frames far enough apart to see it drift.

mod belief;
pub(crate) mod blur;
pub(crate) mod contradiction;
mod convergence;
mod criteria;
pub(crate) mod end;
mod expected;
mod frames;
pub(crate) mod hand_over;
pub(crate) mod may_lie;
pub(crate) mod missing;
pub(crate) mod options;
mod pixels;
pub(crate) mod places;
pub(crate) mod promise;
mod reach;
mod recover;
pub(crate) mod refit;
pub(crate) mod run;
mod scatter;
mod sight;
mod state;
mod take_over;
pub(crate) mod task;
mod turning;
pub(crate) mod watch;

use crate::vision::grab_another;
use crate::{FrameRole, Progress, ServoEnd, ServoError, ServoTask, Sink, event::tell};
use belief::Belief;
use convergence::Standing;
use scopeservo_scope::Instrument;
use sight::{Sight, View};

pub use state::Servo;

impl Servo {
    /// One iteration.
    ///
    /// # Errors
    /// Faults, refused moves and interruptions of the instrument.
    pub fn step(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<ServoEnd>, ServoError> {
        // As well as moves have shown it to be known.
        let believed = self.watch.believed(task.view_calibration);
        let task = &task.by(&believed);
        let mut test = self.criteria(task, scope);
        self.convergence.rest(&test, scope)?;
        let present = scope.gate().position()?;
        // Camera.
        let (frame, is_again) = grab_another(scope, sink, FrameRole::Servo, task.objective())?;
        let view = View::of(&frame, scope)?;
        // Features, match and fit, homography, pose error and its covariance: Eqs. (7), (19), (20).
        let prior = self.expected.prior(task);
        let sight = match Sight::of(&view, task, scope, prior, present, &self.proof.fixed)? {
            Ok(sight) => self.found(task, scope, sight)?,
            Err(reason) => return self.lost(task, scope, sink, &view, &reason),
        };
        // Control: Eq. (22).
        let passes = test.passes(&sight.located.pose.error, &sight.located.estimate);
        let promised = self.watch.promised(&task.mover(scope));
        let iteration = (self.convergence.iteration, test.turns, passes);
        tell(scope, sink, sight.event(task, iteration, promised));
        // Did the last move do what it was to do?
        if let Some(progress) = self.contradicted(task, scope, sink, &sight) {
            return Ok(progress);
        }
        // The same image as before confirms nothing. Does the camera still live?
        if is_again {
            return self.doubts(task, scope, sink, &sight);
        }
        // Is it the specimen, and the only place that looks like this?
        let (located, passes) = match self.believe(task, &test, &sight, passes) {
            Belief::Of(located, passes) => (located, passes),
            Belief::Ended(end) => return Ok(Progress::Done(end)),
            Belief::LookAgain => return Ok(self.look_again(task, &sight)),
            Belief::Unknown => return self.step_aside(task, scope, sink, &sight),
        };
        // Can the stage go there at all?
        let seen = (&sight, &*located, passes);
        if let Some(end) = self.cannot_reach(task, scope, &mut test, seen)? {
            return Ok(Progress::Done(end));
        }
        // Below the target's magnification one measurement is enough, where it surely leads into a higher objective's view.
        if let Some(end) = self.hand_over(task, scope, &test, (&sight, &located))? {
            return Ok(Progress::Done(end));
        }
        // Stage: Eq. (5). A frame that passes is confirmed by the next one from the same place.
        let measured = sight.measured(&located, task);
        let standing = self.convergence.take(&test, measured, passes);
        match self.unless_tried(task, scope, sink, &test, standing) {
            Standing::Ended(end) | Standing::Scattered(_, end) => return Ok(Progress::Done(end)),
            Standing::Inside => {}
            Standing::Outside => self.go_on(task, scope, &test, (&sight, &located))?,
        }
        self.convergence.iteration += 1;
        Ok(Progress::Continue)
    }
}

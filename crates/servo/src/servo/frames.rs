//! What the loop's state takes from a frame: found and moved away from, lost, or to be looked at again.

use super::blur::Blur;
use super::criteria::Criteria;
use super::places::MayLieAt;
use super::promise::{Kept, Promise};
use super::sight::{Located, Sight, View};
use super::state::Servo;
use super::watch::Watch;
use crate::event::tell;
use crate::one_side::move_from_one_side;
use crate::pose::image_angle;
use crate::{
    Contradiction, Event, PlanarPose, PoseEstimate, Progress, ServoEnd, ServoError, ServoResult,
    ServoTask, Sink, Velocity,
};
use scopeservo_registration::{NotFound, Prior, flipped};
use scopeservo_scope::{Instrument, StagePose};

/// Scales of two objectives that disagree by more than this, as a logarithm, are no drift: three times the paper's convergence range.
const DRIFTED_SCALE: f64 = 0.18;

impl Servo {
    /// A loop whose first frame is to show what a move before it was to do.
    pub(crate) fn after(watch: Watch) -> Self {
        Self {
            watch,
            ..Self::default()
        }
    }

    /// The convergence test.
    pub(crate) fn criteria<'a>(&self, task: &ServoTask<'a>, scope: &Instrument) -> Criteria<'a> {
        let test = task.criteria(scope);
        Criteria {
            nearly: self.convergence.nearly,
            turns: test.turns && !self.leaves_angle,
            ..test
        }
        .scattering(self.convergence.spread.as_ref())
    }

    /// What the moves have shown so far.
    pub(crate) fn watch(&self) -> &Watch {
        &self.watch
    }

    /// Where the target may lie, after it was not found.
    pub(crate) fn may_lie_at(&self) -> Option<&MayLieAt> {
        self.may_lie_at.as_ref()
    }

    /// Whether the target was seen at all.
    pub fn seen(&self) -> bool {
        self.convergence.seen()
    }

    pub(crate) fn found<'a>(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sight: Sight<'a>,
    ) -> Result<Sight<'a>, ServoError> {
        let objective = scope.objective(task.objective())?;
        let um_per_px = task.target_calibration.um_per_px();
        let blur = |seen| Blur::of(seen, um_per_px, objective);
        self.blur = sight.sharpness().map(blur);
        let transform = &sight.located.estimate.target_from_view;
        if self.expected.found(transform.linear.rotation_angle()) {
            // The specimen turned meanwhile: that is no divergence.
            self.convergence.begin_anew();
        }
        Ok(sight)
    }

    /// How blurred the last frame was beside the target, where it was found and that could be told.
    pub(crate) fn blur(&self) -> Option<&Blur> {
        self.blur.as_ref()
    }

    /// The height was changed: no frame so far confirms the next one.
    pub(crate) fn focused_again(&mut self) {
        self.blur = None;
        self.convergence.confirm_anew();
    }

    /// The stage is about to move.
    pub(crate) fn moving(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        test: &Criteria<'_>,
        (sight, located): (&Sight<'_>, &Located),
        (velocity, goal): (&Velocity, &StagePose),
    ) {
        self.promise(task, scope, (sight, &located.pose), goal, 0.0);
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

    /// What the move that is about to begin is to do; `change_m`: how far the next view lies from this one besides.
    pub(crate) fn promise(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        (sight, seen): (&Sight<'_>, &PoseEstimate),
        goal: &StagePose,
        change_m: f64,
    ) {
        let way = (sight.station.pose, PlanarPose::from(goal));
        let promise = Promise::of(seen, way, &task.mover(scope), change_m);
        self.watch.promise = Some(promise);
    }

    /// Whether too much of what was seen contradicts what the stage was told, or another look will show.
    pub(crate) fn contradicted(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sink: &mut dyn Sink,
        sight: &Sight<'_>,
    ) -> Option<Progress<ServoEnd>> {
        self.watch.forgets_elsewhere(&sight.station.pose, scope);
        let known = self.watch.remarks().len();
        let scaled = self.scaled(task, sight);
        let view_m = 1e-6 * task.view_calibration.um_per_px();
        // A step that only shows what moves do leads nowhere.
        let led_nowhere = self.watch.is_wary();
        let kept = self
            .watch
            .see(&sight.located.pose, &task.mover(scope), view_m);
        if led_nowhere || kept.is_some_and(|kept| kept != Kept::Yes) {
            // Divergence counts from what the next move finds.
            self.convergence.begin_anew();
        }
        for remark in self.watch.remarks().split_off(known) {
            tell(scope, sink, Event::Remarked { remark });
        }
        let now = sight.measured(&sight.located, task);
        if let Some(why) = scaled.or_else(|| self.watch.stops()) {
            let last = self.convergence.result(now);
            return Some(Progress::Done(ServoEnd::Contradicted { why, last }));
        }
        (kept == Some(Kept::NotYet)).then(|| {
            let over = self.convergence.disbelieve(task.options, now);
            over.map_or(Progress::Continue, Progress::Done)
        })
    }

    /// What the scale contradicts: that this objective is in, and all its pixels. Of two objectives, one of which has drifted, it is a remark.
    fn scaled(&mut self, task: &ServoTask<'_>, sight: &Sight<'_>) -> Option<Contradiction> {
        let transform = &sight.located.estimate.target_from_view;
        let factor = self.expected.surprises(transform, task)?;
        if task.is_arrival() || factor.ln().abs() > DRIFTED_SCALE {
            return Some(Contradiction::Scaled(1.0 / factor));
        }
        self.expected.scaled(factor);
        self.watch.scaled(task.objective(), factor);
        None
    }

    pub(crate) fn lost(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sink: &mut dyn Sink,
        view: &View,
        reason: &NotFound,
    ) -> Result<Progress<ServoEnd>, ServoError> {
        let event = Event::Lost {
            objective: task.objective().clone(),
            iteration: self.convergence.iteration,
            sequence: view.sequence,
            reason: reason.clone(),
        };
        tell(scope, sink, event);
        self.blur = None;
        let lost = self.expected.lost();
        let Some(end) = self.convergence.lose(task.options, lost, reason) else {
            return Ok(Progress::Continue);
        };
        // What a move has lost is looked for where it began.
        let may = self.convergence.iteration < task.options.max_iterations;
        let back = may.then(|| self.watch.turns_back()).flatten();
        let Some((before, error)) = back else {
            let end = self.gone(end);
            let end = self.or_mirrored(task, view, end)?;
            self.may_lie_at = self.may_lie(task, scope, view, &end)?;
            return Ok(Progress::Done(end));
        };
        let present = scope.gate().position()?;
        let back = scope.gate().as_goal(&before.request(&present))?;
        move_from_one_side(scope, &present, &back, task.view_calibration)?;
        let (view, target) = (task.view_calibration, task.target_calibration);
        self.expected
            .moving(image_angle(error.theta_rad, view, target));
        self.last_seen = Some(error);
        self.convergence.begin_anew();
        self.proof.begin_anew();
        Ok(Progress::Continue)
    }

    /// A target that was not found may be there as a mirror image. That is looked for once, at the end.
    fn or_mirrored(
        &self,
        task: &ServoTask<'_>,
        view: &View,
        end: ServoEnd,
    ) -> Result<ServoEnd, ServoError> {
        let ServoEnd::Lost(_) = &end else {
            return Ok(end);
        };
        let mirror = task.vision.of_view(&flipped(&view.image)?)?;
        let prior = Prior {
            scale: self.expected.prior(task).scale,
            ..Prior::default()
        };
        let seen = task.vision.register(&mirror, &task.target.features, &prior);
        Ok(match seen.found() {
            Some(_) => ServoEnd::Lost(NotFound::Mirrored {
                inliers: seen.inliers,
            }),
            None => end,
        })
    }

    /// What was seen, is lost, and is not where it was seen any more, has moved otherwise than it was told, where there is something to see.
    fn gone(&self, end: ServoEnd) -> ServoEnd {
        let dark = matches!(end, ServoEnd::Lost(NotFound::TooFewFeatures { .. }));
        let why = self.watch.not_there_any_more().filter(|_| !dark);
        let Some((why, error)) = why.zip(self.last_seen) else {
            return end;
        };
        let last = ServoResult {
            iterations: self.convergence.iteration,
            inliers: 0,
            error,
            sigma_um: 0.0,
            sigma_deg: 0.0,
            limited_by: None,
            angle_is_left: false,
        };
        ServoEnd::Contradicted { why, last }
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

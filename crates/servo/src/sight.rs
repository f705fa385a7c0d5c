//! What the servo asks of a view beyond its pose: is this the specimen, is it the only place that looks like this, does it rest?

use crate::aside::{Aside, Seen, step_aside};
use crate::fixed::Parallax;
use crate::procedure::Progress;
use crate::proof::{Drift, FOLLOWS, Proved, Station, far_from_goal};
use crate::servo::{Passed, ServoTask};
use crate::vision::{centre_px, features, grab, gray};
use crate::{FrameRole, PlanarPose, PoseError, Servo, ServoEnd, ServoError, ServoResult, Sink};
use scopeservo_registration::likeness::Pair;
use scopeservo_registration::{Estimate, Matched, Prior, Rival, find_rivals, shifted, undecided};
use scopeservo_scope::Instrument;
use scopeservo_sift::{Features, GrayImage};
use std::time::Duration;

/// How often one who waits looks whether a stop was asked for.
const LOOK: Duration = Duration::from_millis(20);
/// Where the target has no picture to ask, a rival that explains this share of the places is as good.
const AS_GOOD: f64 = 0.8;

/// One frame, as far as it was understood.
pub(crate) struct Sight<'a> {
    pub(crate) image: &'a GrayImage,
    /// All its features.
    pub(crate) seen: &'a Features,
    /// Those that are not known to be fixed to the camera.
    pub(crate) view: &'a Features,
    /// The same of the target.
    pub(crate) target: &'a Features,
    pub(crate) matched: &'a Matched,
    pub(crate) prior: &'a Prior,
    /// Where the stage says that it was taken.
    pub(crate) station: Station<'a>,
}

impl Sight<'_> {
    /// The middle of the view and of the target.
    fn centres(&self) -> ([f64; 2], [f64; 2]) {
        (
            centre_px(self.view.width, self.view.height),
            centre_px(self.target.width, self.target.height),
        )
    }
}

/// What is believed of the places that agree.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Belief {
    /// They are the specimen; and what those of them say that were seen to move, in a frame that passes.
    Specimen(Option<Box<Estimate>>),
    /// Those that were seen to move say that the view is not there yet, or not for sure.
    NotThere(Box<Estimate>),
    /// Some were not, and are left out from now on.
    LookAgain,
    /// Nobody knows: a step aside will show it.
    Unknown,
}

impl Servo {
    /// Confirming frames lie some time apart: what drifts is seen to.
    pub(crate) fn rest(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
    ) -> Result<(), ServoError> {
        let Some(before) = self.resting.filter(|_| task.is_arrival()) else {
            return Ok(());
        };
        let until = before.time_s + task.options.confirmation_s;
        loop {
            let left = until - scope.clock().now().seconds();
            // A clock that was started anew after a kill knows nothing of the frame before.
            if left > task.options.confirmation_s {
                self.passed.clear();
                (self.resting, self.drift) = (None, Drift::default());
                return Ok(());
            }
            // What is left of rounding is no time: a clock may not even move by it.
            if left < 1e-6 {
                return Ok(());
            }
            scope.clock().sleep(LOOK.min(Duration::from_secs_f64(left)));
            scope.check_cancel()?;
        }
    }

    /// Whether another place explains the view as well as the one that was found.
    ///
    /// In the target's own leg this is asked away from the goal, where what is fixed to the camera speaks for neither; before, at the
    /// first sight and at the end.
    pub(crate) fn ambiguity(
        &mut self,
        task: &ServoTask<'_>,
        sight: &Sight<'_>,
        estimate: &Estimate,
        converged: bool,
    ) -> Option<ServoEnd> {
        let (centre, target_centre) = sight.centres();
        let due = match task.is_arrival() {
            true => far_from_goal(&estimate.target_from_view, centre, target_centre),
            false => !self.proof.unique || converged,
        };
        if !due {
            return None;
        }
        if let Some(rival) = self.rival(task, sight, estimate) {
            return Some(ServoEnd::Ambiguous {
                rival,
                um_per_px: task.target_calibration.um_per_px(),
            });
        }
        self.proof.unique = true;
        None
    }

    fn rival(&self, task: &ServoTask<'_>, sight: &Sight<'_>, estimate: &Estimate) -> Option<Rival> {
        let found = find_rivals(
            sight.view,
            sight.target,
            &sight.matched.registration,
            // Any angle that the first frame of a run would accept.
            &Prior {
                rotation: None,
                ..*sight.prior
            },
            &task.vision.registration,
            task.is_arrival(),
        );
        let mut rivals = shifted(estimate, &task.target.periods_px);
        rivals.extend(found);
        if rivals.is_empty() {
            return None;
        }
        let Some(picture) = task.target.picture.as_ref().and_then(|p| p.image()) else {
            let as_good = |r: &Rival| r.places as f64 >= AS_GOOD * r.asked as f64;
            return rivals.into_iter().find(|r| r.significant && as_good(r));
        };
        let transform = &estimate.target_from_view;
        let pair = Pair::new(sight.image, &picture, transform.linear.det().abs().sqrt());
        let counts = |p| !self.proof.fixed.holds(p);
        undecided(&pair, transform, &rivals, true, counts)
    }

    /// Whether what agrees in this frame is known to be the specimen, where that matters: in a frame that passes, and in one that did not
    /// follow the stage.
    pub(crate) fn belief(
        &mut self,
        task: &ServoTask<'_>,
        sight: &Sight<'_>,
        estimate: &Estimate,
        error: &PoseError,
        passes: Option<&dyn Fn(&Estimate) -> bool>,
    ) -> Belief {
        if !task.is_arrival() {
            return Belief::Specimen(None);
        }
        let um_per_px = task.target_calibration.um_per_px();
        let stays = self.proof.does_not_follow(error.t_um(), um_per_px);
        let Some(passes) = passes else {
            let centres = sight.centres();
            let registration = &sight.matched.registration;
            let transform = &estimate.target_from_view;
            self.proof
                .witness(transform, registration, centres, sight.station.pose);
            return match stays && self.proof.may_step_aside() {
                true => Belief::Unknown,
                false => Belief::Specimen(None),
            };
        };
        let proved = self.proof.judge(
            (sight.view, sight.target),
            sight.matched,
            estimate,
            sight.prior,
            &task.vision.registration,
            &sight.station,
        );
        match proved {
            Proved::Moved(moved) if self.proof.unique => match passes(&moved) {
                true => Belief::Specimen(Some(moved)),
                false => Belief::NotThere(moved),
            },
            Proved::Bent => Belief::LookAgain,
            Proved::Moved(_) | Proved::Nothing => Belief::Unknown,
        }
    }

    /// Steps aside once, and goes on from there; what stays is left out from now on.
    pub(crate) fn step_aside(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sink: &mut dyn Sink,
        sight: &Sight<'_>,
        last: ServoResult,
    ) -> Result<Progress<ServoEnd>, ServoError> {
        if !self.proof.spend_step_aside() {
            return Ok(Progress::Done(ServoEnd::Unproven(last)));
        }
        self.passed.clear();
        self.resting = None;
        let objective = &task.view_calibration.objective;
        let aside = step_aside(
            scope,
            sink,
            (objective, task.view_calibration.um_per_px()),
            task.vision,
            (sight.image, sight.seen),
            &sight.station.pose,
        )?;
        match aside {
            Aside::Nothing { moved_um } => Ok(Progress::Done(ServoEnd::NothingMoves { moved_um })),
            Aside::Seen(seen) if !self.went_along(task, scope, sink, sight, &seen)? => {
                Ok(Progress::Done(ServoEnd::Unproven(last)))
            }
            Aside::Seen(seen) => {
                // The error begins anew from here; and what was believed so far may have been believed of the dust.
                self.first = None;
                if !seen.fixed.is_empty() {
                    self.last_angle_rad = None;
                    self.proof.begin_anew();
                }
                self.proof.fixed.add(seen.fixed);
                Ok(Progress::Continue)
            }
        }
    }

    /// How fast the view drifts, when it does for sure: it changed since the last frame, and nothing moved.
    pub(crate) fn drifts(&mut self, task: &ServoTask<'_>, now: Passed) -> Option<f64> {
        if !task.is_arrival() {
            return None;
        }
        let before = self.resting.replace(now)?;
        let way_um = [0, 1].map(|k| now.error.t_um()[k] - before.error.t_um()[k]);
        let tolerance_um = task.options.position_px * task.view_calibration.um_per_px();
        self.drift.take(
            way_um,
            now.time_s - before.time_s,
            f64::hypot(now.sigma_um, before.sigma_um),
            tolerance_um,
        )
    }
}

/// What goes on in the same direction as before is followed by this share, whatever the play.
const GOES_ON: f64 = 0.75;

impl Servo {
    /// Whether what was seen to move in a step aside moved as the stage did, and, for a target that may be text, goes on as it does.
    fn went_along(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sink: &mut dyn Sink,
        sight: &Sight<'_>,
        seen: &Seen,
    ) -> Result<bool, ServoError> {
        let (centre, _) = sight.centres();
        let way = |parallax: &Parallax| {
            let lay = parallax.second_from_first.inverse()?.apply(centre);
            Some([lay[0] - centre[0], lay[1] - centre[1]])
        };
        let home = sight.station.pose;
        let stands = scope.gate().position()?;
        let aside = Station {
            pose: PlanarPose::from(&stands),
            ..sight.station
        };
        if !way(&seen.parallax).is_some_and(|way| aside.follows(&home, way, FOLLOWS)) {
            return Ok(false);
        }
        if !aside.still || self.proof.followed {
            return Ok(true);
        }
        let on = PlanarPose {
            x_m: [0, 1].map(|k| 2.0 * aside.pose.x_m[k] - home.x_m[k]),
            ..aside.pose
        };
        let on = on.request(&stands);
        if scope.gate().check(&on).is_err() {
            return Ok(false);
        }
        let pose = PlanarPose::from(&scope.move_to(&on)?);
        let objective = &task.view_calibration.objective;
        let image = gray(scope, &*grab(scope, sink, FrameRole::Aside, objective)?)?;
        let features = features(&image, &task.vision.view)?;
        let (first, second) = ((&seen.image, &seen.features), (&image, &features));
        let parallax = Parallax::of(first, second, &task.vision.registration);
        let there = Station { pose, ..aside };
        self.proof.followed = parallax
            .and_then(|parallax| way(&parallax))
            .is_some_and(|way| there.follows(&aside.pose, way, GOES_ON));
        Ok(self.proof.followed)
    }
}

//! What the servo asks of a view beyond its pose: is this the specimen, and is it the only place that looks like this?

use super::criteria::Criteria;
use super::sight::{Located, Sight};
use super::state::Servo;
use crate::procedure::Progress;
use crate::proof::{Aside, FOLLOWS, Parallax, Proved, Seen, Station, far_from_goal, step_aside};
use crate::vision::{grab, gray};
use crate::{Expected, FrameRole, PlanarPose, ServoEnd, ServoError, ServoTask, Sink};
use scopeservo_registration::likeness::Pair;
use scopeservo_registration::{Estimate, Prior, Rival, undecided};
use scopeservo_scope::{Instrument, ScopeError};
use std::borrow::Cow;

/// Where the target has no image to ask, a rival that explains this share of the places is as good.
const AS_GOOD: f64 = 0.8;

/// What is believed of the inliers.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Belief {
    /// This transform, and whether it passes the convergence test.
    Of(Box<Located>, bool),
    /// Nothing more can be said.
    Ended(ServoEnd),
    /// Some places were not seen to move, and are left out from now on.
    LookAgain,
    /// Nobody knows: a step aside will show it.
    Unknown,
}

impl Servo {
    /// Whether the view is the specimen, and the only place that looks like this, where that matters.
    pub(crate) fn believe(
        &mut self,
        task: &ServoTask<'_>,
        test: &Criteria<'_>,
        sight: &Sight<'_>,
        passes: bool,
    ) -> Belief {
        match self.ambiguity(task, sight, passes) {
            Some(end) => Belief::Ended(end),
            None => self.belief(task, test, sight, passes),
        }
    }

    /// Whether another place explains the view as well as the one that was found.
    ///
    /// In the target's own leg this is asked away from the goal, where what is fixed to the camera speaks for neither; before, at the
    /// first sight and at the end.
    fn ambiguity(
        &mut self,
        task: &ServoTask<'_>,
        sight: &Sight<'_>,
        converged: bool,
    ) -> Option<ServoEnd> {
        let estimate = &sight.located.estimate;
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
        let expected = Expected {
            // Any angle that the first frame of a run would accept.
            prior: Prior {
                rotation: None,
                ..sight.prior
            },
            fixed: &self.proof.fixed,
        };
        let rivals = task.rivals(&sight.measured, &expected);
        let periods_px = &task.target.periods_px;
        if rivals.is_empty() && periods_px.is_empty() {
            return None;
        }
        let Some(picture) = task.target.picture.as_ref().and_then(|p| p.image()) else {
            let as_good = |r: &Rival| r.places as f64 >= AS_GOOD * r.asked as f64;
            return rivals.into_iter().find(|r| r.significant && as_good(r));
        };
        let transform = &estimate.target_from_view;
        let pair = Pair::new(
            &sight.view.image,
            &picture,
            transform.linear.det().abs().sqrt(),
        );
        let counts = |p| !self.proof.fixed.holds(p);
        undecided(
            &pair,
            estimate,
            (&picture, periods_px),
            &rivals,
            true,
            counts,
        )
    }

    /// Whether what agrees in this frame is known to be the specimen: asked of a frame that passes, and of one that did not follow the
    /// stage.
    fn belief(
        &mut self,
        task: &ServoTask<'_>,
        test: &Criteria<'_>,
        sight: &Sight<'_>,
        passes: bool,
    ) -> Belief {
        let as_seen = Belief::Of(Box::new(sight.located.clone()), passes);
        if !task.is_arrival() {
            return as_seen;
        }
        let um_per_px = task.target_calibration.um_per_px();
        let error_um = sight.located.pose.error.t_um();
        let stays = self.proof.does_not_follow(error_um, um_per_px);
        let estimate = &sight.located.estimate;
        if !passes {
            self.proof.witness(
                &estimate.target_from_view,
                &sight.measured.registration,
                sight.centres(),
                sight.station.pose,
            );
            return match stays && self.proof.may_step_aside() {
                true => Belief::Unknown,
                false => as_seen,
            };
        }
        let proved = self.proof.judge(
            &sight.measured,
            &sight.prior,
            &task.vision.registration,
            &sight.station,
        );
        match proved {
            Proved::Moved(moved) if self.proof.unique => {
                let located = sight.proved(*moved, task);
                let is_pose = sight.pose(&located.estimate, task).is_some();
                let passes = is_pose && test.passes(&located.pose.error, &located.estimate);
                Belief::Of(Box::new(located), passes)
            }
            // A step aside shows at once what looking again and again shows place by place.
            Proved::Bent if self.proof.bends_too_often() && self.proof.may_step_aside() => {
                Belief::Unknown
            }
            Proved::Bent => Belief::LookAgain,
            Proved::Moved(_) | Proved::Nothing => Belief::Unknown,
        }
    }

    /// The camera shows nothing new while nothing moves. A step aside tells whether it froze, which ends the run, or has no noise.
    pub(crate) fn doubts(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sink: &mut dyn Sink,
        sight: &Sight<'_>,
    ) -> Result<Progress<ServoEnd>, ServoError> {
        match self.proof.may_step_aside() {
            true => self.step_aside(task, scope, sink, sight),
            false => Err(ScopeError::Frozen { device: "camera" }.into()),
        }
    }

    /// Steps aside once, and goes on from there; what stays is left out from now on.
    pub(crate) fn step_aside(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sink: &mut dyn Sink,
        sight: &Sight<'_>,
    ) -> Result<Progress<ServoEnd>, ServoError> {
        self.convergence.iteration += 1;
        let last = self
            .convergence
            .result(sight.measured(&sight.located, task));
        if !self.proof.spend_step_aside() {
            return Ok(Progress::Done(ServoEnd::Unproven(last)));
        }
        self.convergence.confirm_anew();
        let objective = task.objective();
        let seen_features = match &sight.measured.features {
            Some(features) => Cow::Borrowed(features),
            None => Cow::Owned(task.vision.of_view(&sight.view.image)?),
        };
        let aside = step_aside(
            scope,
            sink,
            (objective, task.view_calibration.um_per_px()),
            task.vision,
            (&sight.view.image, &seen_features),
            (&sight.station.pose, &|to| self.goes(task, scope, to)),
        )?;
        match aside {
            Aside::Nothing { moved_um } => Ok(Progress::Done(ServoEnd::NothingMoves { moved_um })),
            Aside::Seen(seen) if !self.went_along(task, scope, sink, sight, &seen)? => {
                if let Some(why) = self.watch.suspects() {
                    return Ok(Progress::Done(ServoEnd::Contradicted { why, last }));
                }
                // Play that nobody knows may have eaten the step.
                if self.comes_from_below(task, scope, sink)? {
                    return Ok(Progress::Continue);
                }
                Ok(Progress::Done(ServoEnd::Unproven(last)))
            }
            Aside::Seen(seen) => {
                // The error begins anew from here; and what was believed so far may have been believed of the dust.
                self.convergence.begin_anew();
                if !seen.fixed.is_empty() {
                    self.expected.forget_angle();
                    self.proof.begin_anew();
                }
                self.proof.fixed.add(seen.fixed);
                Ok(Progress::Continue)
            }
        }
    }
}

/// What goes on in the same direction as before is followed by this share, whatever the backlash.
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
        let pose = PlanarPose::from(&self.goes(task, scope, &on)?);
        let objective = task.objective();
        let image = gray(scope, &*grab(scope, sink, FrameRole::Aside, objective)?)?;
        let features = task.vision.of_view(&image)?;
        let (first, second) = ((&seen.image, &seen.features), (&image, &features));
        let parallax = Parallax::of(first, second, task.vision);
        let there = Station { pose, ..aside };
        self.proof.followed = parallax
            .and_then(|parallax| way(&parallax))
            .is_some_and(|way| there.follows(&aside.pose, way, GOES_ON));
        Ok(self.proof.followed)
    }
}

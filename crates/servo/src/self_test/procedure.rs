//! The self-test as a step machine: one view per step.

use super::changes::{Evidence, SelfTestReport, TooCoarse, report};
use crate::event::tell;
use crate::hand_eye::{Observation, pose_sigma};
use crate::kinematics::{Motion2, PlanarPose, pose_after};
use crate::one_side::below;
use crate::procedure::{Procedure, Progress, home_after_an_answer, withdrawn};
use crate::proof::stays;
use crate::target::MIN_TARGET_FEATURES;
use crate::vision::{centre_px, grab, gray, same_objective};
use crate::{Calibration, Event, FrameRole, ServoError, Sink, VisionOptions};
use scopeservo_features::Features;
use scopeservo_geometry::{Mat2, Vec2};
use scopeservo_registration::{
    Correspondences, Estimate, NotFound, Registration, register_correspondences,
};
use scopeservo_scope::{Axis, Instrument, Objective, ScopeError, StagePose};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The moves, as shares of the field's shorter side: so long; or so many times what arrivals scatter, up to half of it.
const SHARE: f64 = 0.3;
const LONGEST_SHARE: f64 = 0.5;
const SCATTERS: f64 = 60.0;
/// The stage turns by a degree at most, and by so little that the view stays within this share of the field by three standard deviations of the
/// rotation centre; of one that does not know its own it is half a millimetre.
const TURN_RAD: f64 = std::f64::consts::PI / 180.0;
const TURN_SHARE: f64 = 0.25;
const CENTRE_M: f64 = 0.5e-3;
/// When the view is lost on turning it turns by a quarter of that, and so often.
const LESS: f64 = 0.25;
const TRIES: u8 = 3;
/// Besides what the stage turns, the images may turn by this against each other, rad.
const TURN_SLACK_RAD: f64 = 0.02;
/// A view that goes or turns by less than this share of what the stage is asked stays.
const STAYS: f64 = 0.25;

/// A view to come.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Goal {
    pose: PlanarPose,
    /// Against the reference, rad.
    turn_rad: f64,
}

/// A view that was found in the reference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Seen {
    turned: bool,
    observation: Observation,
}

/// The test of a kept calibration around the present place with its objective, which must be in focus on the specimen. Every view is reached from
/// below, and the stage comes home unless it was stopped or failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SelfTest {
    objective: Objective,
    calibration: Calibration,
    vision: VisionOptions,
    /// Where the stage stood when it began.
    start: Option<PlanarPose>,
    todo: VecDeque<Goal>,
    reference: Option<(PlanarPose, Features)>,
    seen: Vec<Seen>,
    /// How often the view was lost on turning.
    lost: u8,
}

impl SelfTest {
    /// A test of the calibration that is kept of `objective`.
    pub fn new(objective: Objective, calibration: Calibration, vision: VisionOptions) -> Self {
        Self {
            objective,
            calibration,
            vision,
            start: None,
            todo: VecDeque::new(),
            reference: None,
            seen: Vec::new(),
            lost: 0,
        }
    }

    fn work(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<SelfTestReport>, ServoError> {
        let Some(start) = self.start else {
            self.begin(scope)?;
            return Ok(Progress::Continue);
        };
        if self.reference.is_none() {
            self.refer(scope, sink, &start)?;
            return Ok(Progress::Continue);
        }
        if let Some(goal) = self.todo.pop_front() {
            self.look(scope, sink, &start, &goal)?;
            return Ok(Progress::Continue);
        }
        let report = self.verdict(scope)?;
        self.go_home(scope)?;
        Ok(Progress::Done(report))
    }

    /// Standard deviations of where arrivals end: m, m, rad.
    fn pose_sigma(&self, scope: &Instrument) -> [f64; 3] {
        let seen = self
            .calibration
            .scatter
            .filter(|s| s[0] > 0.0 && s[1] > 0.0);
        seen.unwrap_or_else(|| pose_sigma(scope.gate().info()))
    }

    /// The shorter side of the field by the calibration, m.
    fn field_m(&self, scope: &Instrument) -> f64 {
        let info = scope.camera().info();
        info.width.min(info.height) as f64 * 1e-6 * self.calibration.um_per_px()
    }

    /// Where the stage will go: along x, then along y, then turned, to the first sides where the rules let it.
    fn begin(&mut self, scope: &Instrument) -> Result<(), ServoError> {
        let goals = scope.gate().goals()?;
        for (axis, value) in [(Axis::X, goals.here.x), (Axis::Y, goals.here.y)] {
            if value.is_none() {
                return Err(ScopeError::NoSuchAxis { axis }.into());
            }
        }
        let (start, field_m) = (PlanarPose::from(&goals.here), self.field_m(scope));
        let [x, y, _] = self.pose_sigma(scope);
        let length_m = (SCATTERS * x.max(y)).clamp(SHARE * field_m, LONGEST_SHARE * field_m);
        let aside = |by: Vec2| PlanarPose {
            x_m: [0, 1].map(|k| start.x_m[k] + by[k]),
            ..start
        };
        let allowed = |pose: &PlanarPose| goals.allow(&pose.request(&goals.here));
        let sides = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];
        let ways = sides.map(|[x, y]| [x * length_m, y * length_m]);
        let free = ways
            .into_iter()
            .find(|way| allowed(&aside([way[0], 0.0])) && allowed(&aside(*way)));
        let Some(way) = free else {
            let first = [aside([ways[0][0], 0.0]), aside(ways[0])];
            let refused = first
                .iter()
                .find_map(|pose| scope.gate().check(&pose.request(&goals.here)).err());
            return Err(refused
                .unwrap_or(ScopeError::NoSuchAxis { axis: Axis::X })
                .into());
        };
        let along = |pose| Goal {
            pose,
            turn_rad: 0.0,
        };
        self.todo = [along(aside([way[0], 0.0])), along(aside(way))].into();
        if scope.gate().info().axis(Axis::Rz).is_some() {
            let turn_rad = self.most_turn_rad(field_m);
            let turns = [turn_rad, -turn_rad].map(|rad| self.turned(scope, &start, rad, way[1]));
            self.todo
                .extend(turns.into_iter().flatten().find(|t| allowed(&t.pose)));
        }
        self.start = Some(start);
        Ok(())
    }

    fn most_turn_rad(&self, field_m: f64) -> f64 {
        let covariance = self.calibration.covariance;
        let sigma_m = covariance.map_or(CENTRE_M, |c| c[4][4].max(c[5][5]).sqrt());
        (TURN_SHARE * field_m / (3.0 * sigma_m)).min(TURN_RAD)
    }

    /// The view turned about its centre, by the calibration, and moved aside along y: what is fixed to the camera stays, all else moves.
    fn turned(
        &self,
        scope: &Instrument,
        start: &PlanarPose,
        turn_rad: f64,
        y_m: f64,
    ) -> Option<Goal> {
        let eta = self.calibration.rotation_centre_m?;
        let back = (Mat2::IDENTITY - Mat2::rotation(turn_rad)) * eta;
        let motion = Motion2 {
            alpha_rad: turn_rad,
            d_m: back,
        };
        let mut pose = pose_after(scope.gate().info().kinematics, start, &motion);
        pose.x_m[1] += y_m;
        Some(Goal { pose, turn_rad })
    }

    /// Moves there from below, as far as the rules let it.
    fn go(&self, scope: &Instrument, pose: &PlanarPose) -> Result<StagePose, ServoError> {
        let goals = scope.gate().goals()?;
        let below = below(pose, Some(&self.calibration)).request(&goals.here);
        if goals.allow(&below) {
            scope.move_to(&below)?;
        }
        Ok(scope.move_to(&pose.request(&goals.here))?)
    }

    fn features(
        &self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        pose: &PlanarPose,
    ) -> Result<(StagePose, Features), ServoError> {
        let at = self.go(scope, pose)?;
        let frame = grab(scope, sink, FrameRole::Calibration, &self.objective.id)?;
        Ok((at, self.vision.of_view(&gray(scope, &frame)?)?))
    }

    fn refer(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        start: &PlanarPose,
    ) -> Result<(), ServoError> {
        let (at, features) = self.features(scope, sink, start)?;
        if features.len() < MIN_TARGET_FEATURES {
            return Err(self.unclear(NotFound::TooFewFeatures {
                view: features.len(),
                target: features.len(),
                needed: MIN_TARGET_FEATURES,
            }));
        }
        tell(scope, sink, self.viewed(at, None, 0));
        self.reference = Some((PlanarPose::from(&at), features));
        Ok(())
    }

    fn look(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        start: &PlanarPose,
        goal: &Goal,
    ) -> Result<(), ServoError> {
        let (at, view) = self.features(scope, sink, &goal.pose)?;
        let Some((_, reference)) = &self.reference else {
            return Ok(());
        };
        let found = self.register(&view, reference, goal.turn_rad, true);
        let shift = |e: &Estimate| {
            let c = centre_px(view.width, view.height);
            e.target_from_view.recentred(c, c).offset
        };
        let shift_px = found.outcome.as_ref().ok().map(shift);
        tell(scope, sink, self.viewed(at, shift_px, found.inliers));
        match (found.outcome, shift_px) {
            (Ok(estimate), Some(b_px)) => {
                self.follows(start, goal, &estimate, b_px)?;
                self.seen.push(Seen {
                    turned: goal.turn_rad != 0.0,
                    observation: Observation {
                        pose: PlanarPose::from(&at),
                        b_px,
                        sigma_px: estimate.sigma_px,
                    },
                });
            }
            (Err(reason), _) if goal.turn_rad == 0.0 => {
                // All of it may have stayed.
                let all = self.register(&view, reference, 0.0, false);
                if let Some(estimate) = all.found() {
                    self.follows(start, goal, estimate, shift(estimate))?;
                }
                return Err(self.unclear(reason));
            }
            _ => self.turn_less(scope, start, goal),
        }
        Ok(())
    }

    /// Refuses an axis that was sent somewhere since the view before, where the image did not follow.
    fn follows(
        &self,
        start: &PlanarPose,
        goal: &Goal,
        found: &Estimate,
        b_px: Vec2,
    ) -> Result<(), ServoError> {
        let last = self.seen.last().map(|s| s.observation);
        let (from, from_px) = last.map_or((*start, [0.0; 2]), |o| (o.pose, o.b_px));
        let way = [0, 1].map(|k| goal.pose.x_m[k] - from.x_m[k]);
        let axis = match way[0].abs() > way[1].abs() {
            true => Axis::X,
            false => Axis::Y,
        };
        let seen_px = f64::hypot(b_px[0] - from_px[0], b_px[1] - from_px[1]);
        let asked_m = way[0].hypot(way[1]);
        let seen_m = 1e-6 * self.calibration.um_per_px() * seen_px;
        let turned = found.target_from_view.linear.rotation_angle();
        let stands = match goal.turn_rad == 0.0 {
            true => (axis, asked_m, seen_m),
            false => (Axis::Rz, goal.turn_rad.abs(), turned.unwrap_or(0.0).abs()),
        };
        match stands {
            (axis, asked, seen) if seen < STAYS * asked => Err(ServoError::CheckStands {
                objective: self.objective.id.clone(),
                axis,
                asked,
            }),
            _ => Ok(()),
        }
    }

    /// Registers a view to the reference, without what stays where it is when the view `moved`.
    fn register(
        &self,
        view: &Features,
        reference: &Features,
        turn_rad: f64,
        moved: bool,
    ) -> Registration {
        let (options, engine) = (&self.vision.registration, &*self.vision.engine);
        let prior = same_objective(1.5 * turn_rad.abs() + TURN_SLACK_RAD);
        match Correspondences::of(engine, view, reference, &prior, options) {
            Ok(all) => {
                let free = all.those(|_, c| !(moved && stays(c)));
                register_correspondences(&free, &prior, options)
            }
            Err(reason) => Registration::not_found(reason, 0),
        }
    }

    /// The same again, turned by less.
    fn turn_less(&mut self, scope: &Instrument, start: &PlanarPose, lost: &Goal) {
        self.lost += 1;
        let y_m = self.seen.last().map_or(0.0, |s| s.observation.pose.x_m[1]) - start.x_m[1];
        let less = self.turned(scope, start, LESS * lost.turn_rad, y_m);
        self.todo.extend(less.filter(|_| self.lost < TRIES));
    }

    fn unclear(&self, reason: NotFound) -> ServoError {
        ServoError::CheckUnclear {
            objective: self.objective.id.clone(),
            reason,
        }
    }

    fn viewed(&self, stage: StagePose, shift_px: Option<Vec2>, inliers: usize) -> Event {
        Event::CalibrationView {
            index: self.seen.len() + usize::from(self.lost) + usize::from(shift_px.is_some()),
            stage,
            shift_px,
            inliers,
            chain: None,
        }
    }

    fn verdict(&self, scope: &Instrument) -> Result<SelfTestReport, ServoError> {
        let reference = self.reference.as_ref().map(|(pose, _)| *pose);
        let of = |turned: bool| -> Vec<Observation> {
            let those = self.seen.iter().filter(|s| s.turned == turned);
            those.map(|s| s.observation).collect()
        };
        let evidence = Evidence {
            kinematics: scope.gate().info().kinematics,
            reference: reference.ok_or_else(|| ServoError::CannotGoOn("no view".into()))?,
            translations: &of(false),
            rotations: &of(true),
            pose_sigma: self.pose_sigma(scope),
            lost_turning: self.lost >= TRIES,
        };
        report(&self.calibration, &evidence).map_err(|TooCoarse(sigma_percent)| {
            ServoError::CheckTooCoarse {
                objective: self.objective.id.clone(),
                sigma_percent,
            }
        })
    }

    fn go_home(&self, scope: &Instrument) -> Result<(), ServoError> {
        match &self.start {
            Some(start) => self.go(scope, start).map(|_| ()),
            None => Ok(()),
        }
    }
}

impl Procedure for SelfTest {
    type Output = SelfTestReport;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<SelfTestReport>, ServoError> {
        let ended = self.work(scope, sink);
        withdrawn(scope, home_after_an_answer(ended, || self.go_home(scope)))
    }
}

//! The joint calibration as a step machine: one view per step, each registered to those before that overlap it.

mod fixed;
mod look;
mod pair;
mod sense;
mod told;
mod verdict;

use super::alone::Alone;
use super::joint::{JointFit, Known, Next, Pair, Priors, Role, Taken, View, fit, next_view};
use crate::event::tell;
use crate::hand_eye::pose_sigma;
use crate::kinematics::PlanarPose;
use crate::procedure::{Progress, home_after_an_answer};
use crate::{CalibrateOptions, Calibration, ErrorKind, Event, ServoError, Sink, VisionOptions};
use fixed::FixedOnSensor;
use pair::Place;
pub(super) use pair::link_of;
use scopeservo_features::Features;
use scopeservo_registration::NotFound;
use scopeservo_scope::{Axis, Instrument, Objective, ScopeError, StagePose};
use serde::{Deserialize, Serialize};

/// Standard deviations of what nobody has measured: backlash of x, y (m) and rotation (rad), the rotation centre, and the centres of two
/// objectives from each other (m).
pub(super) const BACKLASH: [f64; 3] = [30e-6, 30e-6, 1e-4];
const LEVER_M: f64 = 0.3;
const PARCENTRIC_M: f64 = 50e-6;
/// What is warm or hangs on a cable drifts by some nm/s.
pub(super) const DRIFT_M_PER_S: f64 = 10e-9;

/// A calibration around the present place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Chain {
    options: CalibrateOptions,
    vision: VisionOptions,
    objective: Objective,
    /// Where the stage stood when it began, and the way by which the first view was reached.
    start: Option<PlanarPose>,
    via: Option<PlanarPose>,
    taken: Vec<Taken>,
    /// Of each view.
    features: Vec<Features>,
    /// All those of the first.
    #[serde(default)]
    first: Option<Features>,
    /// Where each view lies in the first.
    places: Vec<Option<Place>>,
    pairs: Vec<Pair>,
    fixed: FixedOnSensor,
    fit: Option<JointFit>,
    last_reason: Option<NotFound>,
    /// The most features of a view.
    most_features: usize,
    /// Mean of the first image.
    light: Option<f64>,
    /// Whether the last view shows what an earlier one did in the same place of the sensor, though the stage was sent elsewhere.
    stayed: bool,
}

impl Chain {
    pub(crate) fn new(
        objective: Objective,
        options: CalibrateOptions,
        vision: VisionOptions,
    ) -> Self {
        Self {
            options,
            vision,
            objective,
            start: None,
            via: None,
            taken: Vec::new(),
            features: Vec::new(),
            first: None,
            places: Vec::new(),
            pairs: Vec::new(),
            fixed: FixedOnSensor::default(),
            fit: None,
            last_reason: None,
            most_features: 0,
            light: None,
            stayed: false,
        }
    }

    /// One more view; or at the end of the path home, and the verdict.
    pub(crate) fn advance(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Calibration>, ServoError> {
        let ended = self
            .work(scope, sink)
            .map_err(|e| self.or_it_shakes(scope, e));
        // After a stop that somebody asked for nothing more happens.
        let stopped = |e: &ServoError| e.kind() == ErrorKind::Interruption;
        if ended.as_ref().is_err_and(|e| !stopped(e)) {
            self.tell_all(scope, sink);
        }
        home_after_an_answer(ended, || self.go_home(scope))
    }

    fn work(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Calibration>, ServoError> {
        if self.start.is_none() {
            self.start = Some(begins(scope)?);
        }
        if let Some((next, present)) = self.next(scope)? {
            self.look(scope, sink, (&next, &present))?;
            self.obeys(scope)?;
            return Ok(Progress::Continue);
        }
        self.fit = self.whole_fit(scope);
        let (calibration, residual_px) = self.verdict(scope)?;
        if self.taken.last().is_none_or(|t| t.role != Role::Home) {
            self.go_home(scope)?;
        }
        self.tell_all(scope, sink);
        let event = Event::Calibrated {
            calibration: Box::new(calibration.clone()),
            residual_px,
            views: self.taken.iter().filter(|t| t.found).count(),
        };
        tell(scope, sink, event);
        Ok(Progress::Done(calibration))
    }

    /// What it saw, to be compared with other objectives: nothing where it was not solved for.
    pub(super) fn alone(&self, calibration: Calibration) -> Option<Alone> {
        let single = self.fit.as_ref()?.single(self.taken.first()?.view.time_s)?;
        let all = self.first.as_ref()?;
        let free = (0..all.len()).filter(|i| !self.fixed.has(&all.keypoints[*i]));
        let features = all.subset(&free.collect::<Vec<usize>>());
        Some(Alone {
            calibration,
            single,
            features,
        })
    }

    fn known(&self, scope: &Instrument) -> Option<Known<'_>> {
        let (info, camera) = (scope.gate().info(), scope.camera().info());
        Some(Known {
            kinematics: info.kinematics,
            turns: info.axis(Axis::Rz).is_some(),
            image_size_px: [camera.width, camera.height],
            nominal_m_per_px: 1e-6 * self.objective.nominal_um_per_px,
            start: self.start?,
            optics: 0,
            taken: &self.taken,
            fit: self.fit.as_ref(),
        })
    }

    /// The next view, and where the stage stands before it.
    fn next(&self, scope: &Instrument) -> Result<Option<(Next, StagePose)>, ServoError> {
        let goals = scope.gate().goals()?;
        let allowed = |pose: &PlanarPose| goals.allow(&pose.request(&goals.here));
        let known = self.known(scope);
        let next = known.and_then(|known| next_view(&self.options.path, &known, &allowed));
        Ok(next.map(|next| (next, goals.here)))
    }

    /// What the views so far say.
    fn solve(&self, scope: &Instrument) -> Option<JointFit> {
        let info = scope.gate().info();
        let sigma = pose_sigma(info);
        let axes = [Axis::X, Axis::Y, Axis::Rz];
        let stated = [0, 1, 2].map(|k| info.axis(axes[k]).map(|_| sigma[k]));
        let priors = Priors {
            kinematics: info.kinematics,
            arrival: stated,
            drift_m_per_s: DRIFT_M_PER_S,
            coupled: None,
            sure: false,
            backlash: BACKLASH,
            lever_m: LEVER_M,
            parcentric_m: PARCENTRIC_M,
        };
        let views: Vec<View> = self.taken.iter().map(|t| t.view).collect();
        fit(&priors, &views, &self.pairs)
    }

    /// Back to the first view, by the way by which it was reached.
    fn go_home(&self, scope: &Instrument) -> Result<(), ServoError> {
        let (Some(home), present) = (self.start, scope.gate().position()?) else {
            return Ok(());
        };
        for pose in self.via.iter().chain([&home]) {
            scope.return_to(&pose.request(&present))?;
        }
        Ok(())
    }
}

/// Where the stage stands, which needs both axes of the plane.
fn begins(scope: &Instrument) -> Result<PlanarPose, ServoError> {
    let at = scope.gate().position()?;
    for (axis, value) in [(Axis::X, at.x), (Axis::Y, at.y)] {
        if value.is_none() {
            return Err(ScopeError::NoSuchAxis { axis }.into());
        }
    }
    Ok(PlanarPose::from(&scope.gate().as_goal(&at)?))
}

//! What a servo loop needs to know.

use super::criteria::Criteria;
use super::hand_over::HandOver;
use super::promise::Mover;
use crate::hand_eye::pose_sigma;
use crate::localize::with_localizer;
use crate::{
    Calibration, ControlLaw, Expected, Law, Localizer, Measurement, PoseEstimate, ServoError,
    ServoOptions, Target, Velocity, VisionOptions,
};
use scopeservo_features::GrayImage;
use scopeservo_registration::correlation::Perhaps;
use scopeservo_registration::{NotFound, Rival};
use scopeservo_scope::{Axis, Instrument, ObjectiveId};

/// What a servo loop needs to know; none of it changes while it runs.
#[derive(Clone, Copy)]
pub struct ServoTask<'a> {
    /// The view to come back to.
    pub target: &'a Target,
    /// Calibration of the active objective.
    pub view_calibration: &'a Calibration,
    /// Calibration of the target's objective (K_t).
    pub target_calibration: &'a Calibration,
    /// How to look.
    pub vision: &'a VisionOptions,
    /// How to move.
    pub options: &'a ServoOptions,
    /// The control law; `None` for the one that the options name.
    pub law: Option<&'a dyn ControlLaw>,
    /// Objectives that may take over below the target's own magnification, the highest first; none to converge here.
    pub hand_overs: &'a [HandOver],
    /// What finds the target in frames; `None` for features, as the vision options say.
    pub localizer: Option<&'a dyn Localizer>,
}

impl<'a> ServoTask<'a> {
    /// The same with another calibration of the active objective.
    pub(crate) fn by<'b>(&self, view_calibration: &'b Calibration) -> ServoTask<'b>
    where
        'a: 'b,
    {
        ServoTask {
            view_calibration,
            ..*self
        }
    }

    /// Whether this is the target's own objective, where passing the test means arrival.
    pub(crate) fn is_arrival(&self) -> bool {
        self.view_calibration.objective == self.target_calibration.objective
    }

    /// The active objective.
    pub(crate) fn objective(&self) -> &ObjectiveId {
        &self.view_calibration.objective
    }

    /// Looks for the target in a view.
    pub(crate) fn locate(
        &self,
        view: &GrayImage,
        expected: &Expected<'_>,
    ) -> Result<Result<Measurement, NotFound>, ServoError> {
        self.with_localizer(|l| l.locate(self.target, view, expected))
    }

    /// Where the target may lie in a view in which it was not found, at any angle.
    pub(crate) fn perhaps(&self, view: &GrayImage, expected: &Expected<'_>) -> Vec<Perhaps> {
        self.with_localizer(|l| l.perhaps(self.target, view, expected))
    }

    /// Other transforms that explain a view nearly as well.
    pub(crate) fn rivals(&self, measured: &Measurement, expected: &Expected<'_>) -> Vec<Rival> {
        let moves = self.is_arrival();
        self.with_localizer(|l| l.rivals(self.target, measured, expected, moves))
    }

    fn with_localizer<T>(&self, ask: impl FnOnce(&dyn Localizer) -> T) -> T {
        match self.localizer {
            Some(localizer) => ask(localizer),
            None => with_localizer(self.vision, ask),
        }
    }

    /// The convergence test on this instrument.
    pub(crate) fn criteria(&self, scope: &Instrument) -> Criteria<'a> {
        Criteria {
            options: self.options,
            is_arrival: self.is_arrival(),
            turns: scope.gate().info().axis(Axis::Rz).is_some(),
            view_um_per_px: self.view_calibration.um_per_px(),
            target_um_per_px: self.target_calibration.um_per_px(),
            scatter: self.scatter(scope),
            nearly: 0,
        }
    }

    /// What is known of the moves.
    pub(crate) fn mover(&self, scope: &Instrument) -> Mover<'_> {
        let info = scope.gate().info();
        Mover {
            kinematics: info.kinematics,
            view: self.view_calibration,
            scatter: self.view_calibration.pose_sigma(pose_sigma(info)),
        }
    }

    /// How arrivals scatter under direct control, which is told what the stage can: the view's distance from its goal, um, and its angle, deg.
    fn scatter(&self, scope: &Instrument) -> Option<[f64; 2]> {
        if self.options.law != Law::Direct {
            return None;
        }
        let (stated, view) = (pose_sigma(scope.gate().info()), self.view_calibration);
        let seen = view.scatter.unwrap_or_default();
        let [x, y, turn] = [0, 1, 2].map(|k| stated[k].max(seen[k]));
        let lever_m = view
            .rotation_centre_m
            .map_or(0.0, |[a, b]| f64::hypot(a, b));
        let distance_m = (x * x + y * y + (lever_m * turn).powi(2)).sqrt();
        Some([distance_m * 1e6, turn.to_degrees()])
    }

    /// The velocity for an error; without a rotation where the stage cannot turn.
    pub(crate) fn velocity(&self, error: &PoseEstimate, turns: bool) -> Velocity {
        let velocity = match self.law {
            Some(law) => law.velocity(error, self.view_calibration),
            None => self.options.velocity(error, self.view_calibration),
        };
        velocity.on_stage_that(turns)
    }
}

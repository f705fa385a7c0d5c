//! The servo loop at one magnification. The page to read first.
//!
//! One step: grab, describe, match and fit, homography, pose error, control, move. It ends when the error passes the
//! convergence test in `confirmations` frames in a row, without a move in between: arrival is claimed by the image, on places that were
//! seen to move with the specimen (`proof.rs`), and by frames far enough apart in time to see it drift.

use crate::control::motion_of;
use crate::event::tell;
use crate::hand_eye::pose_sigma;
use crate::procedure::Progress;
use crate::proof::{Drift, Proof, Station};
use crate::sight::{Belief, Sight};
use crate::vision::{centre_px, features, grab, gray};
use crate::{
    Calibration, Event, FrameRole, PlanarPose, PoseError, ServoEnd, ServoError, ServoResult, Sink,
    Target, VisionOptions, control_law, pose_after, pose_error,
};
use scopeservo_registration::{
    Estimate, Matched, NotFound, Prior, Registration, RotationPrior, ScalePrior,
};
use scopeservo_scope::{Axis, Instrument};
use serde::{Deserialize, Serialize};

/// Settings of the loop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ServoOptions {
    /// Gain: the share of the error that one iteration takes away. The paper's is 0.2.
    pub lambda: f64,
    /// Iterations at one magnification, at most.
    pub max_iterations: usize,
    /// Convergence: the distance must be at most this many pixels of the present view...
    pub position_px: f64,
    /// ...and the angle at most this, times the ratio of view pixel to target pixel size.
    pub angle_deg: f64,
    /// Frames in a row that must pass.
    pub confirmations: usize,
    /// Seconds between them at the target's own magnification, at least: a specimen that drifts shows it.
    pub confirmation_s: f64,
    /// Frames in a row that may be lost before giving up.
    pub max_lost: usize,
    /// Standard deviations by which the error must lie inside both limits at the target's own magnification, where passing
    /// means arrival.
    pub sure_sigmas: f64,
    /// Divergence: give up when the distance grows to this many times its first value and over ten view pixels, or the
    /// angle to this many times its first value and over half a degree.
    pub divergence_factor: f64,
}

impl Default for ServoOptions {
    fn default() -> Self {
        Self {
            lambda: 0.2,
            max_iterations: 64,
            position_px: 0.8,
            angle_deg: 0.01,
            confirmations: 2,
            confirmation_s: 0.5,
            max_lost: 3,
            sure_sigmas: 2.0,
            divergence_factor: 3.0,
        }
    }
}

/// What a servo loop needs to know; none of it changes while it runs.
pub struct ServoTask<'a> {
    /// The view to come back to.
    pub target: &'a Target,
    /// Calibration of the objective in the beam.
    pub view_calibration: &'a Calibration,
    /// Calibration of the target's objective (K_t).
    pub target_calibration: &'a Calibration,
    /// How to look.
    pub vision: &'a VisionOptions,
    /// How to move.
    pub options: &'a ServoOptions,
}

impl ServoTask<'_> {
    /// Whether this is the target's own objective, where passing the test means arrival.
    pub(crate) fn is_arrival(&self) -> bool {
        self.view_calibration.objective == self.target_calibration.objective
    }
}

/// The loop's state.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Servo {
    iteration: usize,
    lost_in_a_row: usize,
    pub(crate) first: Option<PoseError>,
    pub(crate) last_angle_rad: Option<f64>,
    pub(crate) passed: Vec<Passed>,
    #[serde(default)]
    pub(crate) proof: Proof,
    #[serde(default)]
    pub(crate) drift: Drift,
    /// The last frame, while nothing moved since.
    #[serde(default)]
    pub(crate) resting: Option<Passed>,
}

/// The error in a frame, and when.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Passed {
    pub(crate) error: PoseError,
    pub(crate) sigma_um: f64,
    /// When its frame was exposed, on the instrument's clock.
    pub(crate) time_s: f64,
}

impl Servo {
    /// Whether the target was seen at all.
    pub fn seen(&self) -> bool {
        self.first.is_some()
    }

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
        let objective = &task.view_calibration.objective;
        self.rest(task, scope)?;
        let present = scope.gate().position()?;
        // Camera.
        let frame = grab(scope, sink, FrameRole::Servo, objective)?;
        // Features, match and fit.
        let image = gray(scope, &frame)?;
        let seen = features(&image, &task.vision.view)?;
        let (view, target) = (
            self.proof.fixed.without(&seen),
            self.proof.fixed.without(&task.target.features),
        );
        let prior = self.prior(task);
        let matched = Matched::of(&view, &target, &prior, &task.vision.registration);
        let registration = &matched.registration;
        let mut estimate = match &registration.outcome {
            Ok(estimate) => estimate.clone(),
            Err(reason) => return Ok(self.lost(task, scope, sink, frame.sequence, reason)),
        };
        self.lost_in_a_row = 0;
        self.last_angle_rad = estimate.target_from_view.linear.rotation_angle();
        // Homography and pose error.
        let error_of = |estimate: &Estimate| {
            pose_error(
                &estimate.target_from_view,
                task.view_calibration,
                task.target_calibration,
                centre_px(frame.width, frame.height),
                centre_px(target.width, target.height),
            )
        };
        let Some(mut error) = error_of(&estimate) else {
            let reason = NotFound::NoAgreement {
                matches: registration.matches,
            };
            return Ok(self.lost(task, scope, sink, frame.sequence, &reason));
        };
        // Control.
        let turns = scope.gate().info().axis(Axis::Rz).is_some();
        let passes = |estimate: &Estimate| {
            error_of(estimate).is_some_and(|error| passes(&error, estimate, turns, task))
        };
        let mut converged = passes(&estimate);
        let velocity_of = |error: &PoseError| {
            let velocity = control_law(error, task.options.lambda);
            PoseError {
                theta_rad: if turns { velocity.theta_rad } else { 0.0 },
                ..velocity
            }
        };
        let mut velocity = velocity_of(&error);
        let event = Event::Iteration {
            objective: objective.clone(),
            iteration: self.iteration,
            sequence: frame.sequence,
            stage: present,
            error,
            velocity,
            target_from_view: estimate.target_from_view,
            inliers: registration.inliers,
            matches: registration.matches,
            sigma_px: estimate.sigma_px,
            pairs: registration.pairs.clone(),
            converged,
        };
        tell(scope, sink, event);
        // Is it the specimen, and the only place that looks like this?
        let sight = Sight {
            image: &image,
            seen: &seen,
            view: &view,
            target: &target,
            matched: &matched,
            prior: &prior,
            station: Station {
                pose: PlanarPose::from(&present),
                calibration: task.view_calibration,
                kinematics: scope.gate().info().kinematics,
                pose_sigma: pose_sigma(scope.gate().info()),
                still: task.target.moved.is_none(),
            },
        };
        if let Some(end) = self.ambiguity(task, &sight, &estimate, converged) {
            return Ok(Progress::Done(end));
        }
        let test: &dyn Fn(&Estimate) -> bool = &passes;
        match self.belief(task, &sight, &estimate, &error, converged.then_some(test)) {
            Belief::Specimen(None) => {}
            Belief::Specimen(Some(moved)) => {
                error = error_of(&moved).unwrap_or(error);
                estimate = *moved;
            }
            Belief::NotThere(moved) => {
                error = error_of(&moved).unwrap_or(error);
                estimate = *moved;
                converged = false;
                velocity = velocity_of(&error);
            }
            Belief::LookAgain => {
                self.passed.clear();
                self.iteration += 1;
                if self.iteration < task.options.max_iterations {
                    return Ok(Progress::Continue);
                }
                let last = self.result(task, error, registration, &estimate);
                return Ok(Progress::Done(ServoEnd::Unproven(last)));
            }
            Belief::Unknown => {
                self.iteration += 1;
                let last = self.result(task, error, registration, &estimate);
                return self.step_aside(task, scope, sink, &sight, last);
            }
        }
        let now = Passed {
            error,
            sigma_um: sigma_um(&estimate, task),
            time_s: frame.exposure_start.seconds(),
        };
        if let Some(um_per_s) = self.drifts(task, now) {
            let last = self.result(task, error, registration, &estimate);
            return Ok(Progress::Done(ServoEnd::Drifting { um_per_s, last }));
        }
        if let Some(end) = self.judge(task, now, (converged, turns), registration, &estimate) {
            return Ok(Progress::Done(end));
        }
        // Stage. A frame that passes is confirmed by the next one from the same place.
        if !converged {
            let motion = motion_of(&velocity, task.view_calibration);
            let kinematics = scope.gate().info().kinematics;
            let to = pose_after(kinematics, &PlanarPose::from(&present), &motion);
            self.proof.moving(error.t_um(), velocity.distance_um());
            self.resting = None;
            scope.move_to(&to.request(&present))?;
        }
        self.iteration += 1;
        Ok(Progress::Continue)
    }

    /// What is known before matching: the scale from both calibrations, the angle from the last frame.
    fn prior(&self, task: &ServoTask<'_>) -> Prior {
        Prior {
            scale: Some(ScalePrior {
                ratio: task.view_calibration.um_per_px() / task.target_calibration.um_per_px(),
                tolerance: 0.04,
            }),
            rotation: self.last_angle_rad.map(|angle_rad| RotationPrior {
                angle_rad,
                tolerance_rad: 0.1,
            }),
            ..Prior::default()
        }
    }

    /// Whether this frame ends the loop.
    fn judge(
        &mut self,
        task: &ServoTask<'_>,
        now: Passed,
        (converged, turns): (bool, bool),
        registration: &Registration,
        estimate: &Estimate,
    ) -> Option<ServoEnd> {
        let (options, error) = (task.options, now.error);
        let distance_m = error.distance_um() * 1e-6;
        let first = *self.first.get_or_insert(error);
        let grown = |now: f64, first: f64, least: f64| {
            now.abs() > least && now.abs() > options.divergence_factor * first.abs()
        };
        // What was suspected to drift is confirmed anew.
        if !converged || self.drift.suspected() {
            self.passed.clear();
        }
        if converged {
            self.passed.push(now);
        }
        let far = 10.0 * task.view_calibration.um_per_px() * 1e-6;
        if self.passed.len() >= options.confirmations.max(1) {
            let passed: Vec<PoseError> = self.passed.iter().map(|p| p.error).collect();
            Some(ServoEnd::Converged(self.result(
                task,
                mean(&passed),
                registration,
                estimate,
            )))
        } else if grown(distance_m, first.distance_um() * 1e-6, far)
            || turns && grown(error.angle_deg(), first.angle_deg(), 0.5)
        {
            Some(ServoEnd::Diverged(self.result(
                task,
                error,
                registration,
                estimate,
            )))
        } else if self.iteration + 1 >= options.max_iterations {
            Some(ServoEnd::IterationLimit(self.result(
                task,
                error,
                registration,
                estimate,
            )))
        } else {
            None
        }
    }

    fn result(
        &self,
        task: &ServoTask<'_>,
        error: PoseError,
        registration: &Registration,
        estimate: &Estimate,
    ) -> ServoResult {
        let passed: Vec<PoseError> = self.passed.iter().map(|p| p.error).collect();
        ServoResult {
            iterations: self.iteration + 1,
            inliers: registration.inliers,
            error,
            sigma_um: f64::hypot(sigma_um(estimate, task), scatter_um(&passed)),
            sigma_deg: estimate.sigma_angle_rad.to_degrees(),
        }
    }

    fn lost(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        sink: &mut dyn Sink,
        sequence: u64,
        reason: &NotFound,
    ) -> Progress<ServoEnd> {
        let event = Event::Lost {
            objective: task.view_calibration.objective.clone(),
            iteration: self.iteration,
            sequence,
            reason: reason.clone(),
        };
        tell(scope, sink, event);
        self.passed.clear();
        self.resting = None;
        self.lost_in_a_row += 1;
        self.iteration += 1;
        if self.lost_in_a_row >= task.options.max_lost.max(1)
            || self.iteration >= task.options.max_iterations
        {
            Progress::Done(ServoEnd::Lost(reason.clone()))
        } else {
            Progress::Continue
        }
    }
}

/// Standard deviation of the error's distance by the registration, um.
fn sigma_um(estimate: &Estimate, task: &ServoTask<'_>) -> f64 {
    estimate.sigma_px * std::f64::consts::SQRT_2 * task.target_calibration.um_per_px()
}

/// The convergence test: within `position_px` pixels of the present view and, where the stage can turn, within
/// `angle_deg` times the ratio of view pixel to target pixel. With the target's own objective, where passing means
/// arrival, the error must be inside by `sure_sigmas` standard deviations.
fn passes(error: &PoseError, estimate: &Estimate, turns: bool, task: &ServoTask<'_>) -> bool {
    let sigmas = if task.is_arrival() {
        task.options.sure_sigmas
    } else {
        0.0
    };
    let unsure_um = sigmas * estimate.sigma_px * task.target_calibration.um_per_px();
    let unsure_deg = sigmas * estimate.sigma_angle_rad.to_degrees();
    let pixel_um = task.view_calibration.um_per_px();
    let coarseness = (pixel_um / task.target_calibration.um_per_px()).max(1.0);
    let angle_deg = error.angle_deg().abs();
    error.distance_um() + unsure_um <= task.options.position_px * pixel_um
        && (!turns || angle_deg + unsure_deg <= task.options.angle_deg * coarseness)
}

fn mean(errors: &[PoseError]) -> PoseError {
    let n = errors.len() as f64;
    let sum = |f: &dyn Fn(&PoseError) -> f64| errors.iter().map(f).sum::<f64>() / n;
    PoseError {
        t_m: [sum(&|e| e.t_m[0]), sum(&|e| e.t_m[1])],
        theta_rad: sum(&|e| e.theta_rad),
    }
}

/// Root mean square distance of the errors from their mean, um; zero for fewer than two.
fn scatter_um(errors: &[PoseError]) -> f64 {
    if errors.len() < 2 {
        return 0.0;
    }
    let middle = mean(errors);
    let off_sq =
        |e: &PoseError| (e.t_m[0] - middle.t_m[0]).powi(2) + (e.t_m[1] - middle.t_m[1]).powi(2);
    let sum_sq: f64 = errors.iter().map(off_sq).sum();
    (sum_sq / (errors.len() - 1) as f64).sqrt() * 1e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scatter_is_the_spread_of_confirming_frames() {
        let at = |x_um: f64, y_um: f64| PoseError {
            t_m: [x_um * 1e-6, y_um * 1e-6],
            theta_rad: 0.0,
        };
        assert_eq!(scatter_um(&[at(3.0, 4.0)]), 0.0);
        let two = scatter_um(&[at(0.3, 0.4), at(0.0, 0.0)]);
        assert!((two - 0.5 / 2f64.sqrt()).abs() < 1e-12, "{two}");
    }
}

//! Pattern-free calibration in two steps, the paper's section IV-A: eight translations for the 2x2 map (13)-(15), then
//! rotations for the rotation centre (17)-(18). Works over a general 2x2 map; kx, ky, phi are a reading of it.

use crate::event::tell;
use crate::kinematics::{PlanarPose, motion_between};
use crate::procedure::{Procedure, Progress};
use crate::vision::{centre_px, features, grab};
use crate::{CALIBRATION_SCHEMA, Calibration, Event, FrameRole, ServoError, Sink, VisionOptions};
use scopeservo_geometry::{Mat2, Vec2, least_squares};
use scopeservo_registration::{NotFound, Prior, RotationPrior, ScalePrior, register};
use scopeservo_scope::{Axis, Instrument, Kinematics, Objective, ScopeError};
use scopeservo_sift::Features;
use serde::{Deserialize, Serialize};

/// Settings of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CalibrateOptions {
    /// Radius of the eight translations, as a share of the shorter side of the field.
    pub translation_share: f64,
    /// Sweep of the view in a rotation, as a share of the shorter side of the field.
    pub rotation_share: f64,
    /// Largest rotation, radians.
    pub max_rotation_rad: f64,
    /// Measured over nominal um per pixel may be this, or one over this, at most.
    pub nominal_factor: f64,
    /// The residual may be this many times what the stage's repeatability explains, at most.
    pub residual_factor: f64,
    /// One direction's scale over the other's, at most.
    pub anisotropy: f64,
}

impl Default for CalibrateOptions {
    fn default() -> Self {
        Self {
            translation_share: 0.35,
            rotation_share: 0.4,
            max_rotation_rad: 0.08,
            nominal_factor: 1.5,
            residual_factor: 4.0,
            anisotropy: 1.2,
        }
    }
}

/// One measured move from the reference view.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// Where the stage was.
    pub pose: PlanarPose,
    /// b of (10) about the principal points: where the picture's present centre lay in the reference picture, px from its
    /// centre.
    pub b_px: Vec2,
    /// Standard deviation of one coordinate of b, px.
    pub sigma_px: f64,
}

/// Moves at a share of the field in eight directions, opposite ones after each other: slow drift cancels.
const DIRECTIONS: [Vec2; 8] = [
    [1.0, 0.0],
    [-1.0, 0.0],
    [0.0, 1.0],
    [0.0, -1.0],
    [0.707, 0.707],
    [-0.707, -0.707],
    [-0.707, 0.707],
    [0.707, -0.707],
];
/// Translations that must be measured.
const NEEDED: usize = 4;
/// The radius is halved at most so often when views are not found.
const HALVINGS: u8 = 3;
/// The first trial rotation: with a lever arm of 0.3 m it sweeps 9 um.
const FIRST_ROTATION_RAD: f64 = 3e-5;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum State {
    Reference,
    Translate { index: usize, halvings: u8 },
    Probe { angle_rad: f64, tries: u8 },
    Rotate { angles_rad: Vec<f64> },
    Return,
}

/// The calibration as a step machine: one view per step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibrate {
    options: CalibrateOptions,
    vision: VisionOptions,
    objective: Objective,
    state: State,
    reference_pose: Option<PlanarPose>,
    reference: Option<Features>,
    translations: Vec<Observation>,
    rotations: Vec<Observation>,
    last_reason: Option<NotFound>,
    views: usize,
}

impl Calibrate {
    /// A calibration around the present place with the objective in the beam.
    pub fn new(objective: Objective, options: CalibrateOptions, vision: VisionOptions) -> Self {
        Self {
            options,
            vision,
            objective,
            state: State::Reference,
            reference_pose: None,
            reference: None,
            translations: Vec::new(),
            rotations: Vec::new(),
            last_reason: None,
            views: 0,
        }
    }

    fn field_um(&self, scope: &Instrument) -> f64 {
        let info = scope.camera().info();
        info.width.min(info.height) as f64 * self.objective.nominal_um_per_px
    }

    /// Moves to `pose`, looks, and registers to the reference. `None` when the view is not found there.
    fn observe(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        pose: &PlanarPose,
    ) -> Result<Option<Observation>, ServoError> {
        let present = scope.stage().position()?;
        let at = scope.move_to(&pose.request(&present))?;
        let frame = grab(scope, sink, FrameRole::Calibration, &self.objective.id)?;
        let view = features(&frame, &self.vision.view)?;
        let reference = self.reference.as_ref().ok_or_else(no_reference)?;
        // Same objective, nearly the same angle: the scale is one.
        let prior = Prior {
            scale: Some(ScalePrior {
                ratio: 1.0,
                tolerance: 0.03,
            }),
            rotation: Some(RotationPrior {
                angle_rad: 0.0,
                tolerance_rad: 1.5 * self.options.max_rotation_rad,
            }),
        };
        let registration = register(&view, reference, &prior, &self.vision.registration);
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

    fn too_few(&self, measured: usize, needed: usize) -> ServoError {
        ServoError::CalibrationViews {
            objective: self.objective.id.clone(),
            measured,
            needed,
            last: self
                .last_reason
                .clone()
                .unwrap_or(NotFound::TooFewFeatures {
                    view: 0,
                    target: 0,
                    needed,
                }),
        }
    }

    fn translate(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        index: usize,
        halvings: u8,
    ) -> Result<(), ServoError> {
        let reference = self.reference_pose.ok_or_else(no_reference)?;
        let radius_m = self.field_um(scope) * 1e-6 * self.options.translation_share
            / f64::from(1u32 << halvings);
        let pose = PlanarPose {
            x_m: [0, 1].map(|k| reference.x_m[k] + radius_m * DIRECTIONS[index][k]),
            ..reference
        };
        let seen = self.observe(scope, sink, &pose)?;
        self.translations.extend(seen);
        self.state = if index + 1 < DIRECTIONS.len() {
            State::Translate {
                index: index + 1,
                halvings,
            }
        } else if self.translations.len() < NEEDED {
            if halvings == HALVINGS {
                scope.move_to(&reference.request(&scope.stage().position()?))?;
                return Err(self.too_few(self.translations.len(), NEEDED));
            }
            self.translations.clear();
            State::Translate {
                index: 0,
                halvings: halvings + 1,
            }
        } else if scope.stage().info().axis(Axis::Rz).is_some() {
            State::Probe {
                angle_rad: FIRST_ROTATION_RAD,
                tries: 0,
            }
        } else {
            State::Return
        };
        Ok(())
    }

    /// Widens a small rotation until the view sweeps far enough; the lever arm is unknown before.
    fn probe(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        angle_rad: f64,
        tries: u8,
    ) -> Result<(), ServoError> {
        let reference = self.reference_pose.ok_or_else(no_reference)?;
        let goal_px =
            self.field_um(scope) / self.objective.nominal_um_per_px * self.options.rotation_share;
        let pose = PlanarPose {
            theta_rad: reference.theta_rad + angle_rad,
            ..reference
        };
        let swept_px = self
            .observe(scope, sink, &pose)?
            .map(|o| f64::hypot(o.b_px[0], o.b_px[1]));
        let widest = self.options.max_rotation_rad;
        self.state = match swept_px {
            None if tries >= 3 => {
                scope.move_to(&reference.request(&scope.stage().position()?))?;
                return Err(self.too_few(0, 2));
            }
            None => State::Probe {
                angle_rad: angle_rad / 4.0,
                tries: tries + 1,
            },
            Some(px) if px >= 0.3 * goal_px || angle_rad >= widest => {
                let angle = (angle_rad * goal_px / px.max(1.0)).min(widest);
                State::Rotate {
                    angles_rad: vec![-angle, angle],
                }
            }
            // A sweep of under 4 px is mostly noise: widen fourfold and measure again.
            Some(px) => {
                let factor = if px < 4.0 {
                    4.0
                } else {
                    (goal_px / px).min(8.0)
                };
                State::Probe {
                    angle_rad: (angle_rad * factor).min(widest),
                    tries,
                }
            }
        };
        Ok(())
    }

    fn finish(&self, scope: &Instrument) -> Result<(Calibration, f64), ServoError> {
        let info = scope.stage().info();
        let reference = self.reference_pose.ok_or_else(no_reference)?;
        let (pixel_from_stage, eta, residual_px) = solve_hand_eye(
            info.kinematics,
            &reference,
            &self.translations,
            &self.rotations,
        )
        .ok_or_else(|| self.too_few(self.translations.len(), NEEDED))?;
        let stage_from_pixel = pixel_from_stage
            .inverse()
            .ok_or_else(|| self.too_few(self.translations.len(), NEEDED))?;
        let repeatability = |axis| {
            info.axis(axis)
                .map_or(0.0, |a| a.repeatability / 3f64.sqrt())
        };
        let pose_sigma = [Axis::X, Axis::Y, Axis::Rz].map(repeatability);
        let camera = scope.camera().info();
        let calibration = Calibration {
            schema: CALIBRATION_SCHEMA,
            objective: self.objective.id.clone(),
            image_size_px: [camera.width, camera.height],
            stage_from_pixel,
            rotation_centre_m: eta,
            covariance: covariance(
                info.kinematics,
                &reference,
                &self.translations,
                &self.rotations,
                pose_sigma,
            ),
            backlash_m: None,
            parcentric_offset_m: None,
            parfocal_offset_m: None,
        };
        let (measured, nominal) = (calibration.um_per_px(), self.objective.nominal_um_per_px);
        let factor = (measured / nominal).max(nominal / measured);
        if factor.is_nan() || factor > self.options.nominal_factor {
            return Err(ServoError::CalibrationImplausible {
                objective: self.objective.id.clone(),
                measured_um_per_px: measured,
                nominal_um_per_px: nominal,
            });
        }
        // One pixel is for what the data sheet does not name: vibration, drift, the slide's seat.
        let explained_px = explained_px(&reference, &calibration, info.kinematics, pose_sigma);
        let allowed_px = 1.0 + self.options.residual_factor * explained_px;
        let [large, small] = stage_from_pixel.svd().s;
        if residual_px > allowed_px || large > self.options.anisotropy * small {
            return Err(ServoError::CalibrationInconsistent {
                objective: self.objective.id.clone(),
                residual_px,
                allowed_px,
            });
        }
        Ok((calibration, residual_px))
    }
}

fn no_reference() -> ServoError {
    ServoError::BadOption("a stored calibration state has no reference view; start it anew".into())
}

/// The two linear steps. Returns `pixel_from_stage` (px per m in stage axes), the rotation centre (m) when there are
/// rotations, and the root mean square residual (px per coordinate). `None` when the moves do not determine the unknowns.
///
/// Step 1 solves `b = P d` over the translations (13)-(15), step 2 `(R(alpha) - I) eta = P^-1 b - d` over the rotations
/// (17)-(18), with (alpha, d) the motion of the view in stage axes at the reference pose.
pub fn solve_hand_eye(
    kinematics: Kinematics,
    reference: &PlanarPose,
    translations: &[Observation],
    rotations: &[Observation],
) -> Option<(Mat2, Option<Vec2>, f64)> {
    let row = |k: usize| {
        let equations: Vec<([f64; 2], f64)> = translations
            .iter()
            .map(|o| {
                (
                    motion_between(kinematics, reference, &o.pose).d_m,
                    o.b_px[k],
                )
            })
            .collect();
        least_squares(&equations).map(|(p, _)| p)
    };
    let pixel_from_stage = Mat2([row(0)?, row(1)?]);
    let stage_from_pixel = pixel_from_stage.inverse()?;

    let mut equations = Vec::new();
    for o in rotations {
        let motion = motion_between(kinematics, reference, &o.pose);
        let turn = Mat2::rotation(motion.alpha_rad) - Mat2::IDENTITY;
        let moved = stage_from_pixel * o.b_px;
        let right = [moved[0] - motion.d_m[0], moved[1] - motion.d_m[1]];
        equations.extend(turn.0.into_iter().zip(right));
    }
    let eta = if rotations.is_empty() {
        None
    } else {
        Some(least_squares(&equations)?.0)
    };

    let mut sum_sq = 0.0;
    for o in translations.iter().chain(rotations) {
        let eta = eta.unwrap_or([0.0; 2]);
        let predicted = predicted_b(kinematics, reference, &o.pose, pixel_from_stage, eta);
        sum_sq += (predicted[0] - o.b_px[0]).powi(2) + (predicted[1] - o.b_px[1]).powi(2);
    }
    let count = 2 * (translations.len() + rotations.len());
    Some((pixel_from_stage, eta, (sum_sq / count as f64).sqrt()))
}

/// b that a calibration predicts for a stage at `pose`: Eq. (12) over a general map.
fn predicted_b(
    kinematics: Kinematics,
    reference: &PlanarPose,
    pose: &PlanarPose,
    pixel_from_stage: Mat2,
    eta: Vec2,
) -> Vec2 {
    let motion = motion_between(kinematics, reference, pose);
    let turned = Mat2::rotation(motion.alpha_rad) * eta;
    pixel_from_stage * [0, 1].map(|k| turned[k] - eta[k] + motion.d_m[k])
}

/// Standard deviation per coordinate, px, of a view's displacement from the stage's repeatability, at the view and at the
/// reference.
fn explained_px(
    reference: &PlanarPose,
    calibration: &Calibration,
    kinematics: Kinematics,
    pose_sigma: [f64; 3],
) -> f64 {
    let Some(p) = calibration.pixel_from_stage() else {
        return 0.0;
    };
    let eta = calibration.rotation_centre_m.unwrap_or([0.0; 2]);
    let sum_sq: f64 = (0..3)
        .map(|k| {
            let pose = nudged(reference, pose_sigma, k);
            let b = predicted_b(kinematics, reference, &pose, p, eta);
            b[0] * b[0] + b[1] * b[1]
        })
        .sum();
    // Two places, two coordinates.
    sum_sq.sqrt()
}

/// A pose displaced along one of x, y, rotation by its sigma.
fn nudged(pose: &PlanarPose, pose_sigma: [f64; 3], k: usize) -> PlanarPose {
    let mut pose = *pose;
    match k {
        0 | 1 => pose.x_m[k] += pose_sigma[k],
        _ => pose.theta_rad += pose_sigma[2],
    }
    pose
}

/// Covariance of (stage_from_pixel, rotation centre) by first-order propagation through the solver itself: of the
/// stage's repeatability at every place, the reference included (`pose_sigma`: m, m, rad), which changes what is seen
/// but not what is reported, and of the registration noise.
fn covariance(
    kinematics: Kinematics,
    reference: &PlanarPose,
    translations: &[Observation],
    rotations: &[Observation],
    pose_sigma: [f64; 3],
) -> Option<[[f64; 6]; 6]> {
    let (p, eta, _) = solve_hand_eye(kinematics, reference, translations, rotations)?;
    let parameters = |t: &[Observation], r: &[Observation]| {
        let (p, eta, _) = solve_hand_eye(kinematics, reference, t, r)?;
        let (m, eta) = (p.inverse()?.0, eta.unwrap_or([0.0; 2]));
        Some([m[0][0], m[0][1], m[1][0], m[1][1], eta[0], eta[1]])
    };
    let base = parameters(translations, rotations)?;
    let seen = |reference: &PlanarPose, pose: &PlanarPose| {
        predicted_b(kinematics, reference, pose, p, eta.unwrap_or([0.0; 2]))
    };
    let mut out = [[0.0; 6]; 6];
    let mut add = |change_of_b: &dyn Fn(usize, &Observation) -> Vec2| {
        let count = translations.len();
        let with = |first: usize, list: &[Observation]| -> Vec<Observation> {
            let changed = list.iter().enumerate().map(|(i, o)| {
                let change = change_of_b(first + i, o);
                Observation {
                    b_px: [o.b_px[0] + change[0], o.b_px[1] + change[1]],
                    ..*o
                }
            });
            changed.collect()
        };
        let moved = parameters(&with(0, translations), &with(count, rotations))?;
        for i in 0..6 {
            for j in 0..6 {
                out[i][j] += (moved[i] - base[i]) * (moved[j] - base[j]);
            }
        }
        Some(())
    };
    let difference = |a: Vec2, b: Vec2| [a[0] - b[0], a[1] - b[1]];
    for k in 0..3 {
        // The reference frame was taken a little elsewhere: every view is displaced.
        add(&|_, o| {
            difference(
                seen(&nudged(reference, pose_sigma, k), &o.pose),
                seen(reference, &o.pose),
            )
        })?;
    }
    for index in 0..translations.len() + rotations.len() {
        for k in 0..5 {
            add(&|i, o| match k {
                _ if i != index => [0.0; 2],
                0..3 => difference(
                    seen(reference, &nudged(&o.pose, pose_sigma, k)),
                    seen(reference, &o.pose),
                ),
                3 => [o.sigma_px, 0.0],
                _ => [0.0, o.sigma_px],
            })?;
        }
    }
    Some(out)
}

impl Procedure for Calibrate {
    type Output = Calibration;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Calibration>, ServoError> {
        match self.state.clone() {
            State::Reference => {
                let at = scope.stage().position()?;
                if at.x.is_none() || at.y.is_none() {
                    let axis = if at.x.is_none() { Axis::X } else { Axis::Y };
                    return Err(ScopeError::NoSuchAxis { axis }.into());
                }
                let frame = grab(scope, sink, FrameRole::Calibration, &self.objective.id)?;
                self.reference = Some(features(&frame, &self.vision.view)?);
                self.reference_pose = Some(PlanarPose::from(&at));
                self.state = State::Translate {
                    index: 0,
                    halvings: 0,
                };
            }
            State::Translate { index, halvings } => self.translate(scope, sink, index, halvings)?,
            State::Probe { angle_rad, tries } => self.probe(scope, sink, angle_rad, tries)?,
            State::Rotate { mut angles_rad } => {
                let reference = self.reference_pose.ok_or_else(no_reference)?;
                if let Some(angle) = angles_rad.pop() {
                    let pose = PlanarPose {
                        theta_rad: reference.theta_rad + angle,
                        ..reference
                    };
                    let seen = self.observe(scope, sink, &pose)?;
                    self.rotations.extend(seen);
                    self.state = State::Rotate { angles_rad };
                } else {
                    self.state = State::Return;
                }
            }
            State::Return => {
                let reference = self.reference_pose.ok_or_else(no_reference)?;
                scope.move_to(&reference.request(&scope.stage().position()?))?;
                if scope.stage().info().axis(Axis::Rz).is_some() && self.rotations.is_empty() {
                    return Err(self.too_few(0, 1));
                }
                let (calibration, residual_px) = self.finish(scope)?;
                let event = Event::Calibrated {
                    calibration: calibration.clone(),
                    residual_px,
                    views: self.translations.len() + self.rotations.len(),
                };
                tell(scope, sink, event);
                return Ok(Progress::Done(calibration));
            }
        }
        Ok(Progress::Continue)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// b that a perfect instrument would show.
    fn observed(
        kinematics: Kinematics,
        reference: &PlanarPose,
        pose: PlanarPose,
        p: Mat2,
        eta: Vec2,
    ) -> Observation {
        Observation {
            pose,
            b_px: predicted_b(kinematics, reference, &pose, p, eta),
            sigma_px: 0.03,
        }
    }

    #[test]
    fn the_truth_is_recovered_from_any_start_angle_side_and_handedness() {
        let maps = [
            Mat2([[-3000.0, -1.9e6], [1.95e6, -2500.0]]),
            Mat2([[1.2e6, 1.1e6], [1.1e6, -1.3e6]]),
        ];
        for kinematics in [
            Kinematics::MovesMicroscope,
            Kinematics::SpecimenRotationOnTop,
            Kinematics::SpecimenXyOnTop,
        ] {
            for p in maps {
                let eta = [0.125, -0.003];
                let reference = PlanarPose {
                    x_m: [1e-3, -2e-3],
                    theta_rad: 4f64.to_radians(),
                };
                let at = |dx: Vec2, turn: f64| {
                    let pose = PlanarPose {
                        x_m: [reference.x_m[0] + dx[0], reference.x_m[1] + dx[1]],
                        theta_rad: reference.theta_rad + turn,
                    };
                    observed(kinematics, &reference, pose, p, eta)
                };
                let t: Vec<_> = DIRECTIONS
                    .iter()
                    .map(|d| at(d.map(|v| v * 80e-6), 0.0))
                    .collect();
                let r = vec![at([0.0; 2], 1e-3), at([0.0; 2], -1e-3)];
                let (p_hat, eta_hat, residual) =
                    solve_hand_eye(kinematics, &reference, &t, &r).unwrap();
                assert!(
                    (p_hat - p).frobenius() / p.frobenius() < 1e-9,
                    "{kinematics:?}"
                );
                let eta_hat = eta_hat.unwrap();
                for k in 0..2 {
                    assert!(
                        (eta_hat[k] - eta[k]).abs() < 1e-9,
                        "{kinematics:?} {eta_hat:?}"
                    );
                }
                assert!(residual < 1e-6);
            }
        }
    }

    #[test]
    fn the_covariance_is_the_scatter_of_a_noisy_stage() {
        let kinematics = Kinematics::MovesMicroscope;
        let (p, eta) = (Mat2([[-3000.0, -1.9e6], [1.95e6, -2500.0]]), [0.125, 0.001]);
        let home = PlanarPose {
            x_m: [0.0; 2],
            theta_rad: 0.0,
        };
        let sigma = [1e-7, 1e-7, 2e-6];
        let mut rng = scopeservo_geometry::SplitMix64::new(4);
        let mut wrong = |pose: &PlanarPose| PlanarPose {
            x_m: [0, 1].map(|k| pose.x_m[k] + sigma[k] * rng.normal()),
            theta_rad: pose.theta_rad + sigma[2] * rng.normal(),
        };
        let (mut sum_sq, mut expected) = ([0.0; 6], [0.0; 6]);
        for _ in 0..400 {
            let reference = wrong(&home);
            let mut seen = |x_m: Vec2, theta_rad: f64| {
                let pose = PlanarPose { x_m, theta_rad };
                Observation {
                    pose,
                    b_px: predicted_b(kinematics, &reference, &wrong(&pose), p, eta),
                    sigma_px: 0.0,
                }
            };
            let t: Vec<_> = DIRECTIONS
                .iter()
                .map(|d| seen(d.map(|v| v * 80e-6), 0.0))
                .collect();
            let r = [8e-4, -8e-4].map(|a| seen([0.0; 2], a));
            let (p_hat, eta_hat, _) = solve_hand_eye(kinematics, &home, &t, &r).unwrap();
            let (m, m_hat) = (p.inverse().unwrap().0, p_hat.inverse().unwrap().0);
            let eta_hat = eta_hat.unwrap();
            let covariance = covariance(kinematics, &home, &t, &r, sigma).unwrap();
            for i in 0..6 {
                let off = match i {
                    0..4 => m_hat[i / 2][i % 2] - m[i / 2][i % 2],
                    _ => eta_hat[i - 4] - eta[i - 4],
                };
                sum_sq[i] += off * off;
                expected[i] += covariance[i][i];
            }
        }
        for i in 0..6 {
            let ratio = (sum_sq[i] / expected[i]).sqrt();
            assert!((0.85..1.15).contains(&ratio), "parameter {i}: {ratio}");
        }
    }

    #[test]
    fn moves_along_one_line_do_not_determine_the_map() {
        let reference = PlanarPose {
            x_m: [0.0; 2],
            theta_rad: 0.0,
        };
        let t: Vec<_> = [1e-4, 2e-4, -1e-4]
            .map(|x| Observation {
                pose: PlanarPose {
                    x_m: [x, 0.0],
                    theta_rad: 0.0,
                },
                b_px: [x * 2e6, 0.0],
                sigma_px: 0.1,
            })
            .to_vec();
        assert!(solve_hand_eye(Kinematics::MovesMicroscope, &reference, &t, &[]).is_none());
    }
}

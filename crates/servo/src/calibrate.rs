//! Pattern-free calibration in two steps, the paper's section IV-A: eight translations for the 2x2 map (13)-(15), then
//! rotations for the rotation centre (17)-(18). Works over a general 2x2 map; kx, ky, phi are a reading of it.
//!
//! What is fixed to the camera (dust, a reticle, burnt-in text) stays while a translation moves the view, and counts in none of them. A
//! rotation may leave the view's centre where it is; there what stayed in the translations is left out.

use crate::event::tell;
use crate::hand_eye::{Observation, covariance, explained_px, pose_sigma, solve_hand_eye};
use crate::kinematics::PlanarPose;
use crate::procedure::{Procedure, Progress, withdrawn};
use crate::proof::LEAST_PX;
use crate::proof::SEEN_PX;
use crate::vision::{centre_px, features, grab, gray, same_objective};
use crate::{CALIBRATION_SCHEMA, Calibration, Event, FrameRole, ServoError, Sink, VisionOptions};
use scopeservo_geometry::Vec2;
use scopeservo_registration::{Matched, NotFound, Registration};
use scopeservo_scope::{Axis, Instrument, Objective, ScopeError};
use scopeservo_sift::{Features, Match};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

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

/// Moves at a share of the field in eight directions, opposite ones after each other: slow drift cancels.
pub(crate) const DIRECTIONS: [Vec2; 8] = [
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
/// A place that stayed in so many translations is fixed to the camera.
const STAYED: usize = 2;
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
    #[serde(with = "crate::compact::features")]
    reference: Option<Features>,
    /// In how many translations a feature of the reference stayed where it was.
    #[serde(default)]
    stayed: BTreeMap<usize, usize>,
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
            stayed: BTreeMap::new(),
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

    /// Registers a view to the reference, without what is fixed to the camera: what stays where it is, when the view `moved` for sure;
    /// else what stayed in the translations.
    fn register(&mut self, view: &Features, moved: bool) -> Result<Registration, ServoError> {
        let reference = self.reference.as_ref().ok_or_else(no_reference)?;
        let options = &self.vision.registration;
        let prior = same_objective(1.5 * self.options.max_rotation_rad);
        let matched = Matched::of(view, reference, &prior, options);
        let way = |m: &Match| {
            let (v, t) = (&view.keypoints[m.query], &reference.keypoints[m.train]);
            f64::from(f32::hypot(v.x - t.x, v.y - t.y))
        };
        let fixed: Vec<usize> = matched
            .matches
            .iter()
            .filter(|m| match moved {
                true => way(m) <= LEAST_PX,
                false => self.stayed.get(&m.train).is_some_and(|n| *n >= STAYED),
            })
            .map(|m| m.train)
            .collect();
        if fixed.is_empty() {
            return Ok(matched.registration);
        }
        let free = |m: &Match| !fixed.contains(&m.train);
        let registration = matched.of_those((view, reference), &prior, options, |m, _| free(m));
        if moved {
            for k in fixed {
                *self.stayed.entry(k).or_default() += 1;
            }
        }
        Ok(registration)
    }

    /// Moves to `pose`, looks, and registers to the reference; `moved` is whether the view moves far enough to be seen to. `None` when
    /// the view is not found there.
    fn observe(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        pose: &PlanarPose,
        moved: bool,
    ) -> Result<Option<Observation>, ServoError> {
        let present = scope.gate().position()?;
        let at = scope.move_to(&pose.request(&present))?;
        let frame = grab(scope, sink, FrameRole::Calibration, &self.objective.id)?;
        let view = features(&gray(scope, &frame)?, &self.vision.view)?;
        let registration = self.register(&view, moved)?;
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
        let moved = radius_m * 1e6 >= SEEN_PX * self.objective.nominal_um_per_px;
        let seen = self.observe(scope, sink, &pose, moved)?;
        self.translations.extend(seen);
        self.state = if index + 1 < DIRECTIONS.len() {
            State::Translate {
                index: index + 1,
                halvings,
            }
        } else if self.translations.len() < NEEDED {
            if halvings == HALVINGS {
                scope.move_to(&reference.request(&scope.gate().position()?))?;
                return Err(self.too_few(self.translations.len(), NEEDED));
            }
            self.translations.clear();
            self.stayed.clear();
            State::Translate {
                index: 0,
                halvings: halvings + 1,
            }
        } else if scope.gate().info().axis(Axis::Rz).is_some() {
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
            .observe(scope, sink, &pose, false)?
            .map(|o| f64::hypot(o.b_px[0], o.b_px[1]));
        let widest = self.options.max_rotation_rad;
        self.state = match swept_px {
            None if tries >= 3 => {
                scope.move_to(&reference.request(&scope.gate().position()?))?;
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
        let info = scope.gate().info();
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
        let pose_sigma = pose_sigma(info);
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
    ServoError::CannotGoOn("a stored calibration state has no reference view; start it anew".into())
}

impl Calibrate {
    fn advance(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Calibration>, ServoError> {
        match self.state.clone() {
            State::Reference => {
                let at = scope.gate().position()?;
                if at.x.is_none() || at.y.is_none() {
                    let axis = if at.x.is_none() { Axis::X } else { Axis::Y };
                    return Err(ScopeError::NoSuchAxis { axis }.into());
                }
                let frame = grab(scope, sink, FrameRole::Calibration, &self.objective.id)?;
                self.reference = Some(features(&gray(scope, &frame)?, &self.vision.view)?);
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
                    let seen = self.observe(scope, sink, &pose, false)?;
                    self.rotations.extend(seen);
                    self.state = State::Rotate { angles_rad };
                } else {
                    self.state = State::Return;
                }
            }
            State::Return => {
                let reference = self.reference_pose.ok_or_else(no_reference)?;
                scope.move_to(&reference.request(&scope.gate().position()?))?;
                if scope.gate().info().axis(Axis::Rz).is_some() && self.rotations.is_empty() {
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

impl Procedure for Calibrate {
    type Output = Calibration;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Calibration>, ServoError> {
        let ended = self.advance(scope, sink);
        withdrawn(scope, ended)
    }
}

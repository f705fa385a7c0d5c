//! The calibration as a step machine.

use super::plan::{DIRECTIONS, FIRST_ROTATION_RAD, HALVINGS, NEEDED, State};
use crate::calibrate::options::too_few;
use crate::event::tell;
use crate::hand_eye::Observation;
use crate::kinematics::PlanarPose;
use crate::procedure::Progress;
use crate::proof::SEEN_PX;
use crate::vision::{grab, gray};
use crate::{CalibrateOptions, Calibration, Event, FrameRole, ServoError, Sink, VisionOptions};
use scopeservo_features::Features;
use scopeservo_registration::NotFound;
use scopeservo_scope::{Axis, Instrument, Objective, ScopeError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The calibration as a step machine: one view per step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct TwoStep {
    pub(super) options: CalibrateOptions,
    pub(super) vision: VisionOptions,
    pub(super) objective: Objective,
    pub(super) state: State,
    pub(super) reference_pose: Option<PlanarPose>,
    pub(super) reference: Option<Features>,
    /// In how many translations a feature of the reference stayed where it was.
    #[serde(default)]
    pub(super) stayed: BTreeMap<usize, usize>,
    pub(super) translations: Vec<Observation>,
    pub(super) rotations: Vec<Observation>,
    pub(super) last_reason: Option<NotFound>,
    pub(super) views: usize,
}

impl TwoStep {
    /// A calibration around the present place with the active objective.
    pub(crate) fn new(
        objective: Objective,
        options: CalibrateOptions,
        vision: VisionOptions,
    ) -> Self {
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

    pub(super) fn too_few(&self, measured: usize, needed: usize) -> ServoError {
        too_few(&self.objective, measured, needed, self.last_reason.as_ref())
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
                scope.return_to(&reference.request(&scope.gate().position()?))?;
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
                scope.return_to(&reference.request(&scope.gate().position()?))?;
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
}

pub(super) fn no_reference() -> ServoError {
    ServoError::CannotGoOn("a stored calibration state has no reference view; start it anew".into())
}

impl TwoStep {
    pub(crate) fn advance(
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
                self.reference = Some(self.vision.of_view(&gray(scope, &frame)?)?);
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
                scope.return_to(&reference.request(&scope.gate().position()?))?;
                if scope.gate().info().axis(Axis::Rz).is_some() && self.rotations.is_empty() {
                    return Err(self.too_few(0, 1));
                }
                let (calibration, residual_px) = self.finish(scope)?;
                let event = Event::Calibrated {
                    calibration: Box::new(calibration.clone()),
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

//! Objectives that may take over from one below them.

use crate::{Calibration, Known};
use scopeservo_geometry::Vec2;
use scopeservo_scope::{Objective, ObjectiveId};

/// A place counts as in the next view when it surely lies within this share of the view's shorter side from its middle.
const WITHIN: f64 = 0.3;
/// How far the centres of two objectives may lie apart where nobody has measured it, and by how much each change of objective moves the view,
/// standard deviations, m.
const PARCENTRIC_M: f64 = 20e-6;
const CHANGE_M: f64 = 2e-6;
/// The view of the target's own objective begins so far from its goal, in pixels of the target: the last step then shows what moves with the
/// specimen, and what is on the camera.
const BESIDE_PX: f64 = 30.0;

/// An objective that may take over from one below it, and what that takes.
#[derive(Debug, Clone, PartialEq)]
pub struct HandOver {
    /// The objective.
    pub to: ObjectiveId,
    /// Where its view's centre lies from the one below, in camera axes of the target, m.
    pub offset_m: Vec2,
    /// Where the centre of its view is to lie from the target's, in camera axes of the target, m.
    pub beside_m: Vec2,
    /// Standard deviation of where its view lies from the one below, each coordinate, m.
    pub change_m: f64,
    /// How far from its goal the target is surely in its view, m.
    pub within_m: f64,
}

impl HandOver {
    /// From one objective to another above it. `offset_um`: where that looks beside this one, um in stage axes, where it is known.
    pub(crate) fn between(
        here: &Calibration,
        next: &Objective,
        offset_um: Option<[Known; 2]>,
        target: &Calibration,
    ) -> Self {
        let side_px = here.image_size_px[0].min(here.image_size_px[1]) as f64;
        let (offset_m, change_m) = match offset_um {
            Some(known) => {
                let sigma_m = known.map(|k| 1e-6 * k.sigma);
                let offset_m = known.map(|k| 1e-6 * k.value);
                (offset_m, sigma_m[0].max(sigma_m[1]).hypot(CHANGE_M))
            }
            None => ([0.0; 2], PARCENTRIC_M),
        };
        let beside_m = match next.id == target.objective {
            true => BESIDE_PX * target.um_per_px() * 1e-6 / std::f64::consts::SQRT_2,
            false => 0.0,
        };
        let camera_from_stage = target.stage_from_camera().transpose();
        Self {
            to: next.id.clone(),
            offset_m: camera_from_stage * offset_m,
            beside_m: camera_from_stage * [-beside_m; 2],
            change_m,
            within_m: WITHIN * side_px * 1e-6 * next.nominal_um_per_px,
        }
    }
}

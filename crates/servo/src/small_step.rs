//! Small moves of the stage in the plane, to see what the image makes of them.

use crate::ServoError;
use crate::kinematics::PlanarPose;
use scopeservo_geometry::Vec2;
use scopeservo_scope::{Axis, Instrument};

/// The move that shows the scale, as a share of the smallest field that any objective of the instrument has: it stays in the field
/// whichever is in.
pub(crate) const SHARE: f64 = 0.2;

/// Directions in x and y, with the axis' scatter: half-width in metres.
pub(crate) fn directions(scope: &Instrument) -> Vec<(Vec2, f64)> {
    let axes = [(Axis::X, [1.0, 0.0]), (Axis::Y, [0.0, 1.0])];
    let there = axes
        .iter()
        .filter_map(|(axis, unit)| Some((unit, scope.gate().info().axis(*axis)?.repeatability)));
    there
        .flat_map(|(unit, scatter)| [1.0, -1.0].map(|sign| (unit.map(|u| sign * u), scatter)))
        .collect()
}

/// The place `k` steps away from `home`.
pub(crate) fn place(home: &PlanarPose, along: Vec2, step_m: f64, k: f64) -> PlanarPose {
    PlanarPose {
        x_m: [0, 1].map(|i| home.x_m[i] + k * step_m * along[i]),
        ..*home
    }
}

/// Where the stage stands, as what moves around it count from.
///
/// # Errors
/// What the stage reports.
pub(crate) fn stands(scope: &Instrument) -> Result<PlanarPose, ServoError> {
    let at = scope.gate().position()?;
    Ok(PlanarPose::from(&scope.gate().as_goal(&at)?))
}

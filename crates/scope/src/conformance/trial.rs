//! Where axes are tried: how far, and to which side there is room.

use super::check::said;
use crate::{Axis, AxisInfo, MotionGate, PositiveZ};

/// The longest move, of x or y: long enough to be stopped on the way.
pub(super) const LONG_M: f64 = 2e-3;

/// x or y: the only axes that a long move is made along.
pub(super) fn long_axis(stage: &MotionGate) -> Result<Axis, String> {
    [Axis::X, Axis::Y]
        .into_iter()
        .find(|a| stage.info().axis(*a).is_some())
        .ok_or_else(|| "the stage has neither x nor y".to_string())
}

/// Where the stage is on `axis`, and a place at most `cap` away: towards the farther end of the limits, but for focus
/// always away from the specimen.
pub(super) fn towards_room(stage: &MotionGate, axis: Axis, cap: f64) -> Result<(f64, f64), String> {
    let here = stage
        .position()
        .map_err(said)?
        .si(axis)
        .ok_or_else(|| format!("position() does not report {axis}"))?;
    let range = stage
        .ranges()
        .iter()
        .find(|r| r.axis == axis)
        .ok_or_else(|| format!("{axis} has no limits"))?;
    let upwards = match axis {
        Axis::Z => stage.info().positive_z == PositiveZ::Apart,
        _ => range.max - here >= here - range.min,
    };
    let there = if upwards {
        here + cap.min(range.max - here)
    } else {
        here - cap.min(here - range.min)
    };
    Ok((here, there))
}

/// Where an axis is tried: as far as its trial goes to either side, where there is room, but for focus only away from the specimen.
pub(super) fn tried_places(stage: &MotionGate, info: &AxisInfo) -> Result<(f64, Vec<f64>), String> {
    let (here, towards) = towards_room(stage, info.axis, trial(info.axis))?;
    let range = stage.ranges().iter().find(|r| r.axis == info.axis);
    let range = range.ok_or_else(|| format!("{} has no limits", info.axis))?;
    let other = (2.0 * here - towards).clamp(range.min, range.max);
    let both = match info.axis {
        Axis::Z => vec![towards],
        _ => vec![towards, other],
    };
    // What is nearer than this is the same place.
    let tells = |there: &f64| (there - here).abs() > 2.0 * info.tolerance();
    Ok((here, both.into_iter().filter(tells).collect()))
}

/// The trial move of an axis: 300 um in x and y, else 20 um or 0.01 rad.
pub(super) fn trial(axis: Axis) -> f64 {
    match axis {
        Axis::X | Axis::Y => 300e-6,
        Axis::Z => 20e-6,
        Axis::Rx | Axis::Ry | Axis::Rz => 0.01,
    }
}

//! Which moves a calibration makes.

use scopeservo_geometry::Vec2;
use serde::{Deserialize, Serialize};

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
pub(super) const NEEDED: usize = 4;
/// A place that stayed in so many translations is fixed to the camera.
pub(super) const STAYED: usize = 2;
/// The radius is halved at most so often when views are not found.
pub(super) const HALVINGS: u8 = 3;
/// The first trial rotation: with a lever arm of 0.3 m it sweeps 9 um.
pub(super) const FIRST_ROTATION_RAD: f64 = 3e-5;

/// What comes next.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum State {
    Reference,
    Translate { index: usize, halvings: u8 },
    Probe { angle_rad: f64, tries: u8 },
    Rotate { angles_rad: Vec<f64> },
    Return,
}

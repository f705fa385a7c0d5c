//! The words of a path: settings, what each view is for, what is known, what comes next.

use super::fit::JointFit;
use super::model::View;
use crate::kinematics::PlanarPose;
use scopeservo_scope::Kinematics;
use serde::{Deserialize, Serialize};

/// Settings of a path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PathOptions {
    /// Views at most.
    pub most_views: usize,
    /// Length of an arm of the cross, m.
    pub reach_m: f64,
    /// Widest rotation to either side, rad.
    pub widest_rad: f64,
    /// Length of the first steps, as a share of the shorter side of the field.
    pub first_share: f64,
    /// Two views on an arm have so much of the field in common, at least.
    pub least_overlap: f64,
    /// A rotation may miss the view's centre by so much of the shorter side of the field, by three standard deviations.
    pub miss_share: f64,
    /// Standard deviation of the map, relative, that is enough.
    pub enough_map: f64,
    /// Standard deviation of the rotation centre that is enough, m.
    pub enough_centre_m: f64,
    /// Play of x, y (m) and rotation (rad) at most: an axis that turns back by less makes a run-up.
    pub most_play: [f64; 3],
}

impl Default for PathOptions {
    fn default() -> Self {
        Self {
            most_views: 40,
            reach_m: 0.8e-3,
            widest_rad: 6f64.to_radians(),
            first_share: 0.35,
            least_overlap: 0.4,
            miss_share: 0.25,
            enough_map: 1.5e-4,
            enough_centre_m: 3e-6,
            most_play: [30e-6, 30e-6, 1e-4],
        }
    }
}

/// What a view is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Where the calibration began.
    Reference,
    /// One of two corners of a square, its side halved a few times.
    Corner {
        /// 0 or 1.
        index: u8,
        /// How often the side was halved.
        halvings: u8,
    },
    /// The reference from the other side.
    Return,
    /// Along an axis: +x, -x, +y, -y.
    Arm {
        /// Index of the direction.
        direction: u8,
    },
    /// A rotation to one side, wider than all before.
    Widen {
        /// Tries since the last view that was found.
        tries: u8,
    },
    /// A rotation back and forth about an end of the cross.
    Sweep {
        /// How many were made before.
        index: u8,
    },
    /// The reference again, when all else is seen: whether the stage comes back.
    Home,
}

/// A view that was taken.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Taken {
    /// What it was for.
    pub role: Role,
    /// The pose that was asked for.
    pub asked: PlanarPose,
    /// Where it was.
    pub view: View,
    /// Whether it was registered to another view.
    pub found: bool,
}

/// What is known when the next view is chosen.
#[derive(Clone, Copy)]
pub struct Known<'a> {
    /// How the axes are stacked.
    pub kinematics: Kinematics,
    /// Whether there is an axis of rotation.
    pub turns: bool,
    /// Columns and rows of an image.
    pub image_size_px: [usize; 2],
    /// What is engraved says so many m for a pixel.
    pub nominal_m_per_px: f64,
    /// Where the stage stands, before the first view.
    pub start: PlanarPose,
    /// Index of the optics in the fit.
    pub optics: usize,
    /// All views so far, with these optics.
    pub taken: &'a [Taken],
    /// What they say, as soon as they say something.
    pub fit: Option<&'a JointFit>,
}

/// The next view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Next {
    /// What it is for.
    pub role: Role,
    /// The pose to go through first, where play must be taken up.
    pub via: Option<PlanarPose>,
    /// Where to look.
    pub pose: PlanarPose,
    /// From which side each axis arrives.
    pub approach: [i8; 3],
    /// Which axes move.
    pub arrived: [bool; 3],
}

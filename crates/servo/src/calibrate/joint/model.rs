//! What is known and what is asked: views, pairs of them, priors; optics, backlash, true poses.

use crate::kinematics::PlanarPose;
use scopeservo_geometry::{Mat2, Vec2};
use scopeservo_scope::Kinematics;
use serde::{Deserialize, Serialize};

/// A view: which optics looked, where the stage said it was, and from which side each axis came.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Index into [`Instrument::optics`].
    pub optics: usize,
    /// The pose that the stage reported.
    pub reported: PlanarPose,
    /// x, y, rotation: 1 where the axis arrived going up, -1 going down, with its play taken up.
    pub approach: [i8; 3],
    /// When it was taken, on any clock, s.
    #[serde(default)]
    pub time_s: f64,
    /// Whether the axis was moved since the view before; else, where the axes are not coupled, it stands as it stood there, with whatever it
    /// was off.
    pub arrived: [bool; 3],
}

/// Two overlapping views, registered: where the one's pixels lie in the other.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pair {
    /// The view in whose pixels is measured.
    pub fixed: usize,
    /// The view that is found there.
    pub found: usize,
    /// Where the centre of `found` lies in `fixed`, px from its centre.
    pub centre_px: Vec2,
    /// The angle of the rotation nearest to the linear part of `fixed_from_found`, rad.
    pub angle_rad: f64,
    /// Covariance of (centre x, centre y, angle): px, px, rad.
    pub covariance: [[f64; 3]; 3],
}

/// What is known of an instrument before anything is seen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Priors {
    /// How the axes are stacked.
    pub kinematics: Kinematics,
    /// Standard deviation of where an arrival ends, x, y (m) and rotation (rad). `None`: there is no such axis, it rests.
    pub arrival: [Option<f64>; 3],
    /// Standard deviation of how fast the stage drifts, x and y, m/s; 0: it does not.
    #[serde(default)]
    pub drift_m_per_s: f64,
    /// Whether all axes arrive anew with each move, as a hexapod's do; else one that is not asked to move stands. `None`: what is seen tells.
    #[serde(default)]
    pub coupled: Option<bool>,
    /// Whether arrivals and pairs scatter as stated; else what is seen tells.
    #[serde(default)]
    pub sure: bool,
    /// Standard deviation of the backlash about none, x, y (m) and rotation (rad).
    pub backlash: [f64; 3],
    /// Standard deviation of the rotation centre about none, m per coordinate.
    pub lever_m: f64,
    /// Standard deviation of the centres of two objectives from each other, m per coordinate.
    pub parcentric_m: f64,
}

/// The optics of one objective: a pixel p is fixed at `c = stage_from_pixel (p - p0) + centre_m`, as in a `Calibration`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Optics {
    /// Metres in stage axes per pixel.
    pub stage_from_pixel: Mat2,
    /// Where the image's centre lies from the axis of rotation, in stage axes, m: eta.
    pub centre_m: Vec2,
}

/// What a calibration asks for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Instrument {
    /// x, y (m), rotation (rad): an axis stands `approach * backlash / 2` below where it says, after an approach going up above.
    pub backlash: [f64; 3],
    /// One for each objective.
    pub optics: Vec<Optics>,
}

/// All unknowns: the instrument, and where each view truly was.
///
/// Poses are x, y and an angle, each moved by an axis of its own whose scatter is independent: their product is the manifold on which
/// a step is a sum.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Unknowns {
    pub(super) poses: Vec<PlanarPose>,
    /// How fast the stage drifts, x and y, m/s.
    pub(super) drift: Vec2,
    pub(super) instrument: Instrument,
}

/// Numbers that one optics has: the map row by row, then the centre.
pub(super) const OPTICS: usize = 6;

/// Where each unknown stands: three for each pose, two of drift, three of backlash, six for each optics. Those of the instrument come last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Order {
    pub(super) views: usize,
    pub(super) optics: usize,
}

impl Order {
    pub(super) fn pose(self, view: usize) -> usize {
        3 * view
    }
    pub(super) fn drift(self) -> usize {
        3 * self.views
    }
    pub(super) fn backlash(self) -> usize {
        self.drift() + 2
    }
    pub(super) fn optics(self, index: usize) -> usize {
        self.backlash() + 3 + OPTICS * index
    }
    pub(super) fn count(self) -> usize {
        self.optics(self.optics)
    }
}

impl Unknowns {
    pub(super) fn order(&self) -> Order {
        Order {
            views: self.poses.len(),
            optics: self.instrument.optics.len(),
        }
    }

    /// After a step.
    pub(super) fn plus(&self, step: &[f64]) -> Self {
        let mut moved = self.clone();
        let mut step = step.iter();
        let mut add = |number: &mut f64| *number += step.next().unwrap_or(&0.0);
        for pose in &mut moved.poses {
            pose.x_m.iter_mut().for_each(&mut add);
            add(&mut pose.theta_rad);
        }
        moved.drift.iter_mut().for_each(&mut add);
        moved.instrument.backlash.iter_mut().for_each(&mut add);
        for optics in &mut moved.instrument.optics {
            let map = optics.stage_from_pixel.0.as_flattened_mut();
            map.iter_mut().for_each(&mut add);
            optics.centre_m.iter_mut().for_each(&mut add);
        }
        moved
    }
}

/// x, y, rotation of a pose.
pub(super) fn axes(pose: &PlanarPose) -> [f64; 3] {
    [pose.x_m[0], pose.x_m[1], pose.theta_rad]
}

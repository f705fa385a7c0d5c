//! What one objective's views say by themselves, what all of one microscope are known to share, and what all of them say together.

use super::fit::JointFit;
use super::model::{OPTICS, Optics};
use crate::kinematics::PlanarPose;
use scopeservo_geometry::Vec2;
use scopeservo_scope::Kinematics;
use serde::{Deserialize, Serialize};

/// What one objective's views say by themselves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Single {
    /// x, y (m), rotation (rad).
    pub backlash: [f64; 3],
    /// Its map and its centre.
    pub optics: Optics,
    /// Where the stage truly was at its first view.
    pub first: PlanarPose,
    /// When that was taken, s.
    pub time_s: f64,
    /// How fast the stage drifts, x and y, m/s.
    pub drift: Vec2,
    /// Covariance of the backlash, the map row by row, the centre, the pose of the first view and the drift, 14 x 14, row by row, in SI units;
    /// zero where there is no such axis.
    pub covariance: Vec<f64>,
}

/// What is known of all objectives of a microscope before anything is seen, standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Shared {
    /// How the axes are stacked.
    pub kinematics: Kinematics,
    /// The backlash about none, as each single fit had it: x, y (m), rotation (rad).
    pub backlash: [f64; 3],
    /// The camera's angle as one objective shows it, about that of all, rad.
    pub angle_rad: f64,
    /// Where one objective looks beside the middle of all, m per coordinate.
    pub parcentric_m: f64,
    /// How fast the stage drifts about not at all, as each single fit had it, m/s.
    pub drift_m_per_s: f64,
}

/// All objectives as one instrument.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SetFit {
    /// x, y (m), rotation (rad).
    pub backlash: [f64; 3],
    /// One for each objective.
    pub optics: Vec<Optics>,
    /// Covariance of the backlash, then of each objective's map row by row and its centre: n x n, row by row, SI units; zero where there is no
    /// such axis.
    pub covariance: Vec<f64>,
    /// Weighted sum of squares; chi-square with `freedom` degrees of freedom where all is one instrument.
    pub chi_sq: f64,
    /// What is known more often than it is asked for.
    pub freedom: usize,
    /// The link that all else contradicts, which counts for nothing.
    pub left_out: Option<usize>,
}

/// What objectives of one microscope may contradict each other in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Differing {
    /// The backlash of x or y, m.
    Backlash,
    /// The camera's angle, rad.
    Angle,
    /// The size of a pixel, relative.
    Scale,
    /// Where they look beside the axis of rotation, m.
    Centre,
}

/// By how much two objectives contradict each other, with the standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// In what.
    pub what: Differing,
    /// How far they are apart: m, rad, relative.
    pub by: f64,
    /// What that is uncertain by.
    pub sigma: f64,
}

/// Objectives that are not one instrument.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Apart {
    /// The one without which all others are one; `None` where that is nobody, or several.
    pub odd: Option<usize>,
    /// Where two of them, the odd one among them, contradict each other most.
    pub between: [usize; 2],
    /// In what, and by how much.
    pub difference: Difference,
}

/// Numbers of a single: backlash, map, centre, pose of the first view, drift.
pub(super) const SINGLE: usize = 3 + OPTICS + BESIDES;
const BESIDES: usize = 3 + 2;
/// Of a normal distribution one in 20 000 is above: what arrivals scatter is estimated, so that a little more than one set in so many fails.
const SURE: f64 = 3.891;

impl JointFit {
    /// What these views, all of one objective, say to a set. `time_s`: when the first one was taken.
    pub fn single(&self, time_s: f64) -> Option<Single> {
        let [optics] = self.instrument.optics.as_slice() else {
            return None;
        };
        let n = 3 + OPTICS;
        let cell = |i: usize, j: usize| match (i < n, j < n) {
            (true, true) => self.covariance.get(n * i + j),
            (false, _) => self.besides.get(SINGLE * (i - n) + j),
            (true, false) => self.besides.get(SINGLE * (j - n) + i),
        };
        let all = (0..SINGLE * SINGLE).map(|k| cell(k / SINGLE, k % SINGLE).copied());
        Some(Single {
            backlash: self.instrument.backlash,
            optics: *optics,
            first: *self.poses.first()?,
            time_s,
            drift: self.drift,
            covariance: all.collect::<Option<_>>()?,
        })
    }
}

impl Single {
    pub(super) fn variance(&self, k: usize) -> f64 {
        self.covariance[(SINGLE + 1) * k]
    }
}

impl SetFit {
    /// Whether all this is one instrument, by chi-square.
    pub fn agrees(&self) -> bool {
        if self.freedom == 0 {
            return true;
        }
        // Wilson and Hilferty's.
        let n = self.freedom as f64;
        let share = 2.0 / (9.0 * n);
        self.chi_sq <= n * (1.0 - share + SURE * share.sqrt()).powi(3)
    }

    /// How many numbers the covariance is of.
    pub fn numbers(&self) -> usize {
        3 + OPTICS * self.optics.len()
    }
}

//! The periods between two views, counted: each view shows where its centre lies within one, and what is known so far says in which.

use crate::hand_eye::{Observation, predicted_b, solve_hand_eye};
use crate::kinematics::PlanarPose;
use scopeservo_geometry::{Mat2, Vec2};
use scopeservo_registration::Grid;
use scopeservo_scope::Kinematics;
use serde::{Deserialize, Serialize};

/// A view that lies farther than this from where it is expected, in periods, may be a period off.
const UNSURE: f64 = 0.3;

/// A view of a grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct GridView {
    /// Where the stage said it was.
    pub(super) pose: PlanarPose,
    /// Whether it was asked to turn.
    pub(super) turned: bool,
    pub(super) grid: Grid,
    /// How far its centre lies from that of the first view, in periods.
    pub(super) way: Vec2,
}

/// What the views so far say: periods per metre of the stage, and the rotation centre, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SoFar {
    pub(super) lattice_from_stage: Mat2,
    pub(super) centre_m: Option<Vec2>,
    /// Root mean square, periods per coordinate.
    pub(super) residual: f64,
}

impl SoFar {
    /// How far arrivals scatter, periods per coordinate, and how many coordinates tell it. What all views have in common is where the first
    /// one really was, a single arrival: it says little of how they scatter, and is taken off.
    pub(super) fn scatter(&self, kinematics: Kinematics, views: &[GridView]) -> (f64, f64) {
        let Some(first) = views.first() else {
            return (0.0, 0.0);
        };
        let (map, centre) = (self.lattice_from_stage, self.centre_m.unwrap_or_default());
        let off: Vec<Vec2> = views[1..]
            .iter()
            .map(|v| {
                let expected = predicted_b(kinematics, &first.pose, &v.pose, map, centre);
                [0, 1].map(|k| v.way[k] - expected[k])
            })
            .collect();
        let count = off.len() as f64;
        let sum_sq = |k: usize| {
            let mean = off.iter().map(|o| o[k]).sum::<f64>() / count;
            off.iter().map(|o| (o[k] - mean).powi(2)).sum::<f64>()
        };
        let unknowns = 6 + 2 * usize::from(self.centre_m.is_some());
        let freedom = 2.0 * count - unknowns as f64;
        match freedom > 0.0 {
            true => (((sum_sq(0) + sum_sq(1)) / freedom).sqrt(), freedom),
            false => (0.0, 0.0),
        }
    }
}

/// The views as the mathematics of a calibration has them, with periods in place of pixels: moves without, and with a rotation.
pub(super) fn observations(views: &[GridView]) -> [Vec<Observation>; 2] {
    let Some(first) = views.first() else {
        return [Vec::new(), Vec::new()];
    };
    // The first view's own place is the origin of all.
    let sigma = |grid: &Grid| {
        let [x, y] = [grid.covariance[4][4], grid.covariance[5][5]];
        ((x + y) / 2.0).sqrt() / grid.pitch_px()
    };
    [false, true].map(|turned| {
        let those = views[1..].iter().filter(|v| v.turned == turned);
        those
            .map(|v| Observation {
                pose: v.pose,
                b_px: v.way,
                sigma_px: sigma(&v.grid).hypot(sigma(&first.grid)),
            })
            .collect()
    })
}

/// `None` before the stage has moved along both axes.
pub(super) fn so_far(kinematics: Kinematics, views: &[GridView]) -> Option<SoFar> {
    let [translations, rotations] = observations(views);
    let reference = views.first()?.pose;
    let (lattice_from_stage, centre_m, residual) =
        solve_hand_eye(kinematics, &reference, &translations, &rotations)?;
    Some(SoFar {
        lattice_from_stage,
        centre_m,
        residual,
    })
}

/// How far the centre of a view at `pose` lies from that of the first, in periods; `None` when it may be a period off.
pub(super) fn way(
    kinematics: Kinematics,
    views: &[GridView],
    (pose, turned): (&PlanarPose, bool),
    grid: &Grid,
) -> Option<Vec2> {
    let here = grid.lattice_of_centre()?;
    let Some(first) = views.first() else {
        return Some([0.0; 2]);
    };
    let there = first.grid.lattice_of_centre()?;
    let known = so_far(kinematics, views);
    let centre_m = known.and_then(|k| k.centre_m);
    let expected = known.map_or([0.0; 2], |k| {
        let centre_m = centre_m.unwrap_or_default();
        predicted_b(
            kinematics,
            &first.pose,
            pose,
            k.lattice_from_stage,
            centre_m,
        )
    });
    let seen = [0, 1].map(|k| here[k] - there[k]);
    let way = [0, 1].map(|k| seen[k] + (expected[k] - seen[k]).round());
    // The first moves, and the first rotation, are shorter than half a period.
    let is_first = known.is_none() || (turned && centre_m.is_none());
    let off = (0..2).map(|k| (way[k] - expected[k]).abs());
    (is_first || off.fold(0.0, f64::max) <= UNSURE).then_some(way)
}

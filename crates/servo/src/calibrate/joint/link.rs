//! Two objectives' first views, the one found in the other: where it lies, how it is turned, and how much larger a pixel of it is.

use super::model::{OPTICS, Optics};
use super::sight::{shown, shown_by, sight};
use crate::kinematics::PlanarPose;
use scopeservo_geometry::{Mat2, Vec2};
use scopeservo_scope::Kinematics;
use serde::{Deserialize, Serialize};

/// The centre, px, the angle, rad, and the natural logarithm of the scale.
pub type Seen = [f64; 4];

/// The first view of one objective, found in that of another.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Link {
    /// The one in whose pixels is measured.
    pub fixed: usize,
    /// The one that is found there.
    pub found: usize,
    /// Where the centre of `found` lies in `fixed`, px from its centre; the angle of the rotation nearest to `fixed_from_found`, rad; and the
    /// logarithm of the side of a pixel of `found` in pixels of `fixed`.
    pub seen: Seen,
    /// Covariance of `seen`.
    pub covariance: [Seen; 4],
}

/// An objective and where the stage was at its first view.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stand {
    pub(super) optics: Optics,
    pub(super) pose: PlanarPose,
}

/// The numbers of a stand: the map row by row, the centre, the pose.
pub(super) const STAND: usize = OPTICS + 3;

/// What is seen less what was measured, and the derivative by each number of the stands, `[fixed, found]`.
pub(super) struct Off {
    pub(super) off: Seen,
    pub(super) by: [[Seen; STAND]; 2],
}

impl Link {
    /// `None` where a map is singular.
    pub(super) fn off(&self, kinematics: Kinematics, stands: &[Stand; 2]) -> Option<Off> {
        let sights = [0, 1].map(|n| sight(kinematics, &stands[n].pose, stands[n].optics.centre_m));
        let optics = [&stands[0].optics, &stands[1].optics];
        let [x, y, angle] = shown(&sights, &optics)?;
        let dets = optics.map(|o| o.stage_from_pixel.det().abs());
        let scale = 0.5 * (dets[1] / dets[0]).ln();
        let [sx, sy, s_angle, s_scale] = self.seen;
        let derivative = shown_by(&sights, &optics)?;
        let inverses = [
            optics[0].stage_from_pixel.inverse()?,
            optics[1].stage_from_pixel.inverse()?,
        ];
        let by = [0, 1].map(|n| {
            let sign = [-0.5, 0.5][n];
            std::array::from_fn(|k| {
                let [x, y, angle] = match k {
                    0..OPTICS => derivative.by_optics[n][k],
                    _ => derivative.by_pose[n][k - OPTICS],
                };
                // The logarithm of a determinant changes by the transposed inverse.
                let scale = match k {
                    0..4 => sign * inverses[n].0[k % 2][k / 2],
                    _ => 0.0,
                };
                [x, y, angle, scale]
            })
        });
        let turn = angle - s_angle;
        let turns = (turn / std::f64::consts::TAU).round();
        let off = [
            x - sx,
            y - sy,
            turn - turns * std::f64::consts::TAU,
            scale - s_scale,
        ];
        Some(Off { off, by })
    }
}

/// What of a map tells the camera's angle: beside a rotation `about`, and its derivative by the map's numbers.
pub(super) fn angle_beside(about: Mat2, map: Mat2) -> (f64, [f64; 4]) {
    let Mat2([[a, b], [c, d]]) = about.transpose() * map;
    let (cosine, sine) = (a + d, c - b);
    let length_sq = cosine * cosine + sine * sine;
    let by = std::array::from_fn(|k| {
        let mut unit = Mat2([[0.0; 2]; 2]);
        unit.0[k / 2][k % 2] = 1.0;
        let Mat2([[a, b], [c, d]]) = about.transpose() * unit;
        (cosine * (c - b) - sine * (a + d)) / length_sq
    });
    (f64::atan2(sine, cosine), by)
}

/// How far two centres lie apart as the link shows it, m in stage axes, for so many pixels of the one that is measured in.
pub(super) fn apart_m(fixed: &Optics, px: Vec2) -> f64 {
    let [x, y] = fixed.stage_from_pixel * px;
    f64::hypot(x, y)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stands() -> [Stand; 2] {
        let stand = |map, centre_m, x_m, theta_rad| Stand {
            optics: Optics {
                stage_from_pixel: map,
                centre_m,
            },
            pose: PlanarPose { x_m, theta_rad },
        };
        [
            stand(
                Mat2([[-9e-8, -1.1e-6], [1.05e-6, 3e-8]]),
                [0.125, -0.003],
                [1e-3, 2e-3],
                0.07,
            ),
            stand(
                Mat2([[-3e-8, -5.1e-7], [4.9e-7, -2e-8]]),
                [0.125_01, -0.003_02],
                [1e-3 + 2e-7, 2e-3],
                0.07,
            ),
        ]
    }

    #[test]
    fn the_derivative_is_that_of_central_differences() {
        let link = Link {
            fixed: 0,
            found: 1,
            seen: [0.0; 4],
            covariance: [[0.0; 4]; 4],
        };
        for kinematics in [
            Kinematics::MovesMicroscope,
            Kinematics::SpecimenRotationOnTop,
            Kinematics::SpecimenXyOnTop,
        ] {
            let by = link.off(kinematics, &stands()).unwrap().by;
            for n in 0..2 {
                for k in 0..STAND {
                    let step = [1e-11, 1e-6, 1e-6][usize::from(k >= 4) + usize::from(k >= 6)];
                    let at = |sign: f64| {
                        let mut stands = stands();
                        let (optics, pose) = (&mut stands[n].optics, &mut stands[n].pose);
                        let number = match k {
                            0..4 => &mut optics.stage_from_pixel.0[k / 2][k % 2],
                            4 | 5 => &mut optics.centre_m[k - 4],
                            6 | 7 => &mut pose.x_m[k - 6],
                            _ => &mut pose.theta_rad,
                        };
                        *number += sign * step;
                        link.off(kinematics, &stands).unwrap().off
                    };
                    let (after, before) = (at(1.0), at(-1.0));
                    for r in 0..4 {
                        let numeric = (after[r] - before[r]) / (2.0 * step);
                        let scale = by[n][k].iter().fold(1.0f64, |a, b| a.max(b.abs()));
                        let off = (numeric - by[n][k][r]).abs();
                        assert!(off < 1e-5 * scale, "{kinematics:?} {n} {k} {r}: {off}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_angle_of_a_map_changes_as_it_turns() {
        let map = stands()[0].optics.stage_from_pixel;
        let about = map.nearest_orthogonal();
        let turned = Mat2::rotation(1e-3) * map;
        let (angle, _) = angle_beside(about, turned);
        assert!((angle - 1e-3).abs() < 1e-12, "{angle}");
        let (_, by) = angle_beside(about, map);
        let change = turned - map;
        let linear: f64 = by
            .iter()
            .zip(change.0.as_flattened())
            .map(|(a, b)| a * b)
            .sum();
        assert!((linear - 1e-3).abs() < 1e-6, "{linear}");
    }
}

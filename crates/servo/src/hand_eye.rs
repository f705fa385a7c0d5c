//! The mathematics of the two-step calibration, Eqs. (12)-(18) over a general 2x2 map: observations in, map, rotation
//! centre and their covariance out. No instrument here.

use crate::Calibration;
use crate::kinematics::{PlanarPose, motion_between};
use scopeservo_geometry::{Mat2, Vec2, least_squares};
use scopeservo_scope::{Axis, AxisInfo, Kinematics, StageInfo};
use serde::{Deserialize, Serialize};

/// One measured move from the reference view.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// Where the stage was.
    pub pose: PlanarPose,
    /// b of (10) about the principal points: where the image's present centre lay in the reference image, px from its
    /// centre.
    pub b_px: Vec2,
    /// Standard deviation of one coordinate of b, px.
    pub sigma_px: f64,
}

/// The two linear steps. Returns `pixel_from_stage` (px per m in stage axes), the rotation centre (m) when there are
/// rotations, and the root mean square residual (px per coordinate). `None` when the moves do not determine the unknowns.
///
/// Step 1 solves `b = P d` over the translations (13)-(15), step 2 `(R(alpha) - I) eta = P^-1 b - d` over the rotations
/// (17)-(18), with (alpha, d) the motion of the view in stage axes at the reference pose.
pub fn solve_hand_eye(
    kinematics: Kinematics,
    reference: &PlanarPose,
    translations: &[Observation],
    rotations: &[Observation],
) -> Option<(Mat2, Option<Vec2>, f64)> {
    let row = |k: usize| {
        let equations: Vec<([f64; 2], f64)> = translations
            .iter()
            .map(|o| {
                (
                    motion_between(kinematics, reference, &o.pose).d_m,
                    o.b_px[k],
                )
            })
            .collect();
        least_squares(&equations).map(|(p, _)| p)
    };
    let pixel_from_stage = Mat2([row(0)?, row(1)?]);
    let stage_from_pixel = pixel_from_stage.inverse()?;

    let mut equations = Vec::new();
    for o in rotations {
        let motion = motion_between(kinematics, reference, &o.pose);
        let turn = Mat2::rotation(motion.alpha_rad) - Mat2::IDENTITY;
        let moved = stage_from_pixel * o.b_px;
        let right = [moved[0] - motion.d_m[0], moved[1] - motion.d_m[1]];
        equations.extend(turn.0.into_iter().zip(right));
    }
    let eta = if rotations.is_empty() {
        None
    } else {
        Some(least_squares(&equations)?.0)
    };

    let mut sum_sq = 0.0;
    for o in translations.iter().chain(rotations) {
        let eta = eta.unwrap_or([0.0; 2]);
        let predicted = predicted_b(kinematics, reference, &o.pose, pixel_from_stage, eta);
        sum_sq += (predicted[0] - o.b_px[0]).powi(2) + (predicted[1] - o.b_px[1]).powi(2);
    }
    let count = 2 * (translations.len() + rotations.len());
    Some((pixel_from_stage, eta, (sum_sq / count as f64).sqrt()))
}

/// b that a calibration predicts for a stage at `pose`: Eq. (12) over a general map.
pub(crate) fn predicted_b(
    kinematics: Kinematics,
    reference: &PlanarPose,
    pose: &PlanarPose,
    pixel_from_stage: Mat2,
    eta: Vec2,
) -> Vec2 {
    let motion = motion_between(kinematics, reference, pose);
    let turned = Mat2::rotation(motion.alpha_rad) * eta;
    pixel_from_stage * [0, 1].map(|k| turned[k] - eta[k] + motion.d_m[k])
}

/// Standard deviations of where a stage comes to stand: m, m, rad.
pub(crate) fn pose_sigma(info: &StageInfo) -> [f64; 3] {
    [Axis::X, Axis::Y, Axis::Rz]
        .map(|axis| info.axis(axis).map_or(0.0, AxisInfo::standard_deviation))
}

/// Standard deviation per coordinate, px, of a view's displacement from the stage's repeatability, at the view and at the
/// reference.
pub(crate) fn explained_px(
    reference: &PlanarPose,
    calibration: &Calibration,
    kinematics: Kinematics,
    pose_sigma: [f64; 3],
) -> f64 {
    let Some(p) = calibration.pixel_from_stage() else {
        return 0.0;
    };
    let eta = calibration.rotation_centre_m.unwrap_or([0.0; 2]);
    let sum_sq: f64 = (0..3)
        .map(|k| {
            let pose = nudged(reference, pose_sigma, k);
            let b = predicted_b(kinematics, reference, &pose, p, eta);
            b[0] * b[0] + b[1] * b[1]
        })
        .sum();
    // Two places, two coordinates.
    sum_sq.sqrt()
}

/// A pose displaced along one of x, y, rotation by its sigma.
fn nudged(pose: &PlanarPose, pose_sigma: [f64; 3], k: usize) -> PlanarPose {
    let mut pose = *pose;
    match k {
        0 | 1 => pose.x_m[k] += pose_sigma[k],
        _ => pose.theta_rad += pose_sigma[2],
    }
    pose
}

/// Covariance of (stage_from_pixel, rotation centre) by first-order propagation through the solver itself: of the
/// stage's repeatability at every place, the reference included (`pose_sigma`: m, m, rad), which changes what is seen
/// but not what is reported, and of the registration noise.
pub(crate) fn covariance(
    kinematics: Kinematics,
    reference: &PlanarPose,
    translations: &[Observation],
    rotations: &[Observation],
    pose_sigma: [f64; 3],
) -> Option<[[f64; 6]; 6]> {
    let (p, eta, _) = solve_hand_eye(kinematics, reference, translations, rotations)?;
    let parameters = |t: &[Observation], r: &[Observation]| {
        let (p, eta, _) = solve_hand_eye(kinematics, reference, t, r)?;
        let (m, eta) = (p.inverse()?.0, eta.unwrap_or([0.0; 2]));
        Some([m[0][0], m[0][1], m[1][0], m[1][1], eta[0], eta[1]])
    };
    let base = parameters(translations, rotations)?;
    let seen = |reference: &PlanarPose, pose: &PlanarPose| {
        predicted_b(kinematics, reference, pose, p, eta.unwrap_or([0.0; 2]))
    };
    let mut out = [[0.0; 6]; 6];
    let mut add = |change_of_b: &dyn Fn(usize, &Observation) -> Vec2| {
        let count = translations.len();
        let with = |first: usize, list: &[Observation]| -> Vec<Observation> {
            let changed = list.iter().enumerate().map(|(i, o)| {
                let change = change_of_b(first + i, o);
                Observation {
                    b_px: [o.b_px[0] + change[0], o.b_px[1] + change[1]],
                    ..*o
                }
            });
            changed.collect()
        };
        let moved = parameters(&with(0, translations), &with(count, rotations))?;
        for i in 0..6 {
            for j in 0..6 {
                out[i][j] += (moved[i] - base[i]) * (moved[j] - base[j]);
            }
        }
        Some(())
    };
    let difference = |a: Vec2, b: Vec2| [a[0] - b[0], a[1] - b[1]];
    for k in 0..3 {
        // The reference frame was taken a little elsewhere: every view is displaced.
        add(&|_, o| {
            difference(
                seen(&nudged(reference, pose_sigma, k), &o.pose),
                seen(reference, &o.pose),
            )
        })?;
    }
    for index in 0..translations.len() + rotations.len() {
        for k in 0..5 {
            add(&|i, o| match k {
                _ if i != index => [0.0; 2],
                0..3 => difference(
                    seen(reference, &nudged(&o.pose, pose_sigma, k)),
                    seen(reference, &o.pose),
                ),
                3 => [o.sigma_px, 0.0],
                _ => [0.0, o.sigma_px],
            })?;
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::DIRECTIONS;

    /// b that a perfect instrument would show.
    fn observed(
        kinematics: Kinematics,
        reference: &PlanarPose,
        pose: PlanarPose,
        p: Mat2,
        eta: Vec2,
    ) -> Observation {
        Observation {
            pose,
            b_px: predicted_b(kinematics, reference, &pose, p, eta),
            sigma_px: 0.03,
        }
    }

    #[test]
    fn the_truth_is_recovered_from_any_start_angle_side_and_handedness() {
        let maps = [
            Mat2([[-3000.0, -1.9e6], [1.95e6, -2500.0]]),
            Mat2([[1.2e6, 1.1e6], [1.1e6, -1.3e6]]),
        ];
        for kinematics in [
            Kinematics::MovesMicroscope,
            Kinematics::SpecimenRotationOnTop,
            Kinematics::SpecimenXyOnTop,
        ] {
            for p in maps {
                let eta = [0.125, -0.003];
                let reference = PlanarPose {
                    x_m: [1e-3, -2e-3],
                    theta_rad: 4f64.to_radians(),
                };
                let at = |dx: Vec2, turn: f64| {
                    let pose = PlanarPose {
                        x_m: [reference.x_m[0] + dx[0], reference.x_m[1] + dx[1]],
                        theta_rad: reference.theta_rad + turn,
                    };
                    observed(kinematics, &reference, pose, p, eta)
                };
                let t: Vec<_> = DIRECTIONS
                    .iter()
                    .map(|d| at(d.map(|v| v * 80e-6), 0.0))
                    .collect();
                let r = vec![at([0.0; 2], 1e-3), at([0.0; 2], -1e-3)];
                let (p_hat, eta_hat, residual) =
                    solve_hand_eye(kinematics, &reference, &t, &r).unwrap();
                assert!(
                    (p_hat - p).frobenius() / p.frobenius() < 1e-9,
                    "{kinematics:?}"
                );
                let eta_hat = eta_hat.unwrap();
                for k in 0..2 {
                    assert!(
                        (eta_hat[k] - eta[k]).abs() < 1e-9,
                        "{kinematics:?} {eta_hat:?}"
                    );
                }
                assert!(residual < 1e-6);
            }
        }
    }

    #[test]
    fn the_covariance_is_the_scatter_of_a_noisy_stage() {
        let kinematics = Kinematics::MovesMicroscope;
        let (p, eta) = (Mat2([[-3000.0, -1.9e6], [1.95e6, -2500.0]]), [0.125, 0.001]);
        let home = PlanarPose {
            x_m: [0.0; 2],
            theta_rad: 0.0,
        };
        let sigma = [1e-7, 1e-7, 2e-6];
        let mut rng = scopeservo_geometry::SplitMix64::new(4);
        let mut wrong = |pose: &PlanarPose| PlanarPose {
            x_m: [0, 1].map(|k| pose.x_m[k] + sigma[k] * rng.normal()),
            theta_rad: pose.theta_rad + sigma[2] * rng.normal(),
        };
        let (mut sum_sq, mut expected) = ([0.0; 6], [0.0; 6]);
        for _ in 0..400 {
            let reference = wrong(&home);
            let mut seen = |x_m: Vec2, theta_rad: f64| {
                let pose = PlanarPose { x_m, theta_rad };
                Observation {
                    pose,
                    b_px: predicted_b(kinematics, &reference, &wrong(&pose), p, eta),
                    sigma_px: 0.0,
                }
            };
            let t: Vec<_> = DIRECTIONS
                .iter()
                .map(|d| seen(d.map(|v| v * 80e-6), 0.0))
                .collect();
            let r = [8e-4, -8e-4].map(|a| seen([0.0; 2], a));
            let (p_hat, eta_hat, _) = solve_hand_eye(kinematics, &home, &t, &r).unwrap();
            let (m, m_hat) = (p.inverse().unwrap().0, p_hat.inverse().unwrap().0);
            let eta_hat = eta_hat.unwrap();
            let covariance = covariance(kinematics, &home, &t, &r, sigma).unwrap();
            for i in 0..6 {
                let off = match i {
                    0..4 => m_hat[i / 2][i % 2] - m[i / 2][i % 2],
                    _ => eta_hat[i - 4] - eta[i - 4],
                };
                sum_sq[i] += off * off;
                expected[i] += covariance[i][i];
            }
        }
        for i in 0..6 {
            let ratio = (sum_sq[i] / expected[i]).sqrt();
            assert!((0.85..1.15).contains(&ratio), "parameter {i}: {ratio}");
        }
    }

    #[test]
    fn moves_along_one_line_do_not_determine_the_map() {
        let reference = PlanarPose {
            x_m: [0.0; 2],
            theta_rad: 0.0,
        };
        let t: Vec<_> = [1e-4, 2e-4, -1e-4]
            .map(|x| Observation {
                pose: PlanarPose {
                    x_m: [x, 0.0],
                    theta_rad: 0.0,
                },
                b_px: [x * 2e6, 0.0],
                sigma_px: 0.1,
            })
            .to_vec();
        assert!(solve_hand_eye(Kinematics::MovesMicroscope, &reference, &t, &[]).is_none());
    }
}

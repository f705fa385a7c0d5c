//! Where the optics look on the specimen, and how a pair of views shows it.
//!
//! With s the specimen point of an image's centre and phi the angle of the stage's axes there, all three stackings of
//! [`crate::kinematics`] read `specimen = R(phi) (c - eta) + s`:
//! - microscope on the stage:     `phi =  th, s = R(phi) eta + x`
//! - specimen, rotation on top:   `phi = -th, s = R(phi) (eta - x)`
//! - specimen, x y on top:        `phi = -th, s = R(phi) eta - x`
//!
//! A pair of views a, b has `alpha = phi_b - phi_a` and `u = R(-phi_a) (s_b - s_a)`; with M the maps from pixels to the stage it shows the
//! centre `M_a^-1 u` and the rotation nearest to `M_a^-1 R(alpha) M_b`.

use super::model::{OPTICS, Optics};
use super::three::Three;
use crate::kinematics::PlanarPose;
use scopeservo_geometry::{Mat2, Vec2};
use scopeservo_scope::Kinematics;

/// A quarter turn: the derivative of a rotation is this times the rotation.
const QUARTER: Mat2 = Mat2([[0.0, -1.0], [1.0, 0.0]]);

/// Where the image's centre lies on the specimen, with its derivatives.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight {
    pub(super) s_m: Vec2,
    pub(super) phi_rad: f64,
    /// Of s by x and y; by eta it is R(phi).
    s_by_x: Mat2,
    s_by_theta: Vec2,
    phi_by_theta: f64,
}

fn minus(a: Vec2, b: Vec2) -> Vec2 {
    [a[0] - b[0], a[1] - b[1]]
}

/// What optics with its centre at `centre_m` sees at a pose.
pub(super) fn sight(kinematics: Kinematics, pose: &PlanarPose, centre_m: Vec2) -> Sight {
    let phi_by_theta = match kinematics {
        Kinematics::MovesMicroscope => 1.0,
        Kinematics::SpecimenRotationOnTop | Kinematics::SpecimenXyOnTop => -1.0,
    };
    let phi_rad = phi_by_theta * pose.theta_rad;
    let turn = Mat2::rotation(phi_rad);
    let (turned, s_by_x) = match kinematics {
        Kinematics::MovesMicroscope => (turn * centre_m, Mat2::IDENTITY),
        Kinematics::SpecimenRotationOnTop => (turn * minus(centre_m, pose.x_m), turn * -1.0),
        Kinematics::SpecimenXyOnTop => (turn * centre_m, Mat2::IDENTITY * -1.0),
    };
    let moved = match kinematics {
        Kinematics::SpecimenRotationOnTop => [0.0; 2],
        Kinematics::MovesMicroscope | Kinematics::SpecimenXyOnTop => s_by_x * pose.x_m,
    };
    Sight {
        s_m: [turned[0] + moved[0], turned[1] + moved[1]],
        phi_rad,
        s_by_x,
        s_by_theta: (QUARTER * turned).map(|v| v * phi_by_theta),
        phi_by_theta,
    }
}

/// What a pair shows: the centre, px, and the angle, rad.
pub(super) type Shown = Three;

/// The derivative of [`Shown`] by the poses of a and b and by the optics of a and b, each by columns.
pub(super) struct Derivative {
    pub(super) by_pose: [[Shown; 3]; 2],
    pub(super) by_optics: [[Shown; OPTICS]; 2],
}

/// The cosine and the sine of the rotation nearest to a 2x2 matrix, times a common factor.
fn heading(linear: Mat2) -> Vec2 {
    let Mat2([[a, b], [c, d]]) = linear;
    [a + d, c - b]
}

/// What the pair of sights `[a, b]` through `[a, b]` shows. `None` when the map of a is singular.
pub(super) fn shown(sights: &[Sight; 2], optics: &[&Optics; 2]) -> Option<Shown> {
    let [a, b] = sights;
    let pixel_from_stage = optics[0].stage_from_pixel.inverse()?;
    let u_m = Mat2::rotation(-a.phi_rad) * minus(b.s_m, a.s_m);
    let turn = Mat2::rotation(b.phi_rad - a.phi_rad);
    let [cosine, sine] = heading(pixel_from_stage * turn * optics[1].stage_from_pixel);
    let [x, y] = pixel_from_stage * u_m;
    Some([x, y, f64::atan2(sine, cosine)])
}

/// The derivative of [`shown`].
pub(super) fn shown_by(sights: &[Sight; 2], optics: &[&Optics; 2]) -> Option<Derivative> {
    let [a, b] = sights;
    let pixel_from_stage = optics[0].stage_from_pixel.inverse()?;
    let back = Mat2::rotation(-a.phi_rad);
    let u_m = back * minus(b.s_m, a.s_m);
    let turn = Mat2::rotation(b.phi_rad - a.phi_rad);
    let linear = pixel_from_stage * turn * optics[1].stage_from_pixel;
    let centre_px = pixel_from_stage * u_m;
    let [cosine, sine] = heading(linear);
    let length_sq = cosine * cosine + sine * sine;
    let angle_by = |change: Mat2| {
        let [c, s] = heading(change);
        (cosine * s - sine * c) / length_sq
    };
    let by = |u_by: Vec2, linear_by: Mat2| {
        let [x, y] = pixel_from_stage * u_by;
        [x, y, angle_by(linear_by)]
    };
    let still = Mat2([[0.0; 2]; 2]);
    let linear_by_alpha = pixel_from_stage * QUARTER * turn * optics[1].stage_from_pixel;
    let column = |m: Mat2, k: usize| [m.0[0][k], m.0[1][k]];
    let u_by_x = [back * a.s_by_x * -1.0, back * b.s_by_x];
    let swung = QUARTER * u_m;
    let u_by_theta = [
        {
            let lever = back * a.s_by_theta;
            [0, 1].map(|k| -lever[k] - a.phi_by_theta * swung[k])
        },
        back * b.s_by_theta,
    ];
    let linear_by_theta = [-a.phi_by_theta, b.phi_by_theta].map(|sign| linear_by_alpha * sign);
    let by_pose = [0, 1].map(|n| {
        [
            by(column(u_by_x[n], 0), still),
            by(column(u_by_x[n], 1), still),
            by(u_by_theta[n], linear_by_theta[n]),
        ]
    });
    let u_by_centre = [Mat2::IDENTITY * -1.0, turn];
    let by_optics = [0, 1].map(|n| {
        std::array::from_fn(|number| match number {
            0..4 => {
                let mut unit = still;
                unit.0[number / 2][number % 2] = 1.0;
                match n {
                    // M_a^-1 changes by -M_a^-1 dM M_a^-1.
                    0 => by(
                        (unit * centre_px).map(|v| -v),
                        pixel_from_stage * unit * linear * -1.0,
                    ),
                    _ => by([0.0; 2], pixel_from_stage * turn * unit),
                }
            }
            _ => by(column(u_by_centre[n], number - 4), still),
        })
    });
    Some(Derivative { by_pose, by_optics })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::motion_between;

    const KINEMATICS: [Kinematics; 3] = [
        Kinematics::MovesMicroscope,
        Kinematics::SpecimenRotationOnTop,
        Kinematics::SpecimenXyOnTop,
    ];

    fn optics() -> [Optics; 2] {
        [
            Optics {
                stage_from_pixel: Mat2([[-3e-8, -5.1e-7], [4.9e-7, -2e-8]]),
                centre_m: [0.125, -0.003],
            },
            Optics {
                stage_from_pixel: Mat2([[-9e-8, -1.1e-6], [1.05e-6, 3e-8]]),
                centre_m: [0.125_01, -0.003_02],
            },
        ]
    }

    const POSES: [PlanarPose; 2] = [
        PlanarPose {
            x_m: [0.003, -0.002],
            theta_rad: 0.07,
        },
        PlanarPose {
            x_m: [0.0031, -0.0025],
            theta_rad: 0.068,
        },
    ];

    fn seen(kinematics: Kinematics, poses: &[PlanarPose; 2], optics: &[Optics; 2]) -> Shown {
        let sights = [0, 1].map(|n| sight(kinematics, &poses[n], optics[n].centre_m));
        shown(&sights, &[&optics[0], &optics[1]]).unwrap()
    }

    #[test]
    fn a_pair_shows_the_motion_between_its_poses() {
        for kinematics in KINEMATICS {
            let optics = [optics()[0]; 2];
            let motion = motion_between(kinematics, &POSES[0], &POSES[1]);
            let turn = Mat2::rotation(motion.alpha_rad);
            let (map, eta) = (optics[0].stage_from_pixel, optics[0].centre_m);
            let turned = turn * eta;
            let p = map.inverse().unwrap();
            let b = p * [0, 1].map(|k| turned[k] - eta[k] + motion.d_m[k]);
            let angle = (p * turn * map).rotation_angle().unwrap();
            let shown = seen(kinematics, &POSES, &optics);
            assert!((shown[0] - b[0]).abs() < 1e-6 && (shown[1] - b[1]).abs() < 1e-6);
            assert!((shown[2] - angle).abs() < 1e-12);
        }
    }

    #[test]
    fn the_derivative_is_that_of_central_differences() {
        for kinematics in KINEMATICS {
            let (poses, optics) = (POSES, optics());
            let sights = [0, 1].map(|n| sight(kinematics, &poses[n], optics[n].centre_m));
            let by = shown_by(&sights, &[&optics[0], &optics[1]]).unwrap();
            for n in 0..2 {
                for number in 0..3 + OPTICS {
                    let step = match number {
                        0 | 1 | 7 | 8 => 1e-6,
                        2 => 1e-5,
                        _ => 1e-11,
                    };
                    let at = |sign: f64| {
                        let (mut poses, mut optics) = (poses, optics);
                        let change = sign * step;
                        match number {
                            0 | 1 => poses[n].x_m[number] += change,
                            2 => poses[n].theta_rad += change,
                            3..7 => {
                                optics[n].stage_from_pixel.0[(number - 3) / 2][(number - 3) % 2] +=
                                    change;
                            }
                            _ => optics[n].centre_m[number - 7] += change,
                        }
                        seen(kinematics, &poses, &optics)
                    };
                    let (after, before) = (at(1.0), at(-1.0));
                    let analytic = match number {
                        0..3 => by.by_pose[n][number],
                        _ => by.by_optics[n][number - 3],
                    };
                    for k in 0..3 {
                        let numeric = (after[k] - before[k]) / (2.0 * step);
                        let scale = analytic.iter().fold(1.0f64, |a, b| a.max(b.abs()));
                        assert!(
                            (numeric - analytic[k]).abs() < 1e-6 * scale,
                            "{kinematics:?} {n} {number} {k}: {numeric} {}",
                            analytic[k]
                        );
                    }
                }
            }
        }
    }
}

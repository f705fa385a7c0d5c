//! How a stage move changes the place of the view, for every way of stacking the axes.
//!
//! Let c be a point fixed to the optics, in stage coordinates (metres), and s the specimen point it shows:
//! - microscope on the stage:     `s = R(th) c + x`
//! - specimen, rotation on top:   `s = R(-th) (c - x)`
//! - specimen, x y on top:        `s = R(-th) c - x`
//!
//! A move from pose 0 to pose 1 shows at c1 what was at `c0 = R(alpha) c1 + d`. [`motion_between`] gives (alpha, d) of
//! two poses, [`pose_after`] the pose that makes a wanted (alpha, d): the paper's Eq. (5), both ways.

use scopeservo_geometry::{Mat2, Vec2};
use scopeservo_scope::{Angle, Kinematics, Length, StagePose};
use serde::{Deserialize, Serialize};

/// The part of a stage pose that moves the view in the specimen plane. A missing axis counts as standing at zero.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PlanarPose {
    /// x, y in metres.
    pub x_m: Vec2,
    /// Rotation about z in radians.
    pub theta_rad: f64,
}

impl From<&StagePose> for PlanarPose {
    fn from(pose: &StagePose) -> Self {
        Self {
            x_m: [pose.x.map_or(0.0, Length::m), pose.y.map_or(0.0, Length::m)],
            theta_rad: pose.rz.map_or(0.0, Angle::rad),
        }
    }
}

impl PlanarPose {
    /// The request that brings the axes of `present` here; axes that `present` lacks are left out, and so is focus.
    pub fn request(&self, present: &StagePose) -> StagePose {
        StagePose {
            x: present.x.map(|_| Length::from_m(self.x_m[0])),
            y: present.y.map(|_| Length::from_m(self.x_m[1])),
            rz: present.rz.map(|_| Angle::from_rad(self.theta_rad)),
            ..StagePose::default()
        }
    }
}

/// `c0 = R(alpha) c1 + d`: where what is now at c1 was before, in stage axes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Motion2 {
    /// Rotation, radians.
    pub alpha_rad: f64,
    /// Translation, metres.
    pub d_m: Vec2,
}

fn plus(a: Vec2, b: Vec2) -> Vec2 {
    [a[0] + b[0], a[1] + b[1]]
}

fn minus(a: Vec2, b: Vec2) -> Vec2 {
    [a[0] - b[0], a[1] - b[1]]
}

/// The motion of the view between two poses.
pub fn motion_between(kinematics: Kinematics, before: &PlanarPose, after: &PlanarPose) -> Motion2 {
    let (x0, x1) = (before.x_m, after.x_m);
    let turn = after.theta_rad - before.theta_rad;
    let (alpha_rad, d_m) = match kinematics {
        Kinematics::MovesMicroscope => (turn, Mat2::rotation(-before.theta_rad) * minus(x1, x0)),
        Kinematics::SpecimenRotationOnTop => (-turn, minus(x0, Mat2::rotation(-turn) * x1)),
        Kinematics::SpecimenXyOnTop => (-turn, Mat2::rotation(before.theta_rad) * minus(x0, x1)),
    };
    Motion2 { alpha_rad, d_m }
}

/// The pose that makes the given motion of the view.
pub fn pose_after(kinematics: Kinematics, before: &PlanarPose, motion: &Motion2) -> PlanarPose {
    let (x0, alpha, d) = (before.x_m, motion.alpha_rad, motion.d_m);
    match kinematics {
        Kinematics::MovesMicroscope => PlanarPose {
            x_m: plus(x0, Mat2::rotation(before.theta_rad) * d),
            theta_rad: before.theta_rad + alpha,
        },
        Kinematics::SpecimenRotationOnTop => PlanarPose {
            x_m: Mat2::rotation(-alpha) * minus(x0, d),
            theta_rad: before.theta_rad - alpha,
        },
        Kinematics::SpecimenXyOnTop => PlanarPose {
            x_m: minus(x0, Mat2::rotation(-before.theta_rad) * d),
            theta_rad: before.theta_rad - alpha,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Kinematics; 3] = [
        Kinematics::MovesMicroscope,
        Kinematics::SpecimenRotationOnTop,
        Kinematics::SpecimenXyOnTop,
    ];

    fn specimen_point(kinematics: Kinematics, pose: &PlanarPose, c: Vec2) -> Vec2 {
        let (x, th) = (pose.x_m, pose.theta_rad);
        match kinematics {
            Kinematics::MovesMicroscope => plus(Mat2::rotation(th) * c, x),
            Kinematics::SpecimenRotationOnTop => Mat2::rotation(-th) * minus(c, x),
            Kinematics::SpecimenXyOnTop => minus(Mat2::rotation(-th) * c, x),
        }
    }

    const BEFORE: PlanarPose = PlanarPose {
        x_m: [0.003, -0.002],
        theta_rad: 0.07,
    };
    const AFTER: PlanarPose = PlanarPose {
        x_m: [-0.001, 0.004],
        theta_rad: -0.11,
    };

    #[test]
    fn the_same_specimen_point_is_seen_before_and_after() {
        for k in ALL {
            let Motion2 { alpha_rad, d_m } = motion_between(k, &BEFORE, &AFTER);
            for c1 in [[0.125, 0.0], [0.01, -0.03]] {
                let c0 = plus(Mat2::rotation(alpha_rad) * c1, d_m);
                let (a, b) = (
                    specimen_point(k, &BEFORE, c0),
                    specimen_point(k, &AFTER, c1),
                );
                assert!(f64::hypot(a[0] - b[0], a[1] - b[1]) < 1e-15, "{k:?}");
            }
        }
    }

    #[test]
    fn pose_after_undoes_motion_between() {
        for k in ALL {
            let pose = pose_after(k, &BEFORE, &motion_between(k, &BEFORE, &AFTER));
            assert!((pose.theta_rad - AFTER.theta_rad).abs() < 1e-15, "{k:?}");
            assert!((pose.x_m[0] - AFTER.x_m[0]).abs() < 1e-15, "{k:?}");
            assert!((pose.x_m[1] - AFTER.x_m[1]).abs() < 1e-15, "{k:?}");
        }
    }

    #[test]
    fn missing_axes_are_not_asked_to_move() {
        let xy = StagePose {
            x: Some(Length::from_um(1.0)),
            y: Some(Length::from_um(2.0)),
            ..StagePose::default()
        };
        let request = PlanarPose::from(&xy).request(&xy);
        assert_eq!((request.rz, request.z), (None, None));
        assert_eq!(request.x, Some(Length::from_um(1.0)));
    }
}

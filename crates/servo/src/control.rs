//! Homography to pose error, pose error to velocity: the paper's Algorithm 1, lines 13 to 16, Eqs. (7), (19)-(22).

use crate::{Calibration, Motion2};
use scopeservo_geometry::{Affine2, Mat2, Vec2};
use serde::{Deserialize, Serialize};

/// A pose or a velocity of {C} in the plane: metres and radians (per iteration for a velocity).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseError {
    /// x, y in metres.
    pub t_m: Vec2,
    /// Rotation in radians.
    pub theta_rad: f64,
}

impl PoseError {
    /// The translation, um.
    pub fn t_um(&self) -> Vec2 {
        self.t_m.map(|v| v * 1e6)
    }
    /// Length of the translation, um.
    pub fn distance_um(&self) -> f64 {
        f64::hypot(self.t_m[0], self.t_m[1]) * 1e6
    }
    /// Rotation, degrees.
    pub fn angle_deg(&self) -> f64 {
        self.theta_rad.to_degrees()
    }
}

/// The error `e = s - s*`, s the pose of {C} in {C*}, from the measured `target_from_view` (J_t of Eq. 10).
///
/// `H = K_t^-1 J_t K` about both principal points; t is its last column, theta the angle of `U V^T` of its 2x2 part.
/// `None` when that is a reflection: the calibrations then contradict the images.
pub fn pose_error(
    target_from_view: &Affine2,
    view: &Calibration,
    target: &Calibration,
    view_centre_px: Vec2,
    target_centre_px: Vec2,
) -> Option<PoseError> {
    let j_t = target_from_view.recentred(view_centre_px, target_centre_px);
    let k_t_inverse = target.intrinsic()?.inverse()?;
    let h_linear = k_t_inverse * j_t.linear * view.intrinsic()?;
    Some(PoseError {
        t_m: k_t_inverse * j_t.offset,
        theta_rad: h_linear.rotation_angle()?,
    })
}

/// `v_c = -lambda L^-1 e` with `L = diag(R(theta), 1)`: translation in the axes of {C}, per iteration.
pub fn control_law(error: &PoseError, lambda: f64) -> PoseError {
    let along = Mat2::rotation(-error.theta_rad) * error.t_m;
    PoseError {
        t_m: along.map(|v| -lambda * v),
        theta_rad: -lambda * error.theta_rad,
    }
}

/// The motion of the optics, in stage axes, that carries out `velocity` for one iteration: Eq. (5) backwards. Without a
/// rotation centre the view only shifts.
pub fn motion_of(velocity: &PoseError, calibration: &Calibration) -> Motion2 {
    let stage_from_camera = calibration.stage_from_camera();
    let shift_m = stage_from_camera * velocity.t_m;
    let Some(eta) = calibration.rotation_centre_m else {
        return Motion2 {
            alpha_rad: 0.0,
            d_m: shift_m,
        };
    };
    // A reflection between camera and stage turns the other way round (theta_c = -theta_e).
    let alpha_rad = velocity.theta_rad * stage_from_camera.det().signum();
    let turned = Mat2::rotation(alpha_rad) * eta;
    Motion2 {
        alpha_rad,
        d_m: [
            shift_m[0] + eta[0] - turned[0],
            shift_m[1] + eta[1] - turned[1],
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CALIBRATION_SCHEMA;
    use scopeservo_geometry::Similarity;
    use scopeservo_scope::ObjectiveId;

    fn calibration(stage_from_pixel: Mat2) -> Calibration {
        Calibration {
            schema: CALIBRATION_SCHEMA,
            objective: ObjectiveId("x".into()),
            image_size_px: [640, 480],
            stage_from_pixel,
            rotation_centre_m: Some([0.125, 0.001]),
            covariance: None,
        }
    }

    fn paper() -> Calibration {
        let (s, c) = 0.01f64.sin_cos();
        let r_ec = Mat2([[-s, -c], [-c, s]]);
        calibration(r_ec * Mat2::diagonal(-1.0 / 1_953_155.0, -1.0 / 1_981_235.0))
    }

    /// J_t of a view whose camera stands at `pose` in the target's camera frame: `K_t H K^-1` about the centres.
    fn image_transform(pose: &PoseError, view: &Calibration, target: &Calibration) -> Affine2 {
        let h = Affine2::from(Similarity {
            scale: 1.0,
            angle_rad: pose.theta_rad,
            offset: pose.t_m,
        });
        Affine2 {
            linear: target.intrinsic().unwrap()
                * h.linear
                * view.intrinsic().unwrap().inverse().unwrap(),
            offset: target.intrinsic().unwrap() * h.offset,
        }
    }

    #[test]
    fn the_error_is_the_pose_that_made_the_image() {
        let pose = PoseError {
            t_m: [30e-6, -80e-6],
            theta_rad: 0.05,
        };
        for view in [paper(), calibration(Mat2::rotation(0.4) * 5e-7)] {
            let j = image_transform(&pose, &view, &view);
            let e = pose_error(&j, &view, &view, [0.0; 2], [0.0; 2]).unwrap();
            assert!((e.t_m[0] - pose.t_m[0]).abs() < 1e-15);
            assert!((e.t_m[1] - pose.t_m[1]).abs() < 1e-15);
            assert!((e.theta_rad - pose.theta_rad).abs() < 1e-12);
        }
    }

    #[test]
    fn one_step_of_the_law_leaves_one_minus_lambda_of_the_error() {
        let e = PoseError {
            t_m: [300e-6, -200e-6],
            theta_rad: 0.1,
        };
        let v = control_law(&e, 0.2);
        let moved = Mat2::rotation(e.theta_rad) * v.t_m;
        for (t, m) in e.t_m.iter().zip(moved) {
            assert!((t + m - 0.8 * t).abs() < 1e-18);
        }
        assert!((e.theta_rad + v.theta_rad - 0.8 * e.theta_rad).abs() < 1e-15);
    }

    #[test]
    fn the_motion_turns_about_the_views_centre() {
        // A pure turn of the camera leaves the stage point under the image centre, eta, in place.
        let c = paper();
        let v = PoseError {
            t_m: [0.0; 2],
            theta_rad: 0.03,
        };
        let m = motion_of(&v, &c);
        let eta = c.rotation_centre_m.unwrap();
        let moved = Mat2::rotation(m.alpha_rad) * eta;
        assert!((moved[0] + m.d_m[0] - eta[0]).abs() < 1e-15);
        assert!((moved[1] + m.d_m[1] - eta[1]).abs() < 1e-15);
        assert!((m.alpha_rad + 0.03).abs() < 1e-15, "theta_c = -theta_e");
    }
}

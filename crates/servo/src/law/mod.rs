//! Control: pose error to velocity, and the velocity as a motion of the stage. A law is one file here, or anything that implements
//! [`ControlLaw`].

mod direct;
mod proportional;

use crate::{Calibration, Motion2, PoseError, PoseEstimate};
use scopeservo_geometry::{Mat2, Vec2};
use serde::{Deserialize, Serialize};

pub use direct::Direct;
pub use proportional::{Proportional, control_law};

/// A velocity v_c of {C} in its own axes: metres and radians per iteration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Velocity {
    /// x, y in metres per iteration.
    pub t_m: Vec2,
    /// Rotation in radians per iteration.
    pub theta_rad: f64,
}

impl Velocity {
    /// Length of the translation, um per iteration.
    pub fn distance_um(&self) -> f64 {
        f64::hypot(self.t_m[0], self.t_m[1]) * 1e6
    }
    /// Rotation, degrees per iteration.
    pub fn angle_deg(&self) -> f64 {
        self.theta_rad.to_degrees()
    }
    /// The same where the stage `turns`; else without its rotation.
    pub(crate) fn on_stage_that(self, turns: bool) -> Self {
        Self {
            theta_rad: if turns { self.theta_rad } else { 0.0 },
            ..self
        }
    }
}

/// How an error becomes a velocity.
pub trait ControlLaw: Send + Sync {
    /// The velocity for one iteration with the calibration of the active objective. An error, or a calibration, that is known badly may be
    /// answered by less.
    fn velocity(&self, error: &PoseEstimate, view: &Calibration) -> Velocity;
}

/// The motion of the optics, in stage axes, that carries out `velocity` for one iteration: Eq. (5) backwards. Without a
/// rotation centre the view only shifts.
pub fn motion_of(velocity: &Velocity, calibration: &Calibration) -> Motion2 {
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

/// The error that is left of one after a motion of the optics: [`motion_of`] backwards, and the step that its velocity makes.
pub(crate) fn error_after(
    error: &PoseError,
    motion: &Motion2,
    calibration: &Calibration,
) -> PoseError {
    let stage_from_camera = calibration.stage_from_camera();
    let eta = calibration.rotation_centre_m.unwrap_or_default();
    let turned = Mat2::rotation(motion.alpha_rad) * eta;
    let shift_m = [0, 1].map(|k| motion.d_m[k] - eta[k] + turned[k]);
    let along = Mat2::rotation(error.theta_rad) * (stage_from_camera.transpose() * shift_m);
    PoseError {
        t_m: [error.t_m[0] + along[0], error.t_m[1] + along[1]],
        theta_rad: error.theta_rad + motion.alpha_rad * stage_from_camera.det().signum(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CALIBRATION_SCHEMA;
    use scopeservo_scope::ObjectiveId;

    fn calibration(stage_from_pixel: Mat2) -> Calibration {
        Calibration {
            schema: CALIBRATION_SCHEMA,
            objective: ObjectiveId("x".into()),
            image_size_px: [640, 480],
            stage_from_pixel,
            rotation_centre_m: Some([0.125, 0.001]),
            covariance: None,
            backlash: None,
            scatter: None,
        }
    }

    fn paper() -> Calibration {
        let (s, c) = 0.01f64.sin_cos();
        let r_ec = Mat2([[-s, -c], [-c, s]]);
        calibration(r_ec * Mat2::diagonal(-1.0 / 1_953_155.0, -1.0 / 1_981_235.0))
    }

    #[test]
    fn what_is_left_after_a_motion_is_what_the_law_leaves() {
        let error = PoseError {
            t_m: [300e-6, -200e-6],
            theta_rad: 0.7,
        };
        for calibration in [paper(), calibration(Mat2::rotation(0.4) * 5e-7)] {
            for lambda in [0.2, 1.0] {
                let motion = motion_of(&control_law(&error, lambda), &calibration);
                let left = error_after(&error, &motion, &calibration);
                for k in 0..2 {
                    assert!((left.t_m[k] - (1.0 - lambda) * error.t_m[k]).abs() < 1e-15);
                }
                assert!((left.theta_rad - (1.0 - lambda) * error.theta_rad).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn the_motion_turns_about_the_views_centre() {
        // A pure turn of the camera leaves the stage point under the image centre, eta, in place.
        let c = paper();
        let v = Velocity {
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

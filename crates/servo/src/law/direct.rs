//! The whole way at once, as far as what is known of the calibration supports it.

use super::{ControlLaw, Velocity, control_law};
use crate::{Calibration, PoseEstimate};

/// Where a step may end beside its goal: within this share of the shorter side of the view, by so many standard deviations.
const WITHIN: f64 = 0.25;
const SIGMAS: f64 = 3.0;
/// Of the way that is too far, it is halved so often at most: a calibration that knows its own map to 10 % allows a hundred fields.
const HALVINGS: usize = 12;

/// Takes all of the error away in one step, or, where the calibration is not known well enough for that, as much of it as surely leaves the goal
/// in view.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Direct;

impl ControlLaw for Direct {
    fn velocity(&self, estimate: &PoseEstimate, view: &Calibration) -> Velocity {
        let error = &estimate.error;
        let side_m = view.shorter_side_m();
        let lands = |share: f64| {
            let sigma_m = view.move_sigma_m(
                share * f64::hypot(error.t_m[0], error.t_m[1]),
                share * error.theta_rad,
            );
            // What does not know how well it is known is the paper's, or comes from elsewhere: it is taken at its word.
            sigma_m.is_none_or(|sigma_m| SIGMAS * sigma_m <= WITHIN * side_m)
        };
        let mut share = 1.0;
        for _ in 0..HALVINGS {
            if lands(share) {
                break;
            }
            share *= 0.5;
        }
        control_law(error, share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CALIBRATION_SCHEMA, PoseError};
    use scopeservo_geometry::Mat2;
    use scopeservo_scope::ObjectiveId;

    /// 0.5 um a pixel, the map to a share, the rotation centre to so many m.
    fn calibration(share: f64, centre_m: f64) -> Calibration {
        let mut covariance = [[0.0; 6]; 6];
        for (k, row) in covariance.iter_mut().enumerate() {
            row[k] = if k < 4 { share * 5e-7 } else { centre_m }.powi(2);
        }
        Calibration {
            schema: CALIBRATION_SCHEMA,
            objective: ObjectiveId("40x".into()),
            image_size_px: [640, 480],
            stage_from_pixel: Mat2::diagonal(5e-7, 5e-7),
            rotation_centre_m: Some([0.1, 0.0]),
            covariance: Some(covariance),
            backlash: None,
            scatter: Some([1e-7, 1e-7, 1e-6]),
        }
    }

    fn step(t_um: f64, deg: f64, view: &Calibration) -> Velocity {
        let error = PoseError {
            t_m: [t_um * 1e-6, 0.0],
            theta_rad: deg.to_radians(),
        };
        let covariance = [[0.0; 3]; 3];
        Direct.velocity(&PoseEstimate { error, covariance }, view)
    }

    #[test]
    fn what_is_known_is_done_at_once() {
        let good = calibration(2e-4, 1.5e-6);
        let v = step(500.0, 170.0, &good);
        assert!((v.distance_um() - 500.0).abs() < 1e-9 && (v.angle_deg() + 170.0).abs() < 1e-9);
    }

    #[test]
    fn no_step_ends_farther_beside_its_goal_than_the_view_reaches() {
        // Two millimetres of an unknown rotation centre: a turn of half a degree moves the view by 17 um.
        let v = step(10.0, 45.0, &calibration(2e-4, 2e-3));
        assert!(
            (0.2..1.5).contains(&v.angle_deg().abs()),
            "{}",
            v.angle_deg()
        );
        assert!((v.distance_um() / 10.0 - v.angle_deg().abs() / 45.0).abs() < 1e-9);
        // A map that is known to a tenth: 200 um at once, and no millimetre.
        let poor = calibration(0.1, 1e-6);
        assert!((step(150.0, 0.0, &poor).distance_um() - 150.0).abs() < 1e-9);
        assert!(step(1000.0, 0.0, &poor).distance_um() < 300.0);
        // What does not know itself is taken at its word.
        let unknown = Calibration {
            covariance: None,
            ..poor
        };
        assert!((step(1000.0, 0.0, &unknown).distance_um() - 1000.0).abs() < 1e-9);
    }
}

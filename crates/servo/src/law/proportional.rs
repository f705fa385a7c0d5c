//! The paper's law, Eqs. (21) and (22).

use super::{ControlLaw, Velocity};
use crate::{Calibration, PoseError, PoseEstimate};
use scopeservo_geometry::Mat2;

/// Each iteration takes away the share `lambda` of the error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Proportional {
    /// The gain.
    pub lambda: f64,
}

impl ControlLaw for Proportional {
    fn velocity(&self, estimate: &PoseEstimate, _: &Calibration) -> Velocity {
        control_law(&estimate.error, self.lambda)
    }
}

/// `v_c = -lambda L^-1 e` with `L = diag(R(theta), 1)`: translation in the axes of {C}, per iteration.
pub fn control_law(error: &PoseError, lambda: f64) -> Velocity {
    let along = Mat2::rotation(-error.theta_rad) * error.t_m;
    Velocity {
        t_m: along.map(|v| -lambda * v),
        theta_rad: -lambda * error.theta_rad,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}

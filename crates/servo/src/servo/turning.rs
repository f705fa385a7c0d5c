//! Where the stage goes, and which way round its rotation.

use crate::{Calibration, PlanarPose, Velocity, motion_of, pose_after};
use scopeservo_scope::{Axis, AxisRange, Instrument, Kinematics};

/// Where the stage has to go from somewhere to carry out `velocity` for one iteration: Eq. (5).
pub(crate) fn goal(
    (kinematics, turning): (Kinematics, Option<&AxisRange>),
    from: &PlanarPose,
    velocity: &Velocity,
    calibration: &Calibration,
) -> PlanarPose {
    let to = pose_after(kinematics, from, &motion_of(velocity, calibration));
    PlanarPose {
        theta_rad: turned_within(to.theta_rad, turning),
        ..to
    }
}

/// An angle of an axis, or the one a full turn from it, whichever the axis can take: both show the same.
fn turned_within(theta_rad: f64, range: Option<&AxisRange>) -> f64 {
    let Some(range) = range else { return theta_rad };
    let holds = |theta: &f64| (range.min..=range.max).contains(theta);
    let full = std::f64::consts::TAU;
    let all = [theta_rad, theta_rad - full, theta_rad + full];
    all.into_iter().find(holds).unwrap_or(theta_rad)
}

/// Where the rotation may go.
pub(crate) fn turning(scope: &Instrument) -> Option<AxisRange> {
    let mut ranges = scope.gate().ranges().iter();
    ranges.find(|range| range.axis == Axis::Rz).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_turn_more_or_less_is_taken_where_only_that_is_within_the_travel() {
        let of = |max: f64| AxisRange {
            axis: Axis::Rz,
            min: -max.to_radians(),
            max: max.to_radians(),
        };
        let within = |deg: f64, max: f64| {
            let theta = turned_within(deg.to_radians(), Some(&of(max)));
            theta.to_degrees().round()
        };
        assert_eq!(within(170.0, 180.0), 170.0);
        assert_eq!(within(200.0, 180.0), -160.0);
        assert_eq!(within(-200.0, 180.0), 160.0);
        // Neither is: the nearer one is told.
        assert_eq!(within(180.0, 21.0), 180.0);
        assert_eq!(within(350.0, 21.0), -10.0);
    }
}

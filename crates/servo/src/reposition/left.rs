//! The angle that a stage leaves which does not turn, and how much of the target is in view all the same.

use crate::{Calibration, PoseError, ServoResult};
use scopeservo_geometry::{Mat2, Vec2};

/// The middle half of the target's area must be in view, but for this share of it.
const MIDDLE: f64 = 0.5;
const ALL: f64 = 0.99;

/// What is left when the place is back.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Left {
    /// The angle, degrees.
    pub(crate) angle_deg: f64,
    /// Share of the target's area that is in view.
    pub(crate) in_view: f64,
    /// Whether that is no arrival.
    pub(crate) is_too_much: bool,
}

impl Left {
    /// Of a target of a size; `within_deg`: what a user allows, else the middle half of the target must be in view.
    pub(crate) fn of(
        result: &ServoResult,
        target_um: [f64; 2],
        view: &Calibration,
        within_deg: Option<f64>,
    ) -> Self {
        let angle_deg = result.error.angle_deg().abs();
        let view_um = view.image_size_px.map(|px| px as f64 * view.um_per_px());
        let share = |of_area: f64, error: &PoseError| {
            let size = target_um.map(|side| side * of_area.sqrt());
            share_in_view(error, size, view_um)
        };
        let surely_deg = angle_deg + 2.0 * result.sigma_deg;
        // A view that is smaller than the target shows no more of it unturned.
        let straight = PoseError {
            theta_rad: 0.0,
            ..result.error
        };
        Self {
            angle_deg,
            in_view: share(1.0, &result.error),
            is_too_much: match within_deg {
                Some(within_deg) => surely_deg > within_deg,
                None => share(MIDDLE, &result.error) < ALL * share(MIDDLE, &straight),
            },
        }
    }
}

/// Share of a rectangle about the target's middle that a view shows whose camera stands off by `error`.
fn share_in_view(error: &PoseError, [w, h]: [f64; 2], view_um: [f64; 2]) -> f64 {
    // As the camera sees it: a point m of the target is at R(-theta) (m - t).
    let back = Mat2::rotation(-error.theta_rad);
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let mut shape: Vec<Vec2> = corners
        .iter()
        .map(|[x, y]| {
            let t = error.t_um();
            back * [0.5 * w * x - t[0], 0.5 * h * y - t[1]]
        })
        .collect();
    for (axis, side) in view_um.iter().enumerate() {
        for sign in [-1.0, 1.0] {
            shape = cut(&shape, |p| 0.5 * side - sign * p[axis]);
        }
    }
    area(&shape) / (w * h)
}

/// The part of a convex shape where `inside` is not negative.
fn cut(shape: &[Vec2], inside: impl Fn(&Vec2) -> f64) -> Vec<Vec2> {
    let mut kept = Vec::new();
    for (k, a) in shape.iter().enumerate() {
        let b = &shape[(k + 1) % shape.len()];
        let (at_a, at_b) = (inside(a), inside(b));
        if at_a >= 0.0 {
            kept.push(*a);
        }
        if at_a * at_b < 0.0 {
            let s = at_a / (at_a - at_b);
            kept.push([0, 1].map(|n| a[n] + s * (b[n] - a[n])));
        }
    }
    kept
}

fn area(shape: &[Vec2]) -> f64 {
    let cross = |k: usize| {
        let ([x, y], [u, v]) = (shape[k], shape[(k + 1) % shape.len()]);
        x * v - y * u
    };
    0.5 * (0..shape.len()).map(cross).sum::<f64>().abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn share(x_um: f64, y_um: f64, deg: f64, of: [f64; 2]) -> f64 {
        let error = PoseError {
            t_m: [x_um * 1e-6, y_um * 1e-6],
            theta_rad: deg.to_radians(),
        };
        share_in_view(&error, of, [320.0, 240.0])
    }

    #[test]
    fn the_share_in_view_is_what_a_count_of_points_says() {
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        near(share(0.0, 0.0, 0.0, [320.0, 240.0]), 1.0);
        near(share(0.0, 0.0, 180.0, [320.0, 240.0]), 1.0);
        near(share(80.0, 0.0, 0.0, [320.0, 240.0]), 0.75);
        near(share(400.0, 0.0, 0.0, [320.0, 240.0]), 0.0);
        near(share(0.0, 0.0, 90.0, [320.0, 240.0]), 0.75);
        for (x, y, deg) in [(30.0, -50.0, 33.0), (0.0, 0.0, 21.0), (100.0, 80.0, 170.0)] {
            let (sin, cos) = f64::to_radians(deg).sin_cos();
            let n = 400;
            let inside = |k: &usize| {
                let [u, v] = [k % n, k / n].map(|i| (i as f64 + 0.5) / n as f64 - 0.5);
                let [u, v] = [320.0 * u - x, 240.0 * v - y];
                (cos * u + sin * v).abs() <= 160.0 && (cos * v - sin * u).abs() <= 120.0
            };
            let counted = (0..n * n).filter(inside).count() as f64 / (n * n) as f64;
            let share = share(x, y, deg, [320.0, 240.0]);
            assert!((share - counted).abs() < 0.005, "{share} {counted}");
        }
    }

    #[test]
    fn the_middle_half_of_the_area_is_in_a_four_to_three_view_up_to_twenty_one_degrees() {
        let middle = [320.0, 240.0].map(|side: f64| side * MIDDLE.sqrt());
        assert!(share(0.0, 0.0, 21.0, middle) > 1.0 - 1e-9);
        assert!(share(0.0, 0.0, 35.0, middle) < ALL);
        assert!(share(0.0, 0.0, 55.0, middle) < ALL);
        assert!(share(0.0, 0.0, 178.0, middle) > 1.0 - 1e-9);
    }

    /// Left by a view of 320 um with an angle known to `sigma_deg`, of a target of a width.
    fn left(deg: f64, sigma_deg: f64, target_um: f64, within_deg: Option<f64>) -> Left {
        let view = Calibration {
            schema: crate::CALIBRATION_SCHEMA,
            objective: scopeservo_scope::ObjectiveId("40x".into()),
            image_size_px: [640, 480],
            stage_from_pixel: Mat2::diagonal(0.5e-6, 0.5e-6),
            rotation_centre_m: None,
            covariance: None,
            backlash: None,
            scatter: None,
        };
        let result = ServoResult {
            iterations: 2,
            inliers: 50,
            error: PoseError {
                t_m: [0.0; 2],
                theta_rad: deg.to_radians(),
            },
            sigma_um: 0.01,
            sigma_deg,
            limited_by: None,
            angle_is_left: true,
        };
        Left::of(&result, [target_um, 0.75 * target_um], &view, within_deg)
    }

    /// An angle is claimed to be within what was asked only where it surely is.
    #[test]
    fn an_angle_that_may_be_more_than_what_was_asked_is_too_much() {
        for (deg, sigma_deg, too_much) in [
            (0.25, 0.1, true),
            (0.09, 0.02, true),
            (0.05, 0.02, false),
            (-0.2, 0.001, true),
            (-0.05, 0.001, false),
        ] {
            let told = left(deg, sigma_deg, 320.0, Some(0.1));
            assert_eq!(told.is_too_much, too_much, "{deg} {sigma_deg}");
        }
    }

    /// A target that was saved by a camera that sees more is no more turned for it.
    #[test]
    fn a_view_that_is_smaller_than_the_target_shows_all_that_it_can() {
        for target_um in [100.0, 320.0, 500.0, 900.0] {
            assert!(
                !left(0.0, 0.001, target_um, None).is_too_much,
                "{target_um}"
            );
            assert!(
                !left(180.0, 0.001, target_um, None).is_too_much,
                "{target_um}"
            );
        }
        assert!((left(0.0, 0.001, 640.0, None).in_view - 0.25).abs() < 1e-9);
        assert!(left(40.0, 0.001, 320.0, None).is_too_much);
        assert!(left(40.0, 0.001, 500.0, None).is_too_much);
    }
}

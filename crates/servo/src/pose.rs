//! Homography to pose error: the paper's Algorithm 1, lines 13 and 14, Eqs. (7), (19) and (20).

use crate::Calibration;
use scopeservo_geometry::{Affine2, Mat2, Vec2};
use scopeservo_registration::Estimate;
use serde::{Deserialize, Serialize};

/// The error e: a pose of {C} in {C*}, in the plane.
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

    /// The mean of some, which lie near to each other: at half a turn as well, where their angles have either sign.
    pub(crate) fn mean(all: impl ExactSizeIterator<Item = Self> + Clone) -> Self {
        let n = all.len().max(1) as f64;
        let first_rad = all.clone().next().map_or(0.0, |e| e.theta_rad);
        let sum = |f: &dyn Fn(&Self) -> f64| all.clone().map(|e| f(&e)).sum::<f64>() / n;
        Self {
            t_m: [sum(&|e| e.t_m[0]), sum(&|e| e.t_m[1])],
            theta_rad: wrapped(first_rad + sum(&|e| wrapped(e.theta_rad - first_rad))),
        }
    }
}

/// An angle within half a turn of none.
pub(crate) fn wrapped(angle_rad: f64) -> f64 {
    let turns = (angle_rad / std::f64::consts::TAU).round();
    angle_rad - turns * std::f64::consts::TAU
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

/// The angle of a `target_from_view` (radians) whose error has the rotation `theta_rad`: [`pose_error`] backwards.
pub(crate) fn image_angle(theta_rad: f64, view: &Calibration, target: &Calibration) -> Option<f64> {
    let linear = target.intrinsic()? * Mat2::rotation(theta_rad) * view.intrinsic()?.inverse()?;
    linear.rotation_angle()
}

/// An error and how well it is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseEstimate {
    /// The error.
    pub error: PoseError,
    /// Covariance of x, y (m) and theta (rad) by the registration; both calibrations are taken for exact.
    pub covariance: [[f64; 3]; 3],
}

impl PoseEstimate {
    /// Standard deviations of x, y (m) and theta (rad).
    pub fn sigma(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| self.covariance[k][k].max(0.0).sqrt())
    }
}

/// [`pose_error`] with its covariance, from that of the transform.
pub fn pose_estimate(
    estimate: &Estimate,
    view: &Calibration,
    target: &Calibration,
    view_centre_px: Vec2,
    target_centre_px: Vec2,
) -> Option<PoseEstimate> {
    let j_t = &estimate.target_from_view;
    let error = pose_error(j_t, view, target, view_centre_px, target_centre_px)?;
    let by = derivative(j_t, view, target, view_centre_px)?;
    let c = &estimate.covariance;
    let all = || (0..6).flat_map(|i| (0..6).map(move |j| (i, j)));
    let entry = |r: usize, s: usize| all().map(|(i, j)| by[r][i] * c[i][j] * by[s][j]).sum();
    let covariance = [0, 1, 2].map(|r| [0, 1, 2].map(|s| entry(r, s)));
    Some(PoseEstimate { error, covariance })
}

/// The derivative of x, y and theta by the six numbers of the transform, row by row.
fn derivative(
    target_from_view: &Affine2,
    view: &Calibration,
    target: &Calibration,
    [x, y]: Vec2,
) -> Option<[[f64; 6]; 3]> {
    let (k, k_t_inverse) = (view.intrinsic()?, target.intrinsic()?.inverse()?);
    let Mat2([[a, b], [c, d]]) = k_t_inverse * target_from_view.linear * k;
    let (cosine, sine) = (a + d, c - b);
    let length_sq = cosine * cosine + sine * sine;
    let mut by = [[0.0; 6]; 3];
    for (n, (row, column)) in [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)]
        .into_iter()
        .enumerate()
    {
        // J_t times the centre, plus its offset.
        let mut moved = [0.0; 2];
        moved[row] = [x, y, 1.0][column];
        [by[0][n], by[1][n]] = k_t_inverse * moved;
        if column < 2 {
            let mut unit = Mat2([[0.0; 2]; 2]);
            unit.0[row][column] = 1.0;
            let Mat2([[a, b], [c, d]]) = k_t_inverse * unit * k;
            // theta is the angle of (cosine, sine).
            by[2][n] = (cosine * (c - b) - sine * (a + d)) / length_sq;
        }
    }
    Some(by)
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
            backlash: None,
            scatter: None,
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
            let angle = image_angle(pose.theta_rad, &view, &view).unwrap();
            assert!((angle - j.linear.rotation_angle().unwrap()).abs() < 1e-12);
        }
    }

    #[test]
    fn the_covariance_is_that_of_the_transform_carried_on() {
        let (view, target) = (calibration(Mat2::rotation(0.4) * 1e-6), paper());
        let pose = PoseError {
            t_m: [30e-6, -80e-6],
            theta_rad: 0.05,
        };
        let centre = [319.5, 239.5];
        let about = image_transform(&pose, &view, &target);
        let j_t = Affine2 {
            linear: about.linear,
            offset: {
                let moved = about.linear * centre;
                [0, 1].map(|k| about.offset[k] + centre[k] - moved[k])
            },
        };
        let of = |j: &Affine2| pose_error(j, &view, &target, centre, centre).unwrap();
        let by = derivative(&j_t, &view, &target, centre).unwrap();
        for n in 0..6 {
            let step = if n % 3 == 2 { 1e-2 } else { 1e-5 };
            let moved = |sign: f64| {
                let mut j = j_t;
                match n % 3 {
                    2 => j.offset[n / 3] += sign * step,
                    column => j.linear.0[n / 3][column] += sign * step,
                }
                of(&j)
            };
            let (after, before) = (moved(1.0), moved(-1.0));
            let numeric = [
                after.t_m[0] - before.t_m[0],
                after.t_m[1] - before.t_m[1],
                after.theta_rad - before.theta_rad,
            ]
            .map(|d| d / (2.0 * step));
            for k in 0..3 {
                let scale = by[k].iter().fold(0.0f64, |a, b| a.max(b.abs()));
                assert!((numeric[k] - by[k][n]).abs() < 1e-6 * scale, "{k} {n}");
            }
        }
        let mut estimate = Estimate::at_rest();
        estimate.target_from_view = j_t;
        (estimate.covariance[2][2], estimate.covariance[5][5]) = (0.01, 0.01);
        let known = pose_estimate(&estimate, &view, &target, centre, centre).unwrap();
        assert_eq!(known.error, of(&j_t));
        // A tenth of a pixel of the target.
        assert!((known.sigma()[0] - 0.1 / 1_953_155.0).abs() < 1e-12);
        assert_eq!(known.sigma()[2], 0.0);
    }
}

//! What no calibration can be: a file that was edited by hand, or damaged, is refused before anything is moved by it.

use crate::Calibration;
use scopeservo_geometry::Cholesky;
use scopeservo_scope::{Axis, AxisRange};

/// No microscope has its axis of rotation farther away, m.
const FARTHEST_M: f64 = 1.0;
/// No pixel on a specimen is smaller or larger, um.
const PIXEL_UM: [f64; 2] = [1e-4, 1e3];
/// No calibration turns by less, rad: a twentieth of a degree.
const LEAST_TURN_RAD: f64 = 0.05 * std::f64::consts::PI / 180.0;
/// A covariance may be off by so much of its diagonal, for rounding.
const ROUNDING: f64 = 1e-9;

impl Calibration {
    /// What of it is physically impossible, in words; `None` of one that can be.
    pub fn impossible(&self) -> Option<String> {
        let mut numbers = self.stage_from_pixel.0.into_iter().flatten();
        let size_um = self.um_per_px();
        let svd = self.stage_from_pixel.svd();
        if !numbers.all(f64::is_finite) || svd.s[1] <= 1e-6 * svd.s[0] {
            return Some("its map from pixels to the stage has no inverse".into());
        }
        if !(PIXEL_UM[0]..=PIXEL_UM[1]).contains(&size_um) {
            return Some(format!("it gives {size_um:e} um per pixel"));
        }
        if let Some([x, y]) = self.rotation_centre_m
            && (x.hypot(y).is_nan() || x.hypot(y) > FARTHEST_M)
        {
            let far = x.hypot(y);
            return Some(match far < 1e3 {
                true => format!("it has the axis of rotation {far:.3} m away"),
                false => format!("it has the axis of rotation {far:e} m away"),
            });
        }
        if self.covariance.is_some_and(|c| !is_covariance(&c)) {
            return Some("its covariance is that of no numbers".into());
        }
        let play = self.backlash.map(|b| [b.x_m, b.y_m, b.rz_rad]);
        let sigmas = self.backlash.map(|b| b.sigma).into_iter();
        let mut sigmas = sigmas.chain(self.scatter).flatten();
        if !sigmas.all(|s| s >= 0.0 && s.is_finite()) {
            return Some("a standard deviation of it is negative or no number".into());
        }
        let mut play = play.into_iter().flatten();
        // Measured play may come out a little below nothing.
        if !play.all(f64::is_finite) {
            return Some("its play is no number".into());
        }
        None
    }
}

impl Calibration {
    /// What of it no stage of this travel can have measured, in words: it would have had to follow the view through a turn farther than it goes.
    /// `None` of one that can be, and where the stage does not turn.
    pub fn out_of_reach(&self, ranges: &[AxisRange]) -> Option<String> {
        let travel = |axis: Axis| {
            let range = ranges.iter().find(|r| r.axis == axis);
            range.map_or(0.0, |r| r.max - r.min)
        };
        let [x, y] = self.rotation_centre_m?;
        let reach_m = travel(Axis::X).hypot(travel(Axis::Y));
        let turns = ranges.iter().any(|r| r.axis == Axis::Rz);
        (turns && x.hypot(y) * LEAST_TURN_RAD > reach_m).then(|| {
            format!(
                "it has the axis of rotation {:.3} mm away, and a stage that goes {:.3} mm follows no turn about that",
                1e3 * x.hypot(y),
                1e3 * reach_m
            )
        })
    }
}

/// Symmetric, with no negative variance of any direction; numbers that are known for sure have zeros.
fn is_covariance(c: &[[f64; 6]; 6]) -> bool {
    let open: Vec<usize> = (0..6).filter(|&k| c[k][k] != 0.0).collect();
    let size = |i: usize, j: usize| (c[i][i] * c[j][j]).sqrt();
    let pairs = || (0..6).flat_map(|i| (0..6).map(move |j| (i, j)));
    let symmetric = pairs().all(|(i, j)| (c[i][j] - c[j][i]).abs() <= ROUNDING * size(i, j));
    let n = open.len();
    let scaled: Vec<f64> = (0..n * n)
        .map(|k| {
            let (i, j) = (open[k / n], open[k % n]);
            c[i][j] / size(i, j) + if i == j { ROUNDING } else { 0.0 }
        })
        .collect();
    symmetric && (n == 0 || Cholesky::of(&scaled, n).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Backlash, CALIBRATION_SCHEMA};
    use scopeservo_geometry::Mat2;
    use scopeservo_scope::ObjectiveId;

    #[test]
    fn an_axis_that_the_stage_could_not_have_turned_about_is_named() {
        let about = |x: f64| Calibration {
            schema: CALIBRATION_SCHEMA,
            objective: ObjectiveId("40x".into()),
            image_size_px: [640, 480],
            stage_from_pixel: Mat2([[5e-7, 0.0], [0.0, -5e-7]]),
            rotation_centre_m: Some([x, 0.0]),
            covariance: None,
            backlash: None,
            scatter: None,
        };
        let range = |axis, half: f64| AxisRange {
            axis,
            min: -half,
            max: half,
        };
        let stage = |half_m: f64| {
            let across = [Axis::X, Axis::Y].map(|axis| range(axis, half_m));
            [across[0], across[1], range(Axis::Rz, 0.2)]
        };
        // A hexapod turns about an axis far outside of its travel, a small stage about none.
        assert_eq!(about(0.125).out_of_reach(&stage(0.017)), None);
        assert_eq!(about(0.9).out_of_reach(&stage(0.017)), None);
        for (centre_m, half_m) in [(0.9, 1e-4), (0.125, 2e-5), (-0.5, 1e-5)] {
            let said = about(centre_m).out_of_reach(&stage(half_m)).unwrap();
            assert!(said.contains("follows no turn"), "{said}");
        }
        // What does not turn has none, whatever the file says.
        assert_eq!(about(0.9).out_of_reach(&stage(1e-4)[..2]), None);
    }

    #[test]
    fn what_no_calibration_can_be_is_named() {
        let mut covariance = [[0.0; 6]; 6];
        for (k, row) in covariance.iter_mut().enumerate() {
            row[k] = if k < 4 { 1e-20 } else { 1e-10 };
        }
        covariance[0][1] = 5e-21;
        covariance[1][0] = 5e-21;
        let sound = Calibration {
            schema: CALIBRATION_SCHEMA,
            objective: ObjectiveId("40x".into()),
            image_size_px: [640, 480],
            stage_from_pixel: Mat2([[5e-7, 0.0], [0.0, -5e-7]]),
            rotation_centre_m: Some([0.125, 0.0]),
            covariance: Some(covariance),
            backlash: Some(Backlash {
                x_m: 1e-6,
                y_m: -1e-8,
                rz_rad: 0.0,
                sigma: [1e-7, 1e-7, 0.0],
            }),
            scatter: Some([1e-7, 1e-7, 1e-6]),
        };
        assert_eq!(sound.impossible(), None);
        type Wrong = (&'static str, fn(&mut Calibration));
        let wrong: [Wrong; 10] = [
            ("no inverse", |c| {
                c.stage_from_pixel = Mat2([[1e-7, 2e-7], [2e-7, 4e-7]])
            }),
            ("no inverse", |c| c.stage_from_pixel.0[0][0] = f64::NAN),
            ("no inverse", |c| {
                c.stage_from_pixel = Mat2::diagonal(0.0, 0.0)
            }),
            ("um per pixel", |c| {
                c.stage_from_pixel = Mat2::diagonal(5e-1, 5e-1)
            }),
            ("axis of rotation", |c| {
                c.rotation_centre_m = Some([1.5, 0.0])
            }),
            ("axis of rotation", |c| {
                c.rotation_centre_m = Some([f64::NAN, 0.0])
            }),
            ("covariance", |c| {
                c.covariance = c.covariance.map(|c| c.map(|row| row.map(|v| -v)))
            }),
            ("covariance", |c| {
                // As if one were known better by the other than it is known at all.
                c.covariance = c.covariance.map(|mut c| {
                    (c[0][1], c[1][0]) = (2e-20, 2e-20);
                    c
                });
            }),
            ("covariance", |c| {
                c.covariance = c.covariance.map(|mut c| {
                    c[0][1] = -5e-21;
                    c
                });
            }),
            ("standard deviation", |c| {
                c.scatter = Some([1e-7, -1e-7, 0.0])
            }),
        ];
        for (word, break_it) in wrong {
            let mut c = sound.clone();
            break_it(&mut c);
            let said = c.impossible().unwrap();
            assert!(said.contains(word), "{said}");
        }
    }
}

//! What no calibration can be: a file that was edited by hand, or damaged, is refused before anything is moved by it.

use crate::Calibration;
use scopeservo_geometry::Cholesky;

/// No microscope has its axis of rotation farther away, m.
const FARTHEST_M: f64 = 1.0;
/// No pixel on a specimen is smaller or larger, um.
const PIXEL_UM: [f64; 2] = [1e-4, 1e3];
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
            return Some(format!(
                "it has the axis of rotation {:.3} m away",
                x.hypot(y)
            ));
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

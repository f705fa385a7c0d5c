//! A calibration as a value: how pixels of one objective relate to the stage.

use scopeservo_geometry::{Mat2, Vec2};
use scopeservo_scope::ObjectiveId;
use serde::{Deserialize, Serialize};

/// Version of the serialised form.
pub const CALIBRATION_SCHEMA: u32 = 1;

/// The move whose expected error is told of a calibration: m, and rad where the stage turns.
pub const EXAMPLE_MOVE: (f64, f64) = (100e-6, std::f64::consts::PI / 180.0);

/// The map between pixels and stage of one objective, and where the stage turns.
///
/// A pixel p is fixed to the optics at the stage coordinate `c = stage_from_pixel (p - p0) + rotation_centre_m`, with p0 the
/// image's centre ((w-1)/2, (h-1)/2). The general 2x2 map covers mirrored cameras and stages of either handedness.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// [`CALIBRATION_SCHEMA`] of the program that wrote it; reading any other is an error.
    #[serde(deserialize_with = "known_schema")]
    pub schema: u32,
    /// The objective it belongs to.
    pub objective: ObjectiveId,
    /// Columns and rows of the images it was made from.
    pub image_size_px: [usize; 2],
    /// Metres in stage axes per pixel.
    pub stage_from_pixel: Mat2,
    /// Where the image's centre lies from the axis of rotation, in stage axes, metres (the paper's eta). `None` for a
    /// stage that cannot turn.
    pub rotation_centre_m: Option<Vec2>,
    /// Covariance of (stage_from_pixel row-major in m/px, rotation_centre_m in m), when it is known. Without a rotation
    /// centre its rows and columns are zero.
    pub covariance: Option<[[f64; 6]; 6]>,
    /// The play of the stage's axes, where it was measured.
    #[serde(default)]
    pub backlash: Option<Backlash>,
    /// Standard deviations of where arrivals were seen to end: x, y (m), rotation (rad).
    #[serde(default)]
    pub scatter: Option<[f64; 3]>,
}

/// How far an axis stands behind where it says after it has turned round, true values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Backlash {
    /// Of x, m.
    pub x_m: f64,
    /// Of y, m.
    pub y_m: f64,
    /// Of the rotation, rad.
    pub rz_rad: f64,
    /// Standard deviations of the three; zero where there is no such axis.
    pub sigma: [f64; 3],
}

fn known_schema<'de, D: serde::Deserializer<'de>>(from: D) -> Result<u32, D::Error> {
    let schema = u32::deserialize(from)?;
    if schema == CALIBRATION_SCHEMA {
        return Ok(schema);
    }
    Err(serde::de::Error::custom(format!(
        "this calibration has schema {schema} and this version reads {CALIBRATION_SCHEMA}; calibrate again"
    )))
}

/// The paper's reading of the 2x2 map: `c = R_ec(phi) diag(kx, ky)^-1 (p - p0)`, Eqs. (1) and (3).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct IntrinsicReading {
    /// Pixels per metre along image x.
    pub kx_px_per_m: f64,
    /// Pixels per metre along image y.
    pub ky_px_per_m: f64,
    /// Angle between camera and stage, radians.
    pub phi_rad: f64,
    /// What of the map the three numbers do not explain, relative to the whole.
    pub misfit: f64,
}

/// `R_ec` of Eq. (3), upper left: its own inverse, determinant -1.
fn r_ec(phi_rad: f64) -> Mat2 {
    let (s, c) = phi_rad.sin_cos();
    Mat2([[-s, -c], [-c, s]])
}

impl Calibration {
    /// Pixels per metre in stage axes; the inverse of [`Calibration::stage_from_pixel`]. `None` when that is singular, as
    /// only a damaged calibration's is.
    pub fn pixel_from_stage(&self) -> Option<Mat2> {
        self.stage_from_pixel.inverse()
    }

    /// Size of a pixel on the specimen, um: geometric mean of both directions.
    pub fn um_per_px(&self) -> f64 {
        self.stage_from_pixel.det().abs().sqrt() * 1e6
    }

    /// The shorter side of what the camera sees, m on the specimen.
    pub(crate) fn shorter_side_m(&self) -> f64 {
        1e-6 * self.um_per_px() * self.image_size_px[0].min(self.image_size_px[1]) as f64
    }

    /// Standard deviation of a number that is read off the map: `g^T C g`, its gradient g by central differences. `None` where it cannot be
    /// read, or the covariance is not known.
    pub fn sigma_of(&self, number: impl Fn(&Self) -> Option<f64>) -> Option<f64> {
        let covariance = self.covariance?;
        let step = 1e-5 * self.stage_from_pixel.frobenius();
        let mut gradient = [0.0; 4];
        for (k, g) in gradient.iter_mut().enumerate() {
            let at = |sign: f64| {
                let mut moved = self.clone();
                moved.stage_from_pixel.0[k / 2][k % 2] += sign * step;
                number(&moved)
            };
            *g = (at(1.0)? - at(-1.0)?) / (2.0 * step);
        }
        let variance: f64 = (0..16)
            .map(|i| gradient[i / 4] * covariance[i / 4][i % 4] * gradient[i % 4])
            .sum();
        (variance.is_finite() && variance > 0.0).then(|| variance.sqrt())
    }

    /// Standard deviations of where the stage stands beside where it says, x, y (m) and rotation (rad): `stated` ones, or what was seen where
    /// that is more, and the play.
    pub(crate) fn pose_sigma(&self, stated: [f64; 3]) -> [f64; 3] {
        let seen = self.scatter.unwrap_or_default();
        let play = self.backlash.map_or([0.0; 3], |b| [b.x_m, b.y_m, b.rz_rad]);
        // Anywhere within its play is as likely.
        std::array::from_fn(|k| stated[k].max(seen[k]).hypot(play[k] / 12f64.sqrt()))
    }

    /// Covariance, in stage axes (m^2), of where the point that a picture shows `place_px` from its centre comes to lie beside it, after the
    /// one move that is to bring it there and turns the view by `turned_rad`: the stage's scatter at both ends, and what the map and the
    /// rotation centre are uncertain by. `None` where the calibration does not know its own.
    pub fn move_covariance_m2(&self, place_px: Vec2, turned_rad: f64) -> Option<Mat2> {
        let (covariance, [x, y, turn]) = (self.covariance?, self.scatter?);
        let [a, b] = self.rotation_centre_m.unwrap_or_default();
        // The view goes by dM p - (R - 1) d eta, with what is off; and by J eta of a turn.
        let (sin, cos) = turned_rad.sin_cos();
        let jacobian = [
            [place_px[0], place_px[1], 0.0, 0.0, 1.0 - cos, sin],
            [0.0, 0.0, place_px[0], place_px[1], -sin, 1.0 - cos],
        ];
        let scatter = Mat2([[x * x, 0.0], [0.0, y * y]])
            + Mat2([[b * b, -a * b], [-a * b, a * a]]) * (turn * turn);
        let of = |r: usize, c: usize| -> f64 {
            let known =
                (0..36).map(|k| jacobian[r][k / 6] * covariance[k / 6][k % 6] * jacobian[c][k % 6]);
            2.0 * scatter.0[r][c] + known.sum::<f64>()
        };
        Some(Mat2([[of(0, 0), of(0, 1)], [of(1, 0), of(1, 1)]]))
    }

    /// Standard deviation, per coordinate, of where the view ends after one move of such a length that a picture told, whatever its direction,
    /// m; see [`Calibration::move_covariance_m2`].
    pub fn move_sigma_m(&self, moved_m: f64, turned_rad: f64) -> Option<f64> {
        let length_px = moved_m * 1e6 / self.um_per_px();
        let along = [[length_px, 0.0], [0.0, length_px]];
        let variances = along.map(|place_px| {
            let Mat2([[xx, _], [_, yy]]) = self.move_covariance_m2(place_px, turned_rad)?;
            Some(xx + yy)
        });
        Some(((variances[0]? + variances[1]?) / 4.0).sqrt())
    }

    /// How far [`EXAMPLE_MOVE`] is expected to end from where it should: the standard deviation of the distance, um. `None` where the calibration
    /// does not know its own.
    pub fn expected_error_um(&self) -> Option<f64> {
        let (moved_m, turned_rad) = EXAMPLE_MOVE;
        let turned_rad = self.rotation_centre_m.map_or(0.0, |_| turned_rad);
        let sigma_m = self.move_sigma_m(moved_m, turned_rad)?;
        Some(2f64.sqrt() * sigma_m * 1e6)
    }

    /// The same axes with pixels of another size, um: another camera at the same objective.
    pub(crate) fn with_um_per_px(self, um_per_px: f64) -> Self {
        let factor = um_per_px / self.um_per_px();
        Self {
            stage_from_pixel: Mat2(self.stage_from_pixel.0.map(|row| row.map(|v| v * factor))),
            covariance: None,
            ..self
        }
    }

    /// kx, ky and phi when the map has the handedness of Eq. (3); `None` for a mirrored camera or an opposite stage,
    /// which no values of these three describe.
    ///
    /// Solves (16) in closed form. V of (13) is the transpose of [`Calibration::pixel_from_stage`].
    pub fn reading(&self) -> Option<IntrinsicReading> {
        let v = self.pixel_from_stage()?.transpose();
        if v.det() >= 0.0 {
            return None;
        }
        let [[v11, v12], [v21, v22]] = v.0;
        let phi_rad = 0.5
            * f64::atan2(
                2.0 * (v11 * v21 - v12 * v22),
                v21 * v21 + v12 * v12 - v11 * v11 - v22 * v22,
            );
        let (s, c) = phi_rad.sin_cos();
        let (kx, ky) = (-(v11 * s + v21 * c), -(v12 * c - v22 * s));
        let model = Mat2([[-kx * s, -ky * c], [-kx * c, ky * s]]);
        Some(IntrinsicReading {
            kx_px_per_m: kx,
            ky_px_per_m: ky,
            phi_rad,
            misfit: (v - model).frobenius() / v.frobenius(),
        })
    }

    /// The orthogonal matrix that turns camera axes {C} into stage axes {E}: the paper's `R_ec` where the reading
    /// allows it, else the orthogonal matrix nearest to the map.
    pub fn stage_from_camera(&self) -> Mat2 {
        match self.reading() {
            Some(reading) => r_ec(reading.phi_rad),
            None => self.stage_from_pixel.nearest_orthogonal(),
        }
    }

    /// K of Eq. (1) as a general 2x2 matrix about the principal point: pixels per metre in camera axes. `None` as in
    /// [`Calibration::pixel_from_stage`].
    pub fn intrinsic(&self) -> Option<Mat2> {
        Some(self.pixel_from_stage()? * self.stage_from_camera())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn calibration(stage_from_pixel: Mat2) -> Calibration {
        Calibration {
            schema: CALIBRATION_SCHEMA,
            objective: ObjectiveId("40x".into()),
            image_size_px: [640, 480],
            stage_from_pixel,
            rotation_centre_m: Some([0.125, 0.0]),
            covariance: None,
            backlash: None,
            scatter: None,
        }
    }

    #[test]
    fn one_of_an_earlier_build_still_opens() {
        let whole = calibration(Mat2([[1e-6, 0.0], [0.0, 1e-6]]));
        let mut kept = serde_json::to_value(&whole).unwrap();
        // Fields that were there, and never held anything that was read.
        kept["backlash_m"] = serde_json::Value::Null;
        kept["parcentric_offset_m"] = serde_json::Value::Null;
        kept["parfocal_offset_m"] = 1.25e-5.into();
        assert_eq!(serde_json::from_value::<Calibration>(kept).unwrap(), whole);
    }

    #[test]
    fn the_papers_values_are_read_back() {
        for (kx, ky, phi_deg) in [
            (-448_672.0, -451_767.0, 0.4665f64),
            (-1_953_155.0, -1_981_235.0, 0.5722),
            (-938_325.0, -942_616.0, -67.0),
        ] {
            let map = r_ec(phi_deg.to_radians()) * Mat2::diagonal(1.0 / kx, 1.0 / ky);
            let c = calibration(map);
            let r = c.reading().unwrap();
            assert!((r.kx_px_per_m / kx - 1.0).abs() < 1e-12);
            assert!((r.ky_px_per_m / ky - 1.0).abs() < 1e-12);
            assert!((r.phi_rad.to_degrees() - phi_deg).abs() < 1e-10);
            assert!(r.misfit < 1e-12);
            let k = c.intrinsic().unwrap();
            assert!((k - Mat2::diagonal(kx, ky)).frobenius() < 1e-6);
        }
    }

    #[test]
    fn r_ec_is_its_own_inverse_and_mirrors() {
        let r = r_ec(0.3);
        let (s, c) = 0.3f64.sin_cos();
        assert_eq!(r, Mat2([[-s, -c], [-c, s]]));
        assert!((r * r - Mat2::IDENTITY).frobenius() < 1e-15);
        assert!((r.det() + 1.0).abs() < 1e-15);
    }

    #[test]
    fn a_mirrored_camera_has_no_reading_but_a_sound_intrinsic() {
        let map = Mat2::rotation(0.2) * Mat2::diagonal(5e-7, 5.1e-7);
        let c = calibration(map);
        assert_eq!(c.reading(), None);
        assert!(
            (c.stage_from_camera() * c.intrinsic().unwrap().inverse().unwrap() - map).frobenius()
                < 1e-18
        );
        assert!((c.um_per_px() - 0.505).abs() < 1e-3);
    }

    #[test]
    fn another_schema_is_refused_and_a_singular_map_is_none() {
        let mut c = calibration(Mat2([[1e-7, 2e-7], [2e-7, 4e-7]]));
        assert_eq!(
            (c.pixel_from_stage(), c.reading(), c.intrinsic()),
            (None, None, None)
        );
        c.schema += 1;
        let json = serde_json::to_string(&c).unwrap();
        let refused = serde_json::from_str::<Calibration>(&json).unwrap_err();
        assert!(refused.to_string().contains("calibrate again"), "{refused}");
    }

    #[test]
    fn what_a_move_is_expected_to_miss_by_is_scatter_map_and_rotation_centre() {
        let mut c = calibration(Mat2([[5e-7, 0.0], [0.0, 5e-7]]));
        assert_eq!(c.move_sigma_m(1e-4, 0.01), None);
        let mut covariance = [[0.0; 6]; 6];
        // 1 % of a pixel's size in every number of the map, 10 um of the centre.
        for (k, row) in covariance.iter_mut().enumerate() {
            row[k] = if k < 4 {
                5e-9f64.powi(2)
            } else {
                1e-5f64.powi(2)
            };
        }
        (c.covariance, c.scatter) = (Some(covariance), Some([1e-7, 1e-7, 0.0]));
        let near = |a: Option<f64>, b: f64| assert!((a.unwrap() / b - 1.0).abs() < 1e-9, "{a:?}");
        // Both ends of a move scatter.
        let scatter_m = 2f64.sqrt() * 1e-7;
        near(c.move_sigma_m(0.0, 0.0), scatter_m);
        // A chord of 0.1 rad.
        let chord = 2.0 * 0.05f64.sin();
        near(c.move_sigma_m(0.0, 0.1), scatter_m.hypot(1e-5 * chord));
        near(c.move_sigma_m(1e-4, 0.0), scatter_m.hypot(1e-6));
        c.scatter = Some([0.0, 0.0, 1e-6]);
        near(c.move_sigma_m(0.0, 0.0), 0.125e-6);
        // A turn about a centre 125 mm along x moves the view along y.
        let covariance = c.move_covariance_m2([0.0, 0.0], 0.0).unwrap();
        assert_eq!((covariance.0[0][0], covariance.0[0][1]), (0.0, 0.0));
    }

    #[test]
    fn json_round_trip() {
        let c = calibration(Mat2([[1e-7, 2e-7], [3e-7, -4.123456789e-7]]));
        let json = serde_json::to_string(&c).unwrap();
        assert_eq!(serde_json::from_str::<Calibration>(&json).unwrap(), c);
    }
}

//! The numbers of a map from pixels to the stage, of a calibration and of a grid alike.

use super::report::Known;
use crate::Calibration;
use scopeservo_geometry::Mat2;
use serde::{Deserialize, Serialize};

/// A number that a calibration and a grid both tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// kx, pixels per metre.
    KxPxPerM,
    /// ky, pixels per metre.
    KyPxPerM,
    /// phi, degrees.
    PhiDeg,
    /// Size of a pixel along image x, um.
    XUmPerPx,
    /// Along image y.
    YUmPerPx,
    /// Direction of image x in the stage's axes, degrees.
    ImageXDeg,
    /// The angle between image x and y less a right one, degrees.
    SkewDeg,
    /// Where the image's centre lies from the axis of rotation along x, um.
    CentreXUm,
    /// And along y.
    CentreYUm,
}

impl Quantity {
    /// Whether values that differ by a whole turn are the same.
    pub(super) fn is_angle(self) -> bool {
        matches!(self, Self::ImageXDeg)
    }

    fn of(self, c: &Calibration) -> Option<f64> {
        let map = &c.stage_from_pixel;
        let centre = |k: usize| c.rotation_centre_m.map(|m| 1e6 * m[k]);
        match self {
            Self::KxPxPerM => Some(c.reading()?.kx_px_per_m),
            Self::KyPxPerM => Some(c.reading()?.ky_px_per_m),
            Self::PhiDeg => Some(c.reading()?.phi_rad.to_degrees()),
            Self::XUmPerPx => Some(1e6 * column(map, 0).0),
            Self::YUmPerPx => Some(1e6 * column(map, 1).0),
            Self::ImageXDeg => Some(column(map, 0).1.to_degrees()),
            Self::SkewDeg => Some(off_square(map).to_degrees()),
            Self::CentreXUm => centre(0),
            Self::CentreYUm => centre(1),
        }
    }

    /// With its standard deviation, 0 when the calibration does not know its own. `None` where there is no such number.
    pub(super) fn known(self, c: &Calibration) -> Option<Known> {
        let value = self.of(c)?;
        let near = |c: &Calibration| {
            let off = self.of(c)? - value;
            Some(if self.is_angle() {
                within_a_turn(off)
            } else {
                off
            })
        };
        let sigma = match (self, c.covariance) {
            (Self::CentreXUm, Some(c)) => Some(1e6 * c[4][4].sqrt()),
            (Self::CentreYUm, Some(c)) => Some(1e6 * c[5][5].sqrt()),
            _ => c.sigma_of(near),
        };
        let sigma = sigma.unwrap_or(0.0);
        Some(Known { value, sigma })
    }
}

/// Length of a column, and its direction.
pub(super) fn column(m: &Mat2, k: usize) -> (f64, f64) {
    let [[a, b], [c, d]] = m.0;
    let [x, y] = [[a, c], [b, d]][k];
    (x.hypot(y), y.atan2(x))
}

/// The angle between the columns less a right one, whichever way round they are.
pub(super) fn off_square(m: &Mat2) -> f64 {
    let turn = column(m, 1).1 - column(m, 0).1;
    turn.sin().atan2(turn.cos()).abs() - std::f64::consts::FRAC_PI_2
}

/// An angle in degrees from -180 to 180.
pub(super) fn within_a_turn(deg: f64) -> f64 {
    deg - 360.0 * (deg / 360.0).round()
}

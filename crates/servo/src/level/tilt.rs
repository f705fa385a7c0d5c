//! A tilt in figures for people.

use super::blocks::BlockHeight;
use super::plane::Plane;
use crate::Known;
use scopeservo_geometry::Mat2;
use scopeservo_scope::{ObjectiveId, PositiveZ};
use serde::{Deserialize, Serialize};

/// A plane as steep as this comes up by chance in one of a hundred level views: chi squared of two unknowns.
const SHOWN: f64 = 9.21;
/// Sharpness falls differently above and below a focus, which stretches a tilt or shrinks it by so much, as a standard deviation.
const STRETCH: f64 = 0.05;
/// Up to this share of the depth of field at the worst corner a view is level.
const LEVEL: f64 = 0.25;

/// How a view is tilted. Heights are those of the stage's z at which a place is sharpest: along a slope upwards z must be larger to have it in focus.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tilt {
    /// Height at the view's middle, um.
    pub z_um: f64,
    /// Slope along image x (to the right) and y (down), um per mm of the specimen.
    pub slope_um_per_mm: [Known; 2],
    /// Covariance of these, (um/mm) squared.
    pub covariance: [[f64; 2]; 2],
    /// The steepest slope as an angle, deg.
    pub angle_deg: Known,
    /// The same along the stage's axes, where a calibration tells how the camera lies in them.
    pub stage: Option<StageTilt>,
    /// How far out of focus the worst corner is when the middle is sharp, um.
    pub corner_um: Known,
    /// Standard deviation of the blocks' heights about the plane, um.
    pub scatter_um: f64,
    /// Share of their variation that the plane explains.
    pub goodness: f64,
    /// Blocks that count.
    pub used: usize,
    /// Whether the data show a tilt: a level view seems as tilted in one case of a hundred.
    pub shown: bool,
}

/// A tilt along the stage's axes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StageTilt {
    /// Slope of the height along x and y, um per mm.
    pub slope_um_per_mm: [Known; 2],
    /// The same as a rotation about x: z rises along y, deg.
    pub about_x_deg: Known,
    /// And about y: z falls along x, deg.
    pub about_y_deg: Known,
}

/// What a sweep says of the tilt of a view.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TiltReport {
    /// The objective.
    pub objective: ObjectiveId,
    /// Width and height of the image, px.
    pub image_size_px: [usize; 2],
    /// Depth of field, um.
    pub depth_of_field_um: f64,
    /// What positive z of the stage does.
    pub positive_z: PositiveZ,
    /// Blocks that the view was divided into.
    pub blocks: usize,
    /// Those with a focus of their own.
    pub heights: Vec<BlockHeight>,
    /// Images that were taken.
    pub frames: usize,
    /// `None` where too few blocks have a focus of their own.
    pub tilt: Option<Tilt>,
}

impl TiltReport {
    /// Whether the view is level as far as anybody can see: the data show no tilt, or one that costs less than a quarter of the depth of field.
    /// `None` where it was not seen.
    pub fn is_level(&self) -> Option<bool> {
        let tilt = self.tilt.as_ref()?;
        Some(!tilt.shown || tilt.corner_um.value <= LEVEL * self.depth_of_field_um)
    }
}

/// How an image lies on the specimen.
pub(super) struct Scale {
    /// Half its width and height, px.
    pub(super) half_px: [f64; 2],
    /// Stage coordinates of a pixel, m/px, where they are known.
    pub(super) stage_from_pixel: Option<Mat2>,
    /// The engraved size of a pixel, um.
    pub(super) nominal_um: f64,
}

impl Scale {
    fn um_per_px(&self) -> [f64; 2] {
        self.stage_from_pixel.map_or([self.nominal_um; 2], |m| {
            [0, 1].map(|k| 1e6 * m.0[0][k].hypot(m.0[1][k]))
        })
    }
}

fn known(value: f64, variance: f64) -> Known {
    Known {
        value,
        sigma: variance.max(0.0).sqrt(),
    }
}

/// `a C a^T`.
fn carried(a: &Mat2, c: &Mat2) -> Mat2 {
    *a * *c * a.transpose()
}

pub(super) fn tilt(plane: &Plane, scale: &Scale) -> Tilt {
    let c = [plane.c[1], plane.c[2]];
    let of_half = Mat2([0, 1].map(|i| [0, 1].map(|j| plane.covariance[i + 1][j + 1])));
    let um_per_px = scale.um_per_px();
    let per_mm = [0, 1].map(|k| 1e3 / (scale.half_px[k] * um_per_px[k]));
    let inverse = of_half.inverse();
    // Of no tilt nothing is stretched: whether one is shown the heights alone tell.
    let stretched = |i: usize, j: usize| of_half.0[i][j] + STRETCH * STRETCH * c[i] * c[j];
    let of_half = Mat2([0, 1].map(|i| [0, 1].map(|j| stretched(i, j))));
    let covariance = carried(&Mat2::diagonal(per_mm[0], per_mm[1]), &of_half).0;
    let slope = [0, 1].map(|k| c[k] * per_mm[k]);
    let steepest = slope[0].hypot(slope[1]);
    let along = match steepest > 0.0 {
        true => slope.map(|s| s / steepest),
        false => [1.0, 0.0],
    };
    let quadratic = |m: &[[f64; 2]; 2], v: [f64; 2]| -> f64 {
        (0..2)
            .map(|i| (0..2).map(|j| v[i] * m[i][j] * v[j]).sum::<f64>())
            .sum()
    };
    let degrees = |um_per_mm: f64| (1e-3 * um_per_mm).atan().to_degrees();
    let stage = scale.stage_from_pixel.and_then(|m| {
        // um per mm along the stage, from um per half-width.
        let half = Mat2::diagonal(1e-3 / scale.half_px[0], 1e-3 / scale.half_px[1]);
        let a = m.inverse()?.transpose() * half;
        let s = [0, 1].map(|i| a.0[i][0] * c[0] + a.0[i][1] * c[1]);
        let v = carried(&a, &of_half).0;
        let angle = |k: usize, sign: f64| Known {
            value: sign * degrees(s[k]),
            sigma: degrees(v[k][k].max(0.0).sqrt()),
        };
        Some(StageTilt {
            slope_um_per_mm: [0, 1].map(|k| known(s[k], v[k][k])),
            about_x_deg: angle(1, 1.0),
            about_y_deg: angle(0, -1.0),
        })
    });
    Tilt {
        z_um: plane.c[0],
        slope_um_per_mm: [0, 1].map(|k| known(slope[k], covariance[k][k])),
        covariance,
        angle_deg: Known {
            value: degrees(steepest),
            sigma: degrees(quadratic(&covariance, along).max(0.0).sqrt()),
        },
        stage,
        corner_um: known(
            c[0].abs() + c[1].abs(),
            quadratic(&of_half.0, c.map(f64::signum)),
        ),
        scatter_um: plane.scatter_um,
        goodness: plane.goodness,
        used: plane.used.iter().filter(|u| **u).count(),
        shown: inverse.is_some_and(|m| quadratic(&m.0, c) >= SHOWN),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(c: [f64; 3], sigma: f64) -> Plane {
        let mut covariance = [[0.0; 3]; 3];
        for (k, row) in covariance.iter_mut().enumerate() {
            row[k] = sigma * sigma;
        }
        Plane {
            c,
            covariance,
            scatter_um: 0.1,
            goodness: 0.9,
            used: vec![true; 9],
        }
    }

    fn scale(stage_from_pixel: Option<Mat2>) -> Scale {
        Scale {
            half_px: [320.0, 240.0],
            stage_from_pixel,
            nominal_um: 0.5,
        }
    }

    #[test]
    fn slopes_are_in_um_per_mm_and_a_corner_is_the_sum_of_both_ways() {
        // 1.6 um over 320 px of 0.5 um is 10 um per mm.
        let told = tilt(&plane([7.0, 1.6, -0.6], 0.1), &scale(None));
        let [x, y] = told.slope_um_per_mm;
        assert!(
            (x.value - 10.0).abs() < 1e-9 && (y.value + 5.0).abs() < 1e-9,
            "{told:?}"
        );
        assert!((x.sigma - 0.625f64.hypot(0.5)).abs() < 1e-9, "{x:?}");
        assert!((told.corner_um.value - 2.2).abs() < 1e-9 && told.shown);
        let sigma = (0.1 * 2f64.sqrt()).hypot(0.05 * 2.2);
        assert!((told.corner_um.sigma - sigma).abs() < 1e-9);
        let degrees = (1e-3 * 125f64.sqrt()).atan().to_degrees();
        assert!((told.angle_deg.value - degrees).abs() < 1e-9);
        assert!(!tilt(&plane([7.0, 0.1, -0.1], 0.1), &scale(None)).shown);
    }

    #[test]
    fn along_the_stage_a_turned_or_mirrored_camera_changes_the_axes_and_not_the_slope() {
        let (um, deg) = (0.5e-6, |known: Known| known.value);
        for (map, expected) in [
            // Image x along stage x, y along stage y.
            (Mat2([[um, 0.0], [0.0, um]]), [10.0, -5.0]),
            // Turned by 90 deg: image x along stage y, y against x.
            (Mat2([[0.0, -um], [um, 0.0]]), [5.0, 10.0]),
            // Mirrored.
            (Mat2([[-um, 0.0], [0.0, um]]), [-10.0, -5.0]),
        ] {
            let told = tilt(&plane([7.0, 1.6, -0.6], 0.1), &scale(Some(map)));
            let stage = told.stage.unwrap();
            for k in 0..2 {
                let seen = stage.slope_um_per_mm[k].value;
                assert!((seen - expected[k]).abs() < 1e-9, "{expected:?} {stage:?}");
            }
            let small = 1e-3_f64.to_degrees();
            assert!((deg(stage.about_x_deg) - small * expected[1]).abs() < 1e-3);
            assert!((deg(stage.about_y_deg) + small * expected[0]).abs() < 1e-3);
        }
    }
}

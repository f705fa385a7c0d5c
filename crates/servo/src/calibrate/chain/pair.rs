//! What the registration of two views says, and where it puts the one in the other.

use super::super::joint::{Link, Pair};
use crate::vision::centre_px;
use scopeservo_geometry::{Mat2, Vec2};
use scopeservo_registration::Estimate;
use serde::{Deserialize, Serialize};

/// No registration is better than this at an image's centre, px, and at half an image from it.
const LEAST_PX: f64 = 0.01;
/// Of the view of one objective in that of another: no lens is without distortion. Px, rad, and of the scale.
const LEAST_LINK: [f64; 4] = [0.05, 0.05, 2e-4, 5e-4];
/// Where a view lies in the first one: its centre, px from that one's, and its angle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Place {
    pub(super) centre_px: Vec2,
    pub(super) angle_rad: f64,
    /// Of the angle, rad^2.
    pub(super) angle_variance: f64,
}

impl Place {
    pub(super) const FIRST: Self = Self {
        centre_px: [0.0; 2],
        angle_rad: 0.0,
        angle_variance: 0.0,
    };

    pub(super) fn after(&self, pair: &Pair) -> Self {
        let there = Mat2::rotation(self.angle_rad) * pair.centre_px;
        Self {
            centre_px: [0, 1].map(|k| self.centre_px[k] + there[k]),
            angle_rad: self.angle_rad + pair.angle_rad,
            angle_variance: self.angle_variance + pair.covariance[2][2],
        }
    }
}

/// What an estimate says of the two images' centres, with its covariance.
pub(super) fn pair_of(
    estimate: &Estimate,
    size_px: [usize; 2],
    fixed: usize,
    found: usize,
) -> Pair {
    let half_px = 0.5 * f64::hypot(size_px[0] as f64, size_px[1] as f64);
    let least = [LEAST_PX, LEAST_PX, LEAST_PX / half_px, 0.0];
    let ([x, y, angle_rad, _], covariance) = read(estimate, size_px, least);
    Pair {
        fixed,
        found,
        centre_px: [x, y],
        angle_rad,
        covariance: [0, 1, 2].map(|r| [0, 1, 2].map(|s| covariance[r][s])),
    }
}

/// The same of the view of one objective in that of another, with the scale.
pub(crate) fn link_of(
    estimate: &Estimate,
    size_px: [usize; 2],
    [fixed, found]: [usize; 2],
) -> Link {
    let (seen, covariance) = read(estimate, size_px, LEAST_LINK);
    Link {
        fixed,
        found,
        seen,
        covariance,
    }
}

/// Where the centre of the one image lies in the other, px from its centre; the angle of the nearest rotation, rad; and the logarithm of the
/// scale; with their covariance, to which the squares of `least` are added.
fn read(estimate: &Estimate, size_px: [usize; 2], least: [f64; 4]) -> ([f64; 4], [[f64; 4]; 4]) {
    let c = centre_px(size_px[0], size_px[1]);
    let transform = &estimate.target_from_view;
    let Mat2([[a, b], [d, e]]) = transform.linear;
    let (cosine, sine, det) = (a + e, d - b, transform.linear.det());
    let length_sq = cosine * cosine + sine * sine;
    let turn = [-sine, -cosine, 0.0, cosine, -sine, 0.0].map(|v| v / length_sq);
    let scale = [e, -d, 0.0, -b, a, 0.0].map(|v| 0.5 * v / det);
    let by = [
        [c[0], c[1], 1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, c[0], c[1], 1.0],
        turn,
        scale,
    ];
    let covariance = std::array::from_fn(|r| {
        std::array::from_fn(|s| {
            let all = (0..6).flat_map(|i| (0..6).map(move |j| (i, j)));
            let of: f64 = all
                .map(|(i, j)| by[r][i] * estimate.covariance[i][j] * by[s][j])
                .sum();
            of + if r == s { least[r] * least[r] } else { 0.0 }
        })
    });
    let [x, y] = transform.recentred(c, c).offset;
    let seen = [x, y, f64::atan2(sine, cosine), 0.5 * det.abs().ln()];
    (seen, covariance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::Affine2;

    /// The centre and the angle of a transform.
    fn read(transform: &Affine2, size_px: [usize; 2]) -> [f64; 3] {
        let c = centre_px(size_px[0], size_px[1]);
        let [x, y] = transform.recentred(c, c).offset;
        let Mat2([[a, b], [d, e]]) = transform.linear;
        [x, y, f64::atan2(d - b, a + e)]
    }

    #[test]
    fn the_covariance_is_that_of_small_changes_of_the_transform() {
        let size_px = [640, 480];
        let base = Affine2 {
            linear: Mat2([[0.999, -0.05], [0.052, 1.001]]),
            offset: [31.0, -12.0],
        };
        let mut covariance = [[0.0; 6]; 6];
        let sigma = [1e-4, 2e-4, 0.03, 1.5e-4, 1e-4, 0.02];
        for (k, s) in sigma.iter().enumerate() {
            covariance[k][k] = s * s;
        }
        let estimate = Estimate {
            target_from_view: base,
            covariance,
            ..Estimate::at_rest()
        };
        let pair = pair_of(&estimate, size_px, 0, 1);
        let here = read(&base, size_px);
        assert_eq!([pair.centre_px[0], pair.centre_px[1], pair.angle_rad], here);
        let mut expected = [[0.0; 3]; 3];
        for (k, sigma) in sigma.iter().enumerate() {
            let mut moved = base;
            let step = 1e-3 * sigma;
            match k % 3 {
                2 => moved.offset[k / 3] += step,
                c => moved.linear.0[k / 3][c] += step,
            }
            let there = read(&moved, size_px);
            let by: Vec<f64> = (0..3).map(|r| (there[r] - here[r]) / 1e-3).collect();
            for r in 0..3 {
                for s in 0..3 {
                    expected[r][s] += by[r] * by[s];
                }
            }
        }
        for r in 0..3 {
            for s in 0..3 {
                let scale = (expected[r][r] * expected[s][s]).sqrt();
                let off = (pair.covariance[r][s] - expected[r][s]).abs();
                let least = if r == s {
                    2.0 * LEAST_PX * LEAST_PX
                } else {
                    0.0
                };
                assert!(off <= 1e-5 * scale + least, "{r} {s}: {off}");
            }
        }
    }

    #[test]
    fn a_chain_of_pairs_says_where_a_view_lies_in_the_first() {
        let pair = |centre_px, angle_rad| Pair {
            fixed: 0,
            found: 1,
            centre_px,
            angle_rad,
            covariance: [[0.0; 3]; 3],
        };
        let quarter = std::f64::consts::FRAC_PI_2;
        let place = Place::FIRST
            .after(&pair([10.0, 0.0], quarter))
            .after(&pair([5.0, 0.0], 0.0));
        assert!((place.centre_px[0] - 10.0).abs() < 1e-12);
        assert!((place.centre_px[1] - 5.0).abs() < 1e-12);
        assert_eq!(place.angle_rad, quarter);
    }
}

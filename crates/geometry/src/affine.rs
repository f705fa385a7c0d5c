//! Affine and similarity transforms of the plane.

use crate::{Mat2, Vec2};
use serde::{Deserialize, Serialize};

/// `b = linear * a + offset`. Serialised as a 2x3 matrix, row-major.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "[[f64; 3]; 2]", into = "[[f64; 3]; 2]")]
pub struct Affine2 {
    /// The 2x2 part.
    pub linear: Mat2,
    /// The image of the origin.
    pub offset: Vec2,
}

impl From<[[f64; 3]; 2]> for Affine2 {
    fn from(m: [[f64; 3]; 2]) -> Self {
        Self {
            linear: Mat2([[m[0][0], m[0][1]], [m[1][0], m[1][1]]]),
            offset: [m[0][2], m[1][2]],
        }
    }
}

impl From<Affine2> for [[f64; 3]; 2] {
    fn from(t: Affine2) -> Self {
        let [[a, b], [c, d]] = t.linear.0;
        [[a, b, t.offset[0]], [c, d, t.offset[1]]]
    }
}

impl Affine2 {
    /// The identity.
    pub const IDENTITY: Affine2 = Affine2 {
        linear: Mat2::IDENTITY,
        offset: [0.0, 0.0],
    };

    /// The image of a point.
    #[inline]
    pub fn apply(&self, p: Vec2) -> Vec2 {
        let q = self.linear * p;
        [q[0] + self.offset[0], q[1] + self.offset[1]]
    }

    /// `c_from_a` from `self` = `c_from_b` and `b_from_a`.
    #[must_use]
    pub fn after(&self, b_from_a: &Affine2) -> Affine2 {
        Affine2 {
            linear: self.linear * b_from_a.linear,
            offset: self.apply(b_from_a.offset),
        }
    }

    /// `a_from_b`, or `None` when the linear part is singular.
    pub fn inverse(&self) -> Option<Affine2> {
        let linear = self.linear.inverse()?;
        let back = linear * self.offset;
        Some(Affine2 {
            linear,
            offset: [-back[0], -back[1]],
        })
    }

    /// Moves the origins of both frames: with this = `b_from_a`, the same transform between coordinates measured
    /// from `origin_a` in a and from `origin_b` in b.
    #[must_use]
    pub fn recentred(&self, origin_a: Vec2, origin_b: Vec2) -> Affine2 {
        let o = self.apply(origin_a);
        Affine2 {
            linear: self.linear,
            offset: [o[0] - origin_b[0], o[1] - origin_b[1]],
        }
    }
}

/// `b = scale * R(angle) * a + offset`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Similarity {
    /// Ratio of lengths, b over a.
    pub scale: f64,
    /// Rotation from a to b, radians, +x towards +y.
    pub angle_rad: f64,
    /// The image of the origin.
    pub offset: Vec2,
}

impl From<Similarity> for Affine2 {
    fn from(s: Similarity) -> Self {
        Affine2 {
            linear: Mat2::rotation(s.angle_rad) * s.scale,
            offset: s.offset,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some() -> Affine2 {
        Affine2::from([[1.1, -0.2, 5.0], [0.3, 0.9, -7.0]])
    }

    #[test]
    fn inverse_and_composition_agree() {
        let round = some().after(&some().inverse().unwrap());
        let p = round.apply([3.0, 4.0]);
        assert!((p[0] - 3.0).abs() < 1e-12 && (p[1] - 4.0).abs() < 1e-12);
        let b_from_a = Affine2::from(Similarity {
            scale: 2.0,
            angle_rad: 0.5,
            offset: [1.0, 2.0],
        });
        let direct = some().apply(b_from_a.apply([6.0, -1.0]));
        let composed = some().after(&b_from_a).apply([6.0, -1.0]);
        assert!((direct[0] - composed[0]).abs() < 1e-12 && (direct[1] - composed[1]).abs() < 1e-12);
    }

    #[test]
    fn recentring_measures_from_other_origins() {
        let t = some().recentred([10.0, 20.0], [1.0, 2.0]);
        let p = t.apply([3.0, 4.0]);
        let q = some().apply([13.0, 24.0]);
        assert!((p[0] - (q[0] - 1.0)).abs() < 1e-12 && (p[1] - (q[1] - 2.0)).abs() < 1e-12);
    }

    #[test]
    fn json_is_a_row_major_2x3_matrix() {
        let json = serde_json::to_string(&some()).unwrap();
        assert_eq!(json, "[[1.1,-0.2,5.0],[0.3,0.9,-7.0]]");
        assert_eq!(serde_json::from_str::<Affine2>(&json).unwrap(), some());
    }
}

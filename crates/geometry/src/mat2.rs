//! 2x2 matrices in closed form: no iteration, no failure on rank-deficient input.

use crate::Vec2;
use serde::{Deserialize, Serialize};
use std::ops::{Add, Mul, Sub};

/// A 2x2 matrix, row-major.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Mat2(pub [[f64; 2]; 2]);

/// `m = u * diag(s) * v^T` with `u`, `v` orthogonal and `s[0] >= s[1] >= 0`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Svd2 {
    /// Left singular vectors, in columns.
    pub u: Mat2,
    /// Singular values, larger first.
    pub s: [f64; 2],
    /// Right singular vectors, in columns.
    pub v: Mat2,
}

impl Mat2 {
    /// The identity.
    pub const IDENTITY: Mat2 = Mat2([[1.0, 0.0], [0.0, 1.0]]);

    /// `diag(a, d)`.
    pub const fn diagonal(a: f64, d: f64) -> Self {
        Self([[a, 0.0], [0.0, d]])
    }

    /// Rotation that takes +x towards +y by `angle_rad`.
    pub fn rotation(angle_rad: f64) -> Self {
        let (s, c) = angle_rad.sin_cos();
        Self([[c, -s], [s, c]])
    }

    /// Determinant.
    pub fn det(&self) -> f64 {
        self.0[0][0] * self.0[1][1] - self.0[0][1] * self.0[1][0]
    }

    /// Transpose.
    #[must_use]
    pub fn transpose(&self) -> Self {
        let [[a, b], [c, d]] = self.0;
        Self([[a, c], [b, d]])
    }

    /// Inverse, or `None` when the determinant is zero or not finite.
    pub fn inverse(&self) -> Option<Self> {
        let det = self.det();
        if !det.is_finite() || det == 0.0 {
            return None;
        }
        let [[a, b], [c, d]] = self.0;
        Some(Self([[d / det, -b / det], [-c / det, a / det]]))
    }

    /// Square root of the sum of squares.
    pub fn frobenius(&self) -> f64 {
        self.0.iter().flatten().map(|v| v * v).sum::<f64>().sqrt()
    }

    /// The singular value decomposition, in closed form.
    ///
    /// A matrix is the sum of a scaled rotation and a scaled reflection, `m = e R(p) + f R(q) diag(1, -1)`; its
    /// singular values are `e + f` and `|e - f|`, its vectors stand at the half sum and half difference of the angles.
    pub fn svd(&self) -> Svd2 {
        let [[a, b], [c, d]] = self.0;
        let (e, f) = (
            f64::hypot(a + d, c - b) / 2.0,
            f64::hypot(a - d, c + b) / 2.0,
        );
        let p = f64::atan2(c - b, a + d);
        let q = f64::atan2(c + b, a - d);
        let mut v = Mat2::rotation((q - p) / 2.0);
        let mut small = e - f;
        if small < 0.0 {
            small = -small;
            v = v * Mat2::diagonal(1.0, -1.0);
        }
        Svd2 {
            u: Mat2::rotation((q + p) / 2.0),
            s: [e + f, small],
            v,
        }
    }

    /// `U V^T` of the SVD: the orthogonal matrix nearest to this one. A rotation exactly when `det >= 0`.
    #[must_use]
    pub fn nearest_orthogonal(&self) -> Self {
        let Svd2 { u, v, .. } = self.svd();
        u * v.transpose()
    }

    /// The angle of `U V^T` when that is a rotation; `None` for a reflection.
    pub fn rotation_angle(&self) -> Option<f64> {
        let r = self.nearest_orthogonal();
        (self.det() > 0.0).then(|| f64::atan2(r.0[1][0] - r.0[0][1], r.0[0][0] + r.0[1][1]))
    }
}

impl Mul for Mat2 {
    type Output = Mat2;
    #[inline]
    fn mul(self, o: Mat2) -> Mat2 {
        let mut out = [[0.0; 2]; 2];
        for (r, row) in out.iter_mut().enumerate() {
            for (c, cell) in row.iter_mut().enumerate() {
                *cell = self.0[r][0] * o.0[0][c] + self.0[r][1] * o.0[1][c];
            }
        }
        Mat2(out)
    }
}

impl Mul<Vec2> for Mat2 {
    type Output = Vec2;
    #[inline]
    fn mul(self, v: Vec2) -> Vec2 {
        self.0.map(|row| row[0] * v[0] + row[1] * v[1])
    }
}

impl Mul<f64> for Mat2 {
    type Output = Mat2;
    #[inline]
    fn mul(self, k: f64) -> Mat2 {
        Mat2(self.0.map(|row| row.map(|x| x * k)))
    }
}

impl Add for Mat2 {
    type Output = Mat2;
    #[inline]
    fn add(self, o: Mat2) -> Mat2 {
        Mat2(std::array::from_fn(|r| {
            std::array::from_fn(|c| self.0[r][c] + o.0[r][c])
        }))
    }
}

impl Sub for Mat2 {
    type Output = Mat2;
    #[inline]
    fn sub(self, o: Mat2) -> Mat2 {
        self + o * -1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SplitMix64;

    fn near(a: Mat2, b: Mat2) -> bool {
        (a - b).frobenius() < 1e-12 * (1.0 + b.frobenius())
    }

    #[test]
    fn svd_rebuilds_the_matrix_with_orthogonal_factors() {
        let mut rng = SplitMix64::new(1);
        let mut cases: Vec<Mat2> = (0..2000)
            .map(|_| {
                let mut x = || rng.uniform() * 2.0 - 1.0;
                Mat2([[x(), x()], [x(), x()]])
            })
            .collect();
        // Rank one, zero, reflections, equal singular values.
        cases.push(Mat2([[1.0, 2.0], [2.0, 4.0]]));
        cases.push(Mat2([[0.0, 0.0], [0.0, 0.0]]));
        cases.push(Mat2::diagonal(1.0, -1.0));
        cases.push(Mat2::rotation(2.0) * 3.0);
        for m in cases {
            let Svd2 { u, s, v } = m.svd();
            assert!(s[0] >= s[1] && s[1] >= 0.0, "{m:?}");
            assert!(
                near(u * Mat2::diagonal(s[0], s[1]) * v.transpose(), m),
                "{m:?}"
            );
            assert!(near(u * u.transpose(), Mat2::IDENTITY));
            assert!(near(v * v.transpose(), Mat2::IDENTITY));
        }
    }

    #[test]
    fn the_angle_of_a_stretched_rotation_is_the_rotation() {
        for deg in [-179.0f64, -90.0, -0.01, 0.0, 33.0, 178.0] {
            let stretch = Mat2([[1.2, 0.1], [0.1, 0.9]]);
            let m = Mat2::rotation(deg.to_radians()) * stretch;
            let angle = m.rotation_angle().unwrap();
            assert!((angle - deg.to_radians()).abs() < 1e-12, "{deg}");
        }
        assert_eq!(Mat2::diagonal(1.0, -1.0).rotation_angle(), None);
    }

    #[test]
    fn inverse_undoes() {
        let m = Mat2([[2.0, 1.0], [-3.0, 0.5]]);
        assert!(near(m * m.inverse().unwrap(), Mat2::IDENTITY));
        assert_eq!(Mat2([[1.0, 2.0], [2.0, 4.0]]).inverse(), None);
    }
}

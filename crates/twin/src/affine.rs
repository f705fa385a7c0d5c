//! Affine maps of the plane.

/// `q = M p + t`, written as two rows of three.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Affine(pub(crate) [[f64; 3]; 2]);

impl Affine {
    pub(crate) fn rotation(angle_rad: f64) -> Self {
        let (s, c) = angle_rad.sin_cos();
        Self([[c, -s, 0.0], [s, c, 0.0]])
    }
    pub(crate) fn shift(by: [f64; 2]) -> Self {
        Self([[1.0, 0.0, by[0]], [0.0, 1.0, by[1]]])
    }
    pub(crate) fn apply(&self, p: [f64; 2]) -> [f64; 2] {
        self.0.map(|r| r[0] * p[0] + r[1] * p[1] + r[2])
    }
    /// First `self`, then `next`.
    #[must_use]
    pub(crate) fn then(&self, next: &Self) -> Self {
        let a = &self.0;
        Self(next.0.map(|r| {
            [
                r[0] * a[0][0] + r[1] * a[1][0],
                r[0] * a[0][1] + r[1] * a[1][1],
                r[0] * a[0][2] + r[1] * a[1][2] + r[2],
            ]
        }))
    }
    pub(crate) fn determinant(&self) -> f64 {
        let a = &self.0;
        a[0][0] * a[1][1] - a[0][1] * a[1][0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn composition_applies_left_to_right() {
        let a = Affine::rotation(0.3).then(&Affine::shift([1.0, -2.0]));
        let b = Affine([[2.0, 0.5, 3.0], [0.0, -1.0, 4.0]]);
        let p = [0.7, -1.9];
        let (once, twice) = (a.then(&b).apply(p), b.apply(a.apply(p)));
        assert!((once[0] - twice[0]).abs() < 1e-12 && (once[1] - twice[1]).abs() < 1e-12);
    }
}

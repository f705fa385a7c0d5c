//! Cholesky of a symmetric matrix whose size is known at run time, for least squares with many unknowns.

/// `D m D = L L^T` with D the scaling to a unit diagonal, so that the test of the pivots is independent of units.
#[derive(Debug, Clone, PartialEq)]
pub struct Cholesky {
    n: usize,
    /// n x n, row by row; zero above the diagonal.
    l: Vec<f64>,
    /// The diagonal of D.
    scale: Vec<f64>,
}

/// A pivot below this share of its diagonal is none.
const LEAST_PIVOT: f64 = 1e-13;

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Cholesky {
    /// Of a symmetric n x n matrix given row by row, of which the lower triangle is read. `None` when it is not positive definite,
    /// to working precision.
    pub fn of(m: &[f64], n: usize) -> Option<Self> {
        assert_eq!(m.len(), n * n);
        let diagonal = (0..n).map(|i| m[i * n + i]);
        if !diagonal.clone().all(|d| d.is_finite() && d > 0.0) {
            return None;
        }
        let scale: Vec<f64> = diagonal.map(|d| d.sqrt().recip()).collect();
        let mut l = vec![0.0; n * n];
        for i in 0..n {
            let (above, row) = l.split_at_mut(i * n);
            for j in 0..i {
                let rest =
                    m[i * n + j] * scale[i] * scale[j] - dot(&row[..j], &above[j * n..][..j]);
                row[j] = rest / above[j * n + j];
            }
            let rest = 1.0 - dot(&row[..i], &row[..i]);
            if rest.is_nan() || rest <= LEAST_PIVOT {
                return None;
            }
            row[i] = rest.sqrt();
        }
        Some(Self { n, l, scale })
    }

    /// x of `m x = right`.
    pub fn solve(&self, right: &[f64]) -> Vec<f64> {
        let (n, l) = (self.n, &self.l);
        let mut x: Vec<f64> = right.iter().zip(&self.scale).map(|(r, s)| r * s).collect();
        for i in 0..n {
            x[i] = (x[i] - dot(&l[i * n..][..i], &x[..i])) / l[i * n + i];
        }
        for i in (0..n).rev() {
            x[i] /= l[i * n + i];
            let (before, rest) = x.split_at_mut(i);
            for (x, l) in before.iter_mut().zip(&l[i * n..]) {
                *x -= l * rest[0];
            }
        }
        x.iter().zip(&self.scale).map(|(x, s)| x * s).collect()
    }

    /// The inverse, row by row: the covariance of all unknowns where m is their information.
    pub fn inverse(&self) -> Vec<f64> {
        let n = self.n;
        let mut inverse = vec![0.0; n * n];
        let mut unit = vec![0.0; n];
        for k in 0..n {
            unit[k] = 1.0;
            inverse[k * n..][..n].copy_from_slice(&self.solve(&unit));
            unit[k] = 0.0;
        }
        inverse
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SplitMix64;

    #[test]
    fn a_matrix_times_its_inverse_is_the_identity_whatever_the_units() {
        let (n, mut rng) = (12, SplitMix64::new(3));
        let units: Vec<f64> = (0..n).map(|k| 10f64.powi(k as i32 - 6)).collect();
        let a: Vec<f64> = (0..n * n).map(|_| rng.normal()).collect();
        let m: Vec<f64> = (0..n * n)
            .map(|k| {
                let (i, j) = (k / n, k % n);
                dot(&a[i * n..][..n], &a[j * n..][..n]) * units[i] * units[j]
            })
            .collect();
        let inverse = Cholesky::of(&m, n).unwrap().inverse();
        for i in 0..n {
            for j in 0..n {
                let product: f64 = (0..n).map(|k| m[i * n + k] * inverse[k * n + j]).sum();
                let unit = f64::from(u8::from(i == j)) - product * units[j] / units[i];
                assert!(unit.abs() < 1e-7, "{i} {j} {unit}");
            }
        }
    }

    #[test]
    fn what_is_not_determined_has_none() {
        assert_eq!(Cholesky::of(&[1.0, 2.0, 2.0, 4.0], 2), None);
        assert_eq!(Cholesky::of(&[1.0, 0.0, 0.0, 0.0], 2), None);
    }
}

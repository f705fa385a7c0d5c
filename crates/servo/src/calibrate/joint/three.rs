//! Vectors and matrices of the three numbers that a pair shows.

pub(super) type Three = [f64; 3];

pub(super) fn dot(a: &Three, b: &Three) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// A matrix times a vector.
pub(super) fn times(m: &[Three; 3], v: &Three) -> Three {
    m.map(|row| dot(&row, v))
}

pub(super) fn entries(of: impl Fn(usize, usize) -> f64) -> [Three; 3] {
    [0, 1, 2].map(|r| [0, 1, 2].map(|s| of(r, s)))
}

pub(super) fn product(a: &[Three; 3], b: &[Three; 3]) -> [Three; 3] {
    entries(|r, s| (0..3).map(|k| a[r][k] * b[k][s]).sum())
}

/// By cofactors; `None` where the matrix is singular to working precision.
pub(super) fn inverse(m: &[Three; 3]) -> Option<[Three; 3]> {
    let cofactor = |r: usize, s: usize| {
        let at = |i: usize, j: usize| m[(r + i) % 3][(s + j) % 3];
        at(1, 1) * at(2, 2) - at(1, 2) * at(2, 1)
    };
    let det: f64 = (0..3).map(|s| m[0][s] * cofactor(0, s)).sum();
    (det.abs() > 1e-20).then(|| entries(|r, s| cofactor(s, r) / det))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_matrix_times_its_inverse_is_the_identity() {
        let m = [[2.0, 0.5, -1.0], [0.0, 3.0, 4.0], [1.0, -2.0, 0.5]];
        let unit = product(&m, &inverse(&m).unwrap());
        for (r, row) in unit.iter().enumerate() {
            for (s, u) in row.iter().enumerate() {
                assert!((u - f64::from(u8::from(r == s))).abs() < 1e-15);
            }
        }
        assert_eq!(
            inverse(&[[1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [0.0, 1.0, 0.0]]),
            None
        );
    }
}

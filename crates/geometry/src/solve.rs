//! Small dense least squares by Cholesky on scaled normal equations.

/// Inverse of a symmetric positive definite matrix; `None` when it is not, to working precision.
#[expect(
    clippy::needless_range_loop,
    reason = "the indices are those of the textbook formulas"
)]
pub fn cholesky_inverse<const N: usize>(m: &[[f64; N]; N]) -> Option<[[f64; N]; N]> {
    // Scaling to a unit diagonal makes the pivot test independent of units.
    let mut scale = [0.0; N];
    for i in 0..N {
        if !(m[i][i].is_finite() && m[i][i] > 0.0) {
            return None;
        }
        scale[i] = m[i][i].sqrt().recip();
    }
    let mut l = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| l[i][k] * l[j][k]).sum();
            let rest = m[i][j] * scale[i] * scale[j] - dot;
            if i == j {
                if !(rest.is_finite() && rest > 1e-13) {
                    return None;
                }
                l[i][i] = rest.sqrt();
            } else {
                l[i][j] = rest / l[j][j];
            }
        }
    }
    let mut inverse = [[0.0; N]; N];
    for column in 0..N {
        let mut y = [0.0; N];
        for i in 0..N {
            let dot: f64 = (0..i).map(|k| l[i][k] * y[k]).sum();
            y[i] = (f64::from(u8::from(i == column)) - dot) / l[i][i];
        }
        for i in (0..N).rev() {
            let dot: f64 = (i + 1..N).map(|k| l[k][i] * inverse[k][column]).sum();
            inverse[i][column] = (y[i] - dot) / l[i][i];
        }
    }
    for i in 0..N {
        for j in 0..N {
            inverse[i][j] *= scale[i] * scale[j];
        }
    }
    Some(inverse)
}

/// Minimises `sum (row . x - value)^2` over the equations given as `(row, value)`.
///
/// Returns the solution and `(A^T A)^-1`: times the variance of one equation it is the covariance of the solution.
/// `None` when the equations do not determine all N unknowns.
pub fn least_squares<const N: usize>(
    equations: &[([f64; N], f64)],
) -> Option<([f64; N], [[f64; N]; N])> {
    let mut normal = [[0.0; N]; N];
    let mut right = [0.0; N];
    for (row, value) in equations {
        for i in 0..N {
            right[i] += row[i] * value;
            for j in 0..N {
                normal[i][j] += row[i] * row[j];
            }
        }
    }
    let inverse = cholesky_inverse(&normal)?;
    let x = std::array::from_fn(|i| (0..N).map(|j| inverse[i][j] * right[j]).sum());
    Some((x, inverse))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exact_system_has_zero_residual() {
        let truth = [2.0, -3.0, 0.5];
        let equations: Vec<([f64; 3], f64)> = (0..7)
            .map(|i| {
                let x = f64::from(i);
                let row = [1.0, x, x * x];
                (row, row.iter().zip(&truth).map(|(a, b)| a * b).sum())
            })
            .collect();
        let (x, _) = least_squares(&equations).unwrap();
        for (a, b) in x.iter().zip(&truth) {
            assert!((a - b).abs() < 1e-9);
        }
    }

    #[test]
    fn units_do_not_matter_and_rank_does() {
        let m = [[1e-12, 0.0], [0.0, 1e12]];
        let inverse = cholesky_inverse(&m).unwrap();
        assert!((inverse[0][0] - 1e12).abs() < 1.0 && (inverse[1][1] - 1e-12).abs() < 1e-20);
        assert_eq!(least_squares(&[([1.0, 2.0], 1.0), ([2.0, 4.0], 2.0)]), None);
    }
}

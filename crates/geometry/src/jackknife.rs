//! The covariance of a fit from what the fit would be without each part of the field (the delete-a-block jackknife).
//!
//! Errors that neighbours share, unequal errors and few places all enter it, and no model of the errors is needed but that blocks
//! are independent. To first order nothing is fitted anew: without block g the unknowns change by `(N - N_g)^-1 s_g`, with the normal
//! matrix N and the sum s of weight times residual. This is the cluster-robust covariance named CR3 (Cameron, Miller, Journal of Human
//! Resources 2015), which is not too small where blocks are few.

use crate::{Affine2, Mat2, Vec2, cholesky_inverse};

/// Fewer blocks than this tell a covariance badly: then smaller ones are taken.
const FEW_BLOCKS: usize = 16;
/// How often blocks are halved for it, at most.
const HALVINGS: usize = 6;

/// Which block each point lies in, and how many blocks there are: squares of this side, halved while there are few.
pub(crate) fn blocks(points: impl Iterator<Item = Vec2> + Clone, side: f64) -> (Vec<usize>, usize) {
    let wanted = points.clone().count().min(FEW_BLOCKS);
    let mut divided = (Vec::new(), 0);
    for halvings in 0..=HALVINGS {
        divided = squares(points.clone(), side / (1 << halvings) as f64);
        if divided.1 >= wanted {
            break;
        }
    }
    divided
}

/// The same for squares of this side.
fn squares(points: impl Iterator<Item = Vec2>, side: f64) -> (Vec<usize>, usize) {
    let cell = |x: f64| (x / side).floor() as i64;
    let mut ranked: Vec<([i64; 2], usize)> =
        points.enumerate().map(|(i, p)| (p.map(cell), i)).collect();
    ranked.sort_unstable();
    let mut blocks = vec![0; ranked.len()];
    let mut count = 0;
    for (k, &(cell, i)) in ranked.iter().enumerate() {
        count += usize::from(k == 0 || ranked[k - 1].0 != cell);
        blocks[i] = count - 1;
    }
    (blocks, count)
}

/// What one equation for N unknowns, with M right sides, does to a fit.
pub(crate) struct Equation<const N: usize, const M: usize> {
    pub(crate) block: usize,
    /// Derivative of the value by the unknowns.
    pub(crate) row: [f64; N],
    /// Derivative of `pull` by the residual.
    pub(crate) slope: f64,
    /// Weight times residual.
    pub(crate) pull: [f64; M],
}

/// The normal matrix of a block of equations, and its right sides: the sums of weight times residual times derivative.
pub type Normal<const N: usize, const M: usize> = ([[f64; N]; N], [[f64; N]; M]);

/// By how much the unknowns change when each block is left out. `None` when the others do not determine them.
pub(crate) fn changes<const N: usize, const M: usize>(
    equations: impl Iterator<Item = Equation<N, M>>,
    blocks: usize,
) -> Option<Vec<[[f64; N]; M]>> {
    let mut parts = vec![([[0.0; N]; N], [[0.0; N]; M]); blocks];
    for e in equations {
        let (normal, right) = &mut parts[e.block];
        for (row, a) in normal.iter_mut().zip(e.row) {
            for (cell, b) in row.iter_mut().zip(e.row) {
                *cell += e.slope * a * b;
            }
        }
        for (right, pull) in right.iter_mut().zip(e.pull) {
            for (cell, a) in right.iter_mut().zip(e.row) {
                *cell += pull * a;
            }
        }
    }
    changes_without(&parts)
}

/// The same from the sums of each block.
pub fn changes_without<const N: usize, const M: usize>(
    parts: &[Normal<N, M>],
) -> Option<Vec<[[f64; N]; M]>> {
    let mut whole = [[0.0; N]; N];
    for (normal, _) in parts {
        for (whole, part) in whole.iter_mut().flatten().zip(normal.iter().flatten()) {
            *whole += part;
        }
    }
    let change = |(normal, right): &Normal<N, M>| {
        let left: [[f64; N]; N] =
            std::array::from_fn(|i| std::array::from_fn(|j| whole[i][j] - normal[i][j]));
        let inverse = cholesky_inverse(&left)?;
        Some(right.map(|r| inverse.map(|row| row.iter().zip(r).map(|(a, b)| a * b).sum())))
    };
    parts.iter().map(change).collect()
}

/// The covariance of an affine transform, in the order of [`AffineFit`](crate::AffineFit), with independent deviations about
/// `mean_a`.
pub fn covariance(deviations: impl Iterator<Item = [[f64; 3]; 2]>, mean_a: Vec2) -> [[f64; 6]; 6] {
    let mut covariance = [[0.0; 6]; 6];
    for [[a11, a12, b1], [a21, a22, b2]] in deviations {
        let centred = Affine2 {
            linear: Mat2([[a11, a12], [a21, a22]]),
            offset: [b1, b2],
        };
        let [b1, b2] = centred.apply(mean_a.map(|m| -m));
        let all = [a11, a12, b1, a21, a22, b2];
        for (row, a) in covariance.iter_mut().zip(all) {
            for (cell, b) in row.iter_mut().zip(all) {
                *cell += a * b;
            }
        }
    }
    covariance
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SplitMix64, least_squares};

    #[test]
    fn a_block_holds_a_square_and_few_blocks_are_halved() {
        let grid = (0..400).map(|i| [f64::from(i % 20), f64::from(i / 20)]);
        let (blocks_of, count) = blocks(grid.clone(), 5.0);
        assert_eq!((count, blocks_of[0]), (16, blocks_of[4 * 20 + 4]));
        assert!(blocks_of[0] != blocks_of[5] && blocks_of[0] != blocks_of[5 * 20]);
        // One square of 40, four of 20, sixteen of 10.
        let near = |t: f64| [t, t];
        assert_eq!(blocks(grid.clone(), 40.0).1, 16);
        // Three places: three blocks, if they are apart at all.
        let three = [near(0.1), near(0.9), near(4.1)].into_iter();
        assert_eq!(blocks(three, 8.0).1, 3);
        assert_eq!(blocks([near(0.5); 7].into_iter(), 8.0).1, 1);
        assert_eq!(blocks(std::iter::empty(), 8.0).1, 0);
    }

    #[test]
    fn the_changes_are_those_of_a_fit_without_the_block() {
        // Linear least squares: here the first order is all there is.
        let mut rng = SplitMix64::new(5);
        let rows: Vec<([f64; 2], f64)> = (0..9)
            .map(|_| ([rng.normal(), 1.0], rng.normal()))
            .collect();
        let (all, _) = least_squares(&rows).unwrap();
        let equations = rows.iter().enumerate().map(|(i, (row, value))| Equation {
            block: i / 3,
            row: *row,
            slope: 1.0,
            pull: [value - row[0] * all[0] - row[1] * all[1]],
        });
        let changes = changes(equations, 3).unwrap();
        for (block, change) in changes.iter().enumerate() {
            let mut rest = rows.clone();
            rest.drain(3 * block..3 * block + 3);
            let (without, _) = least_squares(&rest).unwrap();
            for k in 0..2 {
                assert!((all[k] - without[k] - change[0][k]).abs() < 1e-12);
            }
        }
    }
}

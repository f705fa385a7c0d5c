//! A robust plane through heights.

use super::blocks::BlockHeight;
use scopeservo_geometry::{SplitMix64, changes_without, least_squares};

/// So many heights make a plane, at least.
pub(super) const NEEDED: usize = 8;
/// Triples of heights that are tried.
const TRIALS: usize = 300;
/// What is farther off than this, in standard deviations, counts for nothing (Tukey).
const TUKEY: f64 = 4.685;
/// Rounds of weights.
const ROUNDS: usize = 20;
/// A standard deviation is this many median deviations.
const MEDIAN: f64 = 1.4826;
/// Blocks in so many columns and rows share what they see: their errors are taken together.
const TOGETHER: usize = 3;

/// Heights by `z = c[0] + c[1] x + c[2] y`, with x and y in half-widths of the image, from its middle.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plane {
    pub(super) c: [f64; 3],
    pub(super) covariance: [[f64; 3]; 3],
    /// Standard deviation of the heights about it, um.
    pub(super) scatter_um: f64,
    /// Share of the heights' variation that it explains.
    pub(super) goodness: f64,
    /// Which heights count.
    pub(super) used: Vec<bool>,
}

struct Row {
    row: [f64; 3],
    z: f64,
    sigma: f64,
}

impl Row {
    fn off(&self, c: &[f64; 3]) -> f64 {
        self.z - (0..3).map(|k| c[k] * self.row[k]).sum::<f64>()
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The plane that most heights lie in. `half`: half the image's width and height, px. `None` where there are too few heights, or all on a line.
pub(super) fn robust_plane(heights: &[BlockHeight], half: [f64; 2]) -> Option<Plane> {
    let rows: Vec<Row> = heights
        .iter()
        .map(|b| Row {
            row: [1.0, b.at_px[0] / half[0], b.at_px[1] / half[1]],
            z: b.z_um,
            sigma: b.sigma_um.max(1e-6),
        })
        .collect();
    if rows.len() < NEEDED {
        return None;
    }
    let mut c = of_most(&rows)?;
    let usual = median(rows.iter().map(|r| r.sigma).collect());
    let mut weights = vec![1.0; rows.len()];
    let mut scatter = usual;
    for _ in 0..ROUNDS {
        let seen = MEDIAN * median(rows.iter().map(|r| r.off(&c).abs()).collect());
        // No less than the heights' own noise, or a few that agree by chance would shut out all others.
        scatter = seen.max(usual);
        for (weight, row) in weights.iter_mut().zip(&rows) {
            let sigma = scatter.max(row.sigma);
            let u = row.off(&c) / (TUKEY * sigma);
            *weight = (1.0 - u * u).max(0.0).powi(2) / (sigma * sigma);
        }
        c = weighted(&rows, &weights)?.0;
    }
    let used: Vec<bool> = weights.iter().map(|w| *w > 0.0).collect();
    let count = used.iter().filter(|u| **u).count();
    if count < NEEDED {
        return None;
    }
    let (_, inverse) = weighted(&rows, &weights)?;
    let all: f64 = weights.iter().sum();
    let mean = weights.iter().zip(&rows).map(|(w, r)| w * r.z).sum::<f64>() / all;
    let squares = |off: &dyn Fn(&Row) -> f64| -> f64 {
        let each = weights.iter().zip(&rows);
        each.map(|(w, r)| w * off(r).powi(2)).sum()
    };
    let (about, left) = (squares(&|r| r.z - mean), squares(&|r| r.off(&c)));
    let freedom = count as f64 / (count as f64 - 3.0);
    // Per height as they scatter, or as they say themselves, whatever is more.
    let stated = inverse.map(|row| row.map(|v| v * (left / count as f64 * freedom).max(1.0)));
    let together = taken_together(&rows, &weights, heights, &c);
    let trace = |m: &[[f64; 3]; 3]| m[1][1] + m[2][2];
    let covariance = match together {
        Some(m) if trace(&m) > trace(&stated) => m,
        _ => stated,
    };
    Some(Plane {
        c,
        covariance,
        scatter_um: scatter,
        goodness: 1.0 - left / about.max(left).max(f64::MIN_POSITIVE),
        used,
    })
}

fn weighted(rows: &[Row], weights: &[f64]) -> Option<([f64; 3], [[f64; 3]; 3])> {
    let equations: Vec<([f64; 3], f64)> = rows
        .iter()
        .zip(weights)
        .map(|(r, w)| (r.row.map(|v| v * w.sqrt()), r.z * w.sqrt()))
        .collect();
    least_squares(&equations)
}

/// Of planes through three heights the one that half of all lie nearest to.
fn of_most(rows: &[Row]) -> Option<[f64; 3]> {
    let mut rng = SplitMix64::new(7);
    let mut best: Option<(f64, [f64; 3])> = None;
    for _ in 0..TRIALS {
        let three = [0; 3].map(|_| &rows[rng.below(rows.len())]);
        let equations = three.map(|r| (r.row, r.z));
        let Some((c, _)) = least_squares(&equations) else {
            continue;
        };
        let off = median(rows.iter().map(|r| r.off(&c).abs()).collect());
        if off.is_finite() && best.is_none_or(|(least, _)| off < least) {
            best = Some((off, c));
        }
    }
    best.map(|(_, c)| c)
}

/// The covariance by what leaving out each group of neighbours would change. `None` where there are too few groups.
fn taken_together(
    rows: &[Row],
    weights: &[f64],
    heights: &[BlockHeight],
    c: &[f64; 3],
) -> Option<[[f64; 3]; 3]> {
    let group = |b: &BlockHeight| b.cell.map(|k| k / TOGETHER);
    let mut groups: Vec<[usize; 2]> = heights.iter().map(group).collect();
    groups.sort_unstable();
    groups.dedup();
    if groups.len() < 5 {
        return None;
    }
    let mut parts = vec![([[0.0; 3]; 3], [[0.0; 3]; 1]); groups.len()];
    for ((row, weight), block) in rows.iter().zip(weights).zip(heights) {
        let part = groups.binary_search(&group(block)).ok()?;
        let (normal, right) = &mut parts[part];
        let off = row.off(c);
        for (right, a) in right[0].iter_mut().zip(row.row) {
            *right += weight * off * a;
        }
        for (line, a) in normal.iter_mut().zip(row.row) {
            for (cell, b) in line.iter_mut().zip(row.row) {
                *cell += weight * a * b;
            }
        }
    }
    let mut covariance = [[0.0; 3]; 3];
    for [change] in changes_without(&parts)? {
        for (line, a) in covariance.iter_mut().zip(change) {
            for (cell, b) in line.iter_mut().zip(change) {
                *cell += a * b;
            }
        }
    }
    Some(covariance)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HALF: [f64; 2] = [320.0, 240.0];

    /// Twelve by nine heights of a plane with noise, changed by the test.
    fn heights(
        slope: [f64; 2],
        noise_um: f64,
        seed: u64,
        change: impl Fn(&mut BlockHeight),
    ) -> Vec<BlockHeight> {
        let mut rng = SplitMix64::new(seed);
        (0..108)
            .map(|k| {
                let cell = [k % 12, k / 12];
                let at_px = [
                    (cell[0] as f64 + 0.5) * 640.0 / 12.0 - 320.0,
                    (cell[1] as f64 + 0.5) * 480.0 / 9.0 - 240.0,
                ];
                let z_um = 5.0 + slope[0] * at_px[0] / 320.0 + slope[1] * at_px[1] / 240.0;
                let mut block = BlockHeight {
                    cell,
                    at_px,
                    z_um: z_um + noise_um * rng.normal(),
                    sigma_um: noise_um.max(0.01),
                    used: true,
                };
                change(&mut block);
                block
            })
            .collect()
    }

    fn off(plane: &Plane, truth: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| (plane.c[k + 1] - truth[k]) / plane.covariance[k + 1][k + 1].sqrt())
    }

    #[test]
    fn a_plane_is_known_as_well_as_it_says_whatever_some_blocks_show() {
        let mut squares = Vec::new();
        for (k, slope) in [[0.0, 0.0], [1.2, 0.0], [0.0, -0.7], [2.0, 1.5]]
            .into_iter()
            .enumerate()
        {
            for seed in 0..25 {
                let plain = heights(slope, 0.2, 100 * k as u64 + seed, |_| {});
                let plane = robust_plane(&plain, HALF).unwrap();
                squares.extend(off(&plane, slope).map(|o| o * o));
            }
        }
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        // A sigma by twelve groups of neighbours scatters, and may be too large rather than too small.
        assert!((0.5..1.5).contains(&mean), "{mean}");
        assert!(squares.iter().all(|s| *s < 25.0));
    }

    #[test]
    fn a_block_of_another_height_a_step_and_a_corner_that_is_wrong_do_not_count() {
        let slope = [1.2, -0.8];
        type Change = fn(&mut BlockHeight);
        let one: Change = |b| b.z_um += if b.cell == [5, 4] { 30.0 } else { 0.0 };
        let step: Change = |b| b.z_um += if b.cell[0] > 8 { 4.0 } else { 0.0 };
        let corner: Change = |b| {
            if b.cell[0] < 4 && b.cell[1] < 4 {
                b.z_um = -9.0;
            }
        };
        for (name, change, out) in [("one", one, 1), ("step", step, 27), ("corner", corner, 16)] {
            let plane = robust_plane(&heights(slope, 0.1, 3, change), HALF).unwrap();
            let o = off(&plane, slope);
            assert!(o.iter().all(|o| o.abs() < 4.0), "{name}: {o:?} {plane:?}");
            let left_out = plane.used.iter().filter(|u| !**u).count();
            assert!((out..out + 4).contains(&left_out), "{name}: {left_out}");
        }
    }

    #[test]
    fn too_few_heights_and_a_line_of_them_are_no_plane() {
        let all = heights([1.0, 1.0], 0.1, 1, |_| {});
        assert_eq!(robust_plane(&all[..NEEDED - 1], HALF), None);
        assert_eq!(robust_plane(&[], HALF), None);
        assert_eq!(robust_plane(&all[..12], HALF), None, "one row");
        assert!(robust_plane(&all[..48], HALF).is_some(), "the upper part");
    }
}

//! How many transforms like this would chance alone produce? (Moisan, Stival, IJCV 2004, the a-contrario test.)
//!
//! Under the hypothesis that the images show different things, each match lands anywhere in the target, independently
//! of the others. The expected number of transforms through m of n matches that at least k matches agree with, each by
//! chance with probability p, is at most
//! `NFA(n, k, p) = (n - m) C(n, k) C(k, m) p^(k - m)`.
//! An affine transform takes m = 3 matches, a similarity m = 2: five inliers with a similarity say more than five
//! that agree with some affine transform.
//! Accepting only `NFA < false_alarms` therefore bounds the expected number of false "found" per registration. The
//! bound needs independent places, so matches are counted on unique places only. It is the bound of that model, not a
//! theorem about real images: how often unrelated ones are found is measured, too.

use scopeservo_geometry::Vec2;

/// Matches that an affine transform takes to be determined.
pub const AFFINE_SAMPLE: usize = 3;
/// Matches that a similarity takes to be determined.
pub const SIMILARITY_SAMPLE: usize = 2;

/// log10 of the expected number of false alarms, for transforms that `sample` matches determine. Infinite when `agreeing` does
/// not exceed that.
pub fn log10_nfa(sample: usize, matches: usize, agreeing: usize, chance: f64) -> f64 {
    if agreeing <= sample || agreeing > matches {
        return f64::INFINITY;
    }
    let ln = ((matches - sample) as f64).ln()
        + ln_choose(matches, agreeing)
        + ln_choose(agreeing, sample)
        + (agreeing - sample) as f64 * chance.clamp(1e-300, 1.0).ln();
    ln / std::f64::consts::LN_10
}

pub(crate) fn ln_choose(n: usize, k: usize) -> f64 {
    let k = k.min(n - k);
    (0..k).map(|i| ((n - i) as f64 / (i + 1) as f64).ln()).sum()
}

/// Indices of `points` (pairs of places) that are the first of their neighbourhood: no earlier kept one lies within
/// `apart_a` in a or within `apart_b` in b.
pub fn unique_places(points: &[(Vec2, Vec2)], apart_a: f64, apart_b: f64) -> Vec<usize> {
    let mut kept_a = Neighbours::new(points.iter().map(|p| p.0), apart_a);
    let mut kept_b = Neighbours::new(points.iter().map(|p| p.1), apart_b);
    let mut kept = Vec::new();
    for (i, &(a, b)) in points.iter().enumerate() {
        if !kept_a.near(a) && !kept_b.near(b) {
            kept_a.add(a);
            kept_b.add(b);
            kept.push(i);
        }
    }
    kept
}

/// Places in a grid of about as many cells as there may be places, so that few are looked at to find a near one.
struct Neighbours {
    apart: f64,
    corner: Vec2,
    cell: f64,
    /// Columns and rows.
    size: [usize; 2],
    /// The last place of each cell: index into `places`.
    last: Vec<Option<u32>>,
    /// Each place with the one before it in its cell.
    places: Vec<(Vec2, Option<u32>)>,
}

impl Neighbours {
    /// For places among `all`, neighbours when nearer than `apart`.
    fn new(all: impl ExactSizeIterator<Item = Vec2>, apart: f64) -> Self {
        let count = all.len();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in all {
            for k in 0..2 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        let extent = [0, 1].map(|k| high[k] - low[k]);
        let cell = (extent[0].max(extent[1]) / (count as f64).sqrt()).max(apart);
        let size = extent.map(|e| (e / cell) as usize + 1);
        Self {
            apart,
            corner: low,
            cell,
            size,
            last: vec![None; size[0] * size[1]],
            places: Vec::with_capacity(count),
        }
    }

    /// Column or row of a coordinate, the nearest when it lies outside.
    fn index(&self, k: usize, x: f64) -> usize {
        (((x - self.corner[k]) / self.cell) as usize).min(self.size[k] - 1)
    }

    fn near(&self, p: Vec2) -> bool {
        let [columns, rows] =
            [0, 1].map(|k| self.index(k, p[k] - self.apart)..=self.index(k, p[k] + self.apart));
        for row in rows {
            for column in columns.clone() {
                let mut next = self.last[row * self.size[0] + column];
                while let Some(at) = next {
                    let (q, before) = self.places[at as usize];
                    if close(p, q, self.apart) {
                        return true;
                    }
                    next = before;
                }
            }
        }
        false
    }

    fn add(&mut self, p: Vec2) {
        let at = self.index(1, p[1]) * self.size[0] + self.index(0, p[0]);
        let before = self.last[at].replace(self.places.len() as u32);
        self.places.push((p, before));
    }
}

fn close(p: Vec2, q: Vec2, apart: f64) -> bool {
    let d = [p[0] - q[0], p[1] - q[1]];
    d[0] * d[0] + d[1] * d[1] < apart * apart
}

/// The area of the target, px^2, in which keypoints lie at all: matches cannot land on blank glass, so only this counts
/// for chance. Cells of `cell` px with at least one keypoint.
pub fn occupied_area(points: impl Iterator<Item = Vec2>, cell: f64) -> f64 {
    // Column and row in one number, which sorts fastest.
    let index = |x: f64| i64::from((x / cell).floor() as i32);
    let mut cells: Vec<i64> = points.map(|p| (index(p[1]) << 32) + index(p[0])).collect();
    cells.sort_unstable();
    cells.dedup();
    cells.len() as f64 * cell * cell
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::SplitMix64;

    #[test]
    fn the_formula_in_the_head_is_what_is_computed() {
        // n = 10, k = 5, p = 0.01: 7 * 252 * 10 * 1e-4.
        let expected = (7.0f64 * 252.0 * 10.0 * 1e-4).log10();
        assert!((log10_nfa(AFFINE_SAMPLE, 10, 5, 0.01) - expected).abs() < 1e-12);
        // The same for m = 2: 8 * 252 * 10 * 1e-6.
        let expected = (8.0f64 * 252.0 * 10.0 * 1e-6).log10();
        assert!((log10_nfa(SIMILARITY_SAMPLE, 10, 5, 0.01) - expected).abs() < 1e-12);
    }

    #[test]
    fn more_agreement_is_less_by_chance_and_a_bare_sample_proves_nothing() {
        for sample in [SIMILARITY_SAMPLE, AFFINE_SAMPLE] {
            assert_eq!(log10_nfa(sample, 100, sample, 1e-4), f64::INFINITY);
            assert_eq!(log10_nfa(sample, 2, 3, 1e-4), f64::INFINITY);
            let mut last = f64::INFINITY;
            for k in 6..60 {
                let nfa = log10_nfa(sample, 100, k, 1e-4);
                assert!(nfa < last);
                last = nfa;
            }
        }
    }

    #[test]
    fn twins_count_once() {
        let p = |x: f64| ([x, 0.0], [2.0 * x, 5.0]);
        assert_eq!(
            unique_places(&[p(0.0), p(1.0), p(10.0), p(10.5), p(30.0)], 2.0, 4.0),
            vec![0, 2, 4]
        );
    }

    #[test]
    fn the_grid_keeps_what_comparing_all_pairs_keeps() {
        let naive = |points: &[(Vec2, Vec2)], apart_a: f64, apart_b: f64| {
            let mut kept: Vec<usize> = Vec::new();
            for (i, &(a, b)) in points.iter().enumerate() {
                let near =
                    |&j: &usize| close(a, points[j].0, apart_a) || close(b, points[j].1, apart_b);
                if !kept.iter().any(near) {
                    kept.push(i);
                }
            }
            kept
        };
        let mut rng = SplitMix64::new(9);
        for (count, width, height) in [
            (0, 1.0, 1.0),
            (1, 1.0, 1.0),
            (900, 60.0, 40.0),
            (500, 900.0, 0.0),
            (800, 0.0, 0.0),
        ] {
            // Steps of a quarter: neighbours at exactly the distance, and places that coincide.
            let mut place =
                || [width, height].map(|size| (size * 4.0 * rng.uniform()).round() / 4.0 - 20.0);
            let points: Vec<(Vec2, Vec2)> = (0..count).map(|_| (place(), place())).collect();
            for (apart_a, apart_b) in [(2.0, 4.0), (0.5, 0.25), (0.0, 0.0), (100.0, 1.0)] {
                assert_eq!(
                    unique_places(&points, apart_a, apart_b),
                    naive(&points, apart_a, apart_b),
                    "{count} {width} {height} {apart_a} {apart_b}"
                );
            }
        }
        let odd = [
            [f64::NAN, 0.0],
            [f64::INFINITY, 1.0],
            [0.0, f64::NEG_INFINITY],
            [1.0, 1.0],
            [1.5, 1.0],
        ]
        .map(|p| (p, p));
        assert_eq!(unique_places(&odd, 2.0, 2.0), naive(&odd, 2.0, 2.0));
    }

    #[test]
    fn blank_places_do_not_count_as_area() {
        let corner = (0..100).map(|i| [f64::from(i % 10), f64::from(i / 10)]);
        assert_eq!(occupied_area(corner, 20.0), 400.0);
    }
}

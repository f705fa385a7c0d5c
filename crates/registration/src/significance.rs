//! How many transforms like this would chance alone produce? (Moisan, Stival, IJCV 2004, the a-contrario test.)
//!
//! Under the hypothesis that the images show different things, each match lands anywhere in the target, independently
//! of the others. The expected number of transforms through 3 of n matches that at least k matches agree with, each by
//! chance with probability p, is at most
//! `NFA(n, k, p) = (n - 3) C(n, k) C(k, 3) p^(k - 3)`.
//! Accepting only `NFA < false_alarms` therefore bounds the expected number of false "found" per registration. The
//! bound needs independent places, so matches are counted on unique places only. It is the bound of that model, not a
//! theorem about real images: how often unrelated ones are found is measured, too.

use scopeservo_geometry::Vec2;

/// Matches that a transform takes to be determined.
const SAMPLE: usize = 3;

/// log10 of the expected number of false alarms. Infinite when `agreeing` does not exceed a minimal sample.
pub fn log10_nfa(matches: usize, agreeing: usize, chance: f64) -> f64 {
    if agreeing <= SAMPLE || matches <= SAMPLE || agreeing > matches {
        return f64::INFINITY;
    }
    let ln = ((matches - SAMPLE) as f64).ln()
        + ln_choose(matches, agreeing)
        + ln_choose(agreeing, SAMPLE)
        + (agreeing - SAMPLE) as f64 * chance.clamp(1e-300, 1.0).ln();
    ln / std::f64::consts::LN_10
}

fn ln_choose(n: usize, k: usize) -> f64 {
    let k = k.min(n - k);
    (0..k).map(|i| ((n - i) as f64 / (i + 1) as f64).ln()).sum()
}

/// Indices of `points` (pairs of places) that are the first of their neighbourhood: no earlier kept one lies within
/// `apart_a` in a or within `apart_b` in b.
pub fn unique_places(points: &[(Vec2, Vec2)], apart_a: f64, apart_b: f64) -> Vec<usize> {
    let mut kept: Vec<usize> = Vec::new();
    for (i, (a, b)) in points.iter().enumerate() {
        let near = |j: &usize| {
            let (ka, kb) = &points[*j];
            close(a, ka, apart_a) || close(b, kb, apart_b)
        };
        if !kept.iter().any(near) {
            kept.push(i);
        }
    }
    kept
}

fn close(p: &Vec2, q: &Vec2, apart: f64) -> bool {
    let d = [p[0] - q[0], p[1] - q[1]];
    d[0] * d[0] + d[1] * d[1] < apart * apart
}

/// The area of the target, px^2, in which keypoints lie at all: matches cannot land on blank glass, so only this counts
/// for chance. Cells of `cell` px with at least one keypoint.
pub fn occupied_area(points: impl Iterator<Item = Vec2>, cell: f64) -> f64 {
    let cells: std::collections::BTreeSet<(i64, i64)> = points
        .map(|p| ((p[0] / cell).floor() as i64, (p[1] / cell).floor() as i64))
        .collect();
    cells.len() as f64 * cell * cell
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_formula_in_the_head_is_what_is_computed() {
        // n = 10, k = 5, p = 0.01: 7 * 252 * 10 * 1e-4.
        let expected = (7.0f64 * 252.0 * 10.0 * 1e-4).log10();
        assert!((log10_nfa(10, 5, 0.01) - expected).abs() < 1e-12);
    }

    #[test]
    fn more_agreement_is_less_by_chance_and_a_bare_sample_proves_nothing() {
        assert_eq!(log10_nfa(100, 3, 1e-4), f64::INFINITY);
        let mut last = f64::INFINITY;
        for k in 6..60 {
            let nfa = log10_nfa(100, k, 1e-4);
            assert!(nfa < last);
            last = nfa;
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
    fn blank_places_do_not_count_as_area() {
        let corner = (0..100).map(|i| [f64::from(i % 10), f64::from(i / 10)]);
        assert_eq!(occupied_area(corner, 20.0), 400.0);
    }
}

//! The comparison of methods, cell by cell: what counts as no worse.

use super::degrade::Condition;
use super::rows::{ByPair, Row, SUCCESS_PX};
use super::scenes::{PairId, ZOOMS};
use super::statistics::{chance_of_losses, holm};
use crate::quantile;
use std::collections::{BTreeMap, BTreeSet};

/// Rows of each method, by pair.
pub type Methods = BTreeMap<String, ByPair>;

/// The peer that must not be better than we are.
pub const PRECISE: &str = "opencv_sift_precise";
/// A median may be larger than the peer's by this factor, or by so many pixels, whichever allows more.
pub(super) const MEDIAN_FACTOR: f64 = 1.1;
pub(super) const MEDIAN_PX: f64 = 0.005;
/// Fewer pairs on which both succeed give no median to compare.
pub(super) const LEAST_PAIRS: usize = 10;
/// A success rate is lower beyond chance when chance gives that less often than this, over all cells.
pub(super) const LEVEL: f64 = 0.05;
/// On a clean pair at 1:1 where OpenCV has so many inliers, we must succeed.
pub(super) const SURE_INLIERS: usize = 30;

/// A zoom and a condition.
pub(super) type CellId = (usize, Condition);

pub(super) fn cells() -> impl Iterator<Item = CellId> {
    ZOOMS
        .into_iter()
        .flat_map(|zoom| Condition::EACH.map(|c| (zoom, c)))
}

pub(super) fn of_cell(
    rows: &ByPair,
    (zoom, condition): CellId,
) -> impl Iterator<Item = (&PairId, &Row)> {
    rows.iter()
        .filter(move |(id, _)| id.scene.zoom == zoom && id.condition == condition)
}

/// The same two images went to every method.
///
/// # Errors
/// Names the first pair whose frames differ.
pub fn check_frames(methods: &Methods) -> Result<(), String> {
    let mut seen: BTreeMap<PairId, &str> = BTreeMap::new();
    for row in methods.values().flat_map(|rows| rows.iter()) {
        let frames = seen.entry(*row.0).or_insert(&row.1.frames);
        if *frames != row.1.frames {
            return Err(format!(
                "{} differs between methods: the renderer changed, so its SET must",
                row.0
            ));
        }
    }
    Ok(())
}

/// What one method did in one cell.
pub(super) struct Figures {
    pub(super) pairs: usize,
    pub(super) successes: usize,
    pub(super) within_half_px: usize,
    /// Of all pairs, a failure being infinitely far off.
    pub(super) median_px: f64,
    pub(super) p90_px: f64,
    /// The farthest answer that it gave.
    pub(super) worst_px: f64,
    /// Answers that were 3 px off or more, and those among them that misled.
    pub(super) rough: usize,
    pub(super) misleading: usize,
    pub(super) inliers: f64,
    pub(super) features: [f64; 2],
}

impl Figures {
    pub(super) fn of<'a>(rows: impl Iterator<Item = &'a Row>) -> Self {
        let rows: Vec<&Row> = rows.collect();
        let errors: Vec<f64> = rows.iter().map(|r| r.error_or_infinite()).collect();
        let count = |limit: f64| errors.iter().filter(|e| **e < limit).count();
        let found: Vec<f64> = errors.iter().copied().filter(|e| e.is_finite()).collect();
        let median =
            |value: fn(&Row) -> usize| middle(rows.iter().map(|r| value(r) as f64).collect());
        Self {
            pairs: rows.len(),
            successes: count(SUCCESS_PX),
            within_half_px: count(0.5),
            median_px: middle(errors.clone()),
            p90_px: quantile(&errors, 0.9),
            worst_px: quantile(&found, 1.0),
            rough: found.iter().filter(|e| **e >= SUCCESS_PX).count(),
            misleading: rows.iter().filter(|r| r.misleading()).count(),
            inliers: median(|r| r.inliers),
            features: [median(|r| r.features[0]), median(|r| r.features[1])],
        }
    }
}

pub(super) fn middle(values: Vec<f64>) -> f64 {
    quantile(&values, 0.5)
}

/// Ours against a peer in one cell.
#[derive(Debug)]
pub(super) struct Comparison {
    pub(super) cell: CellId,
    /// Pairs that both were asked about.
    pub(super) pairs: usize,
    /// Medians where both succeed; `None` when these are too few.
    pub(super) medians_px: Option<[f64; 2]>,
    /// Of these, the share in which ours is nearer.
    pub(super) nearer: f64,
    /// Only the peer succeeds; only ours does.
    pub(super) losses: usize,
    pub(super) wins: usize,
    /// Chance of so many losses, corrected for the number of cells.
    pub(super) chance: f64,
}

impl Comparison {
    pub(super) fn median_holds(&self) -> bool {
        self.medians_px
            .is_none_or(|[ours, peer]| ours <= (peer * MEDIAN_FACTOR).max(peer + MEDIAN_PX))
    }

    pub(super) fn success_holds(&self) -> bool {
        self.chance >= LEVEL
    }

    pub(super) fn holds(&self) -> bool {
        self.median_holds() && self.success_holds()
    }

    pub(super) fn verdict(&self) -> String {
        match (self.median_holds(), self.success_holds()) {
            (true, true) => "pass".into(),
            (false, true) => "**median**".into(),
            (true, false) => "**success**".into(),
            (false, false) => "**median, success**".into(),
        }
    }
}

/// Every cell that both have pairs of.
pub(super) fn compare(ours: &ByPair, peer: &ByPair) -> Vec<Comparison> {
    let mut all: Vec<Comparison> = cells()
        .filter_map(|cell| {
            let both: Vec<(&Row, &Row)> = of_cell(ours, cell)
                .filter_map(|(id, row)| Some((row, peer.get(id)?)))
                .collect();
            if both.is_empty() {
                return None;
            }
            let (mut losses, mut wins) = (0, 0);
            let mut errors: Vec<[f64; 2]> = Vec::new();
            for (our, their) in &both {
                match (our.success(), their.success()) {
                    (true, true) => errors.push([our, their].map(|r| r.error_or_infinite())),
                    (false, true) => losses += 1,
                    (true, false) => wins += 1,
                    (false, false) => {}
                }
            }
            let nearer = errors.iter().filter(|[a, b]| a < b).count() as f64;
            let medians = [0, 1].map(|k| middle(errors.iter().map(|e| e[k]).collect()));
            Some(Comparison {
                cell,
                pairs: both.len(),
                medians_px: (errors.len() >= LEAST_PAIRS).then_some(medians),
                nearer: nearer / errors.len().max(1) as f64,
                losses,
                wins,
                chance: chance_of_losses(losses, wins),
            })
        })
        .collect();
    let corrected = holm(&all.iter().map(|c| c.chance).collect::<Vec<_>>());
    for (comparison, chance) in all.iter_mut().zip(corrected) {
        comparison.chance = chance;
    }
    all
}

/// Clean pairs at 1:1 in which either SIFT of OpenCV has 30 inliers and succeeds, and ours does not; and how many there are.
pub fn sure_pairs_lost(methods: &Methods, ours: &ByPair) -> (Vec<PairId>, usize) {
    let sure: BTreeSet<PairId> = [PRECISE, "opencv_sift"]
        .iter()
        .filter_map(|name| methods.get(*name))
        .flat_map(|rows| of_cell(rows, (1, Condition::Clean)))
        .filter(|(_, row)| row.inliers >= SURE_INLIERS && row.success())
        .map(|(id, _)| *id)
        .filter(|id| ours.contains_key(id))
        .collect();
    let lost = sure.iter().filter(|id| !ours[id].success());
    (lost.copied().collect(), sure.len())
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::rows::{by_method, tests::row};
    use super::*;

    pub(in super::super) fn cell(method: &str, errors_px: &[f64]) -> Vec<Row> {
        let pair = |k| format!("1-clean-{k:03}");
        let rows = errors_px.iter().enumerate();
        rows.map(|(k, e)| row(&pair(k), method, *e)).collect()
    }

    pub(in super::super) fn methods(ours: &[f64], precise: &[f64]) -> Methods {
        by_method([cell("2000", ours), cell(PRECISE, precise)].concat())
    }

    #[test]
    fn a_median_may_be_worse_by_a_tenth_or_five_thousandths() {
        let holds = |ours: f64, peer: f64| {
            let m = methods(&[ours; 12], &[peer; 12]);
            compare(&m["2000"], &m[PRECISE])[0].median_holds()
        };
        assert!(holds(0.0149, 0.010) && !holds(0.0151, 0.010));
        assert!(holds(0.109, 0.1) && !holds(0.111, 0.1));
    }

    #[test]
    fn failures_that_chance_does_not_explain_are_seen() {
        let all = [0.1; 20];
        for (failures, holds) in [(4, true), (5, false)] {
            let mut ours = all;
            ours[..failures].fill(f64::INFINITY);
            let m = methods(&ours, &all);
            let c = &compare(&m["2000"], &m[PRECISE])[0];
            assert_eq!((c.losses, c.wins), (failures, 0));
            // One cell: nothing to correct. 1/16 and 1/32.
            assert_eq!(c.success_holds(), holds, "{c:?}");
        }
    }

    #[test]
    fn a_failure_counts_as_infinitely_far_off() {
        let rows = cell("2000", &[0.1, 0.2, f64::INFINITY, 5.0, f64::INFINITY]);
        let f = Figures::of(rows.iter());
        assert_eq!(
            (f.pairs, f.successes, f.within_half_px, f.rough),
            (5, 2, 2, 1)
        );
        assert_eq!(
            (f.median_px, f.p90_px, f.worst_px),
            (5.0, f64::INFINITY, 5.0)
        );
    }

    #[test]
    fn other_frames_are_noticed() {
        let mut m = methods(&[0.1], &[0.1]);
        check_frames(&m).unwrap();
        let rows = m.get_mut(PRECISE).unwrap();
        rows.values_mut().next().unwrap().frames = "other".into();
        assert!(check_frames(&m).unwrap_err().contains("1-clean-000"));
    }
}

//! The order of extrema: the strongest, each once, and where what was made of them lies.

use std::ops::Range;

use super::workspace::Portion;
use crate::detect::Extremum;

/// The `most` strongest of what was found, the strongest first, each once.
pub(super) fn choose(found: &mut Vec<Extremum>, most: usize) {
    // Only what a fit has moved to may be there already.
    let moved = found.iter().filter(|e| e.moved).count();
    let enough = most.saturating_add(moved);
    if found.len() > enough {
        found.select_nth_unstable_by(enough, Extremum::rank);
        found.truncate(enough);
    }
    found.sort_unstable_by(Extremum::rank);
    found.dedup_by_key(|e| (e.octave, e.layer, e.sample));
    found.truncate(most);
}

/// Numbers what was made `ahead` as `found` does, in which extrema may have come in between; what is no longer there is dropped.
/// Returns after which rank nothing is done.
pub(super) fn rank_again(
    ahead: &[Extremum],
    done: &mut [Portion],
    found: &[Extremum],
    is_done: &mut [bool],
) -> usize {
    let mut next = 0;
    let ranks: Vec<Option<usize>> = (ahead.iter())
        .map(|e| {
            next += found[next..]
                .iter()
                .take_while(|f| f.rank(e).is_lt())
                .count();
            (found.get(next) == Some(e)).then_some(next)
        })
        .collect();
    for portion in done {
        for (rank, _) in &mut portion.keypoints {
            *rank = ranks[*rank].unwrap_or(usize::MAX);
        }
    }
    for rank in ranks.iter().flatten() {
        is_done[*rank] = true;
    }
    ranks.iter().flatten().last().map_or(0, |last| last + 1)
}

/// Where the keypoints of the extrema `ranks` are, portion and place in it, in order of strength.
pub(super) fn by_rank(made: &[&Portion], ranks: Range<usize>) -> Vec<(usize, usize)> {
    let places = || {
        made.iter().enumerate().flat_map(|(p, portion)| {
            let places = portion.keypoints.iter().enumerate();
            places.map(move |(i, (rank, _))| (*rank, (p, i)))
        })
    };
    // How many keypoints come before those of each extremum.
    let mut before = vec![0; ranks.len() + 1];
    for (rank, _) in places().filter(|(rank, _)| ranks.contains(rank)) {
        before[rank - ranks.start + 1] += 1;
    }
    for i in 0..ranks.len() {
        before[i + 1] += before[i];
    }
    let mut order = vec![(0, 0); before[ranks.len()]];
    for (rank, place) in places().filter(|(rank, _)| ranks.contains(rank)) {
        let next = &mut before[rank - ranks.start];
        order[*next] = place;
        *next += 1;
    }
    order
}

/// Neighbours in the image one after the other, which is kinder to the caches than order of strength.
pub(super) fn walk(found: &[Extremum], ranks: impl Iterator<Item = usize>) -> Vec<usize> {
    let place = |rank: usize| {
        let e = &found[rank];
        let layer = (e.octave + 1) as usize * 16 + e.layer;
        (packed([layer, e.y as usize / 32, e.x as usize]), rank)
    };
    let mut walk: Vec<(u64, usize)> = ranks.map(place).collect();
    walk.sort_unstable();
    walk.into_iter().map(|(_, rank)| rank).collect()
}

/// Layer, row and column in one number, in order: sides have fewer than 2^24 pixels.
fn packed([layer, y, x]: [usize; 3]) -> u64 {
    (layer as u64) << 48 | (y as u64) << 24 | x as u64
}

//! Exact nearest neighbours between two sets of features, with the ratio test (Lowe, IJCV 2004, section 7.1) and the mutual test.
//!
//! Every pair is looked at once: `|a - b|^2 = |a|^2 + |b|^2 - 2 a b` in integers, so the result is exact. The same pass finds the
//! nearest two of each query and the nearest of each train feature. Of equal distances the lowest index wins.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::{Descriptor, Features, Keypoint};

/// Query features per parallel task; their nearest of each train feature are merged afterwards.
const TASK: usize = 128;

/// Train features per block: 32 KiB of 16-bit components, which stay in the first cache while the queries pass.
const BLOCK: usize = 64;

/// A pair of features that are each other's likely image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Match {
    /// Index in the query features.
    pub query: usize,
    /// Index in the train features.
    pub train: usize,
    /// Squared distance of the two descriptors.
    pub distance_sq: u32,
    /// Squared distance of the query to its second nearest train feature; `u32::MAX` when there is none.
    pub second_sq: u32,
}

/// Which nearest neighbours to believe.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MatchOptions {
    /// The nearest must be nearer than this times the second nearest (distances, not squares). A query with a single candidate
    /// passes.
    pub ratio: f32,
    /// The query must also be the nearest of the train feature.
    pub mutual: bool,
}

impl Default for MatchOptions {
    fn default() -> Self {
        Self {
            ratio: 0.8,
            mutual: true,
        }
    }
}

/// Exact brute force: the two nearest train features of each query, then the ratio and mutual tests. Matches are in order of
/// query. Cost: `query.len() * train.len()` products of 128 bytes.
#[must_use]
pub fn match_features(query: &Features, train: &Features, options: &MatchOptions) -> Vec<Match> {
    search::<false>(query, train, options, |_, _| true)
}

/// As [`match_features`], over only those pairs which `admissible(query_keypoint, train_keypoint)` lets through: nearest, second
/// nearest and mutual test see no other pair.
#[must_use]
pub fn match_features_gated(
    query: &Features,
    train: &Features,
    options: &MatchOptions,
    admissible: impl Fn(&Keypoint, &Keypoint) -> bool + Sync,
) -> Vec<Match> {
    search::<true>(query, train, options, admissible)
}

/// Descriptors as 16-bit numbers, whose products processors add in pairs, with their squared lengths.
struct Wide {
    components: Vec<[i16; 128]>,
    norms: Vec<i32>,
}

impl Wide {
    fn of(descriptors: &[Descriptor]) -> Self {
        let components: Vec<[i16; 128]> = descriptors.iter().map(|d| d.0.map(i16::from)).collect();
        let norms = components.iter().map(|c| dot(c, c)).collect();
        Self { components, norms }
    }
}

/// At most 128 * 255^2, far inside the range. Eight sums side by side become the multiply-add that processors have for 16-bit
/// numbers: 24 ms for 2000 x 2000 against 55 ms for a plain `sum()`.
#[inline(always)]
fn dot(a: &[i16; 128], b: &[i16; 128]) -> i32 {
    let mut sums = [0_i32; 8];
    for (a, b) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        for k in 0..8 {
            sums[k] += i32::from(a[k]) * i32::from(b[k]);
        }
    }
    sums.iter().sum()
}

/// Products of one descriptor with some others. A function of its own: inlined into the search it is not vectorised, which takes
/// ten times as long.
#[inline(never)]
fn dots(a: &[i16; 128], others: &[[i16; 128]], picks: &[usize], out: &mut [i32; BLOCK]) {
    for (out, &j) in out.iter_mut().zip(picks) {
        *out = dot(a, &others[j]);
    }
}

/// Nearest and second nearest so far; index `usize::MAX` when none.
#[derive(Clone, Copy)]
struct Nearest {
    index: usize,
    first_sq: u32,
    second_sq: u32,
}

impl Nearest {
    const NONE: Self = Self {
        index: usize::MAX,
        first_sq: u32::MAX,
        second_sq: u32::MAX,
    };

    /// Candidates come in order of their index, so a tie keeps the lowest.
    #[inline(always)]
    fn see(&mut self, index: usize, distance_sq: u32) {
        if distance_sq < self.second_sq {
            if distance_sq < self.first_sq {
                *self = Self {
                    index,
                    first_sq: distance_sq,
                    second_sq: self.first_sq,
                };
            } else {
                self.second_sq = distance_sq;
            }
        }
    }
}

/// Nearest query of a train feature so far.
#[derive(Clone, Copy)]
struct Back {
    index: usize,
    distance_sq: u32,
}

impl Back {
    const NONE: Self = Self {
        index: usize::MAX,
        distance_sq: u32::MAX,
    };

    #[inline(always)]
    fn see(&mut self, index: usize, distance_sq: u32) {
        if distance_sq < self.distance_sq {
            *self = Self { index, distance_sq };
        }
    }
}

/// What some of the queries found: their nearest train features, and for each train feature the nearest of them.
struct Task {
    nearest: Vec<Nearest>,
    back: Vec<Back>,
}

fn search<const GATED: bool>(
    query: &Features,
    train: &Features,
    options: &MatchOptions,
    admissible: impl Fn(&Keypoint, &Keypoint) -> bool + Sync,
) -> Vec<Match> {
    let (q, t) = (Wide::of(&query.descriptors), Wide::of(&train.descriptors));
    let tasks: Vec<Task> = (0..q.norms.len().div_ceil(TASK))
        .into_par_iter()
        .map(|task| {
            let queries = task * TASK..(task * TASK + TASK).min(q.norms.len());
            let mut nearest = vec![Nearest::NONE; queries.len()];
            let mut back = vec![Back::NONE; t.norms.len()];
            for block in (0..t.norms.len()).step_by(BLOCK) {
                let trains = block..(block + BLOCK).min(t.norms.len());
                let mut picks: [usize; BLOCK] = std::array::from_fn(|k| block + k);
                let mut products = [0; BLOCK];
                let mut count = trains.len();
                for (i, nearest) in queries.clone().zip(&mut nearest) {
                    if GATED {
                        count = 0;
                        for j in trains.clone() {
                            picks[count] = j;
                            count +=
                                usize::from(admissible(&query.keypoints[i], &train.keypoints[j]));
                        }
                    }
                    let picks = &picks[..count];
                    dots(&q.components[i], &t.components, picks, &mut products);
                    for (&j, product) in picks.iter().zip(products) {
                        let distance_sq = (q.norms[i] + t.norms[j] - 2 * product) as u32;
                        nearest.see(j, distance_sq);
                        back[j].see(i, distance_sq);
                    }
                }
            }
            Task { nearest, back }
        })
        .collect();

    let mut back = vec![Back::NONE; t.norms.len()];
    for task in &tasks {
        for (back, new) in back.iter_mut().zip(&task.back) {
            back.see(new.index, new.distance_sq);
        }
    }
    let ratio_sq = f64::from(options.ratio).max(0.0).powi(2);
    tasks
        .iter()
        .flat_map(|task| &task.nearest)
        .enumerate()
        .filter_map(|(query, n)| {
            let found = n.index != usize::MAX;
            let alone = n.second_sq == u32::MAX;
            let distinct = alone || f64::from(n.first_sq) < ratio_sq * f64::from(n.second_sq);
            let mutual = found && (!options.mutual || back[n.index].index == query);
            (found && distinct && mutual).then_some(Match {
                query,
                train: n.index,
                distance_sq: n.first_sq,
                second_sq: n.second_sq,
            })
        })
        .collect()
}

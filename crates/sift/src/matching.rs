//! Exact nearest neighbours between two sets of features, with the ratio test (Lowe, IJCV 2004, section 7.1) and the mutual test.
//!
//! Every pair is looked at once: `|a - b|^2 = |a|^2 + |b|^2 - 2 a b` in integers, so the result is exact. The same pass finds the
//! nearest two of each query and the nearest query of each train feature. Of equal distances the lowest index wins.
//!
//! `scalar` follows these words; `packed` does the same with vectors.

mod dots;
mod gate;
mod nearest;
mod packed;
mod scalar;

pub use gate::Gate;

use serde::{Deserialize, Serialize};

use self::nearest::{Found, NOTHING, Nearest};
use crate::simd::Token;
use crate::{Features, Simd};

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
    match_features_gated(query, train, options, &Gate::default())
}

/// As [`match_features`], over only those pairs which `gate` admits. The narrower the gate, the less it costs.
#[must_use]
pub fn match_features_gated(
    query: &Features,
    train: &Features,
    options: &MatchOptions,
    gate: &Gate,
) -> Vec<Match> {
    match_features_at(Simd::best(), query, train, options, gate)
}

/// As [`match_features_gated`], with a certain instruction set. All give the same.
#[must_use]
pub fn match_features_at(
    simd: Simd,
    query: &Features,
    train: &Features,
    options: &MatchOptions,
    gate: &Gate,
) -> Vec<Match> {
    let found = search(simd, query, train, gate, packed::CHUNK);
    let ratio_sq = f64::from(options.ratio).max(0.0).powi(2);
    let matched = |(query, n): (usize, &Nearest)| {
        let alone = n.second_sq == u32::MAX;
        let distinct = alone || f64::from(n.first_sq) < ratio_sq * f64::from(n.second_sq);
        let mutual = || !options.mutual || found.backward[n.index].1 == query;
        (n.index != NOTHING && distinct && mutual()).then_some(Match {
            query,
            train: n.index,
            distance_sq: n.first_sq,
            second_sq: n.second_sq,
        })
    };
    found
        .forward
        .iter()
        .enumerate()
        .filter_map(matched)
        .collect()
}

/// `chunk` bounds the features on a side that the kernels take at a time.
fn search(simd: Simd, query: &Features, train: &Features, gate: &Gate, chunk: usize) -> Found {
    match simd.0 {
        Token::Scalar(_) => scalar::search(query, train, gate),
        #[cfg(target_arch = "x86_64")]
        Token::Avx2(s) => match dots::AvxVnni::detect(s) {
            Some(d) => packed::search::<_, 6, 2>(d, query, train, gate, chunk),
            None => packed::search::<_, 6, 2>(s, query, train, gate, chunk),
        },
        #[cfg(target_arch = "x86_64")]
        Token::Avx512(s) => packed::search::<_, 8, 2>(s, query, train, gate, chunk),
        #[cfg(target_arch = "aarch64")]
        Token::Neon(s) => packed::search::<_, 4, 2>(s, query, train, gate, chunk),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Descriptor, Keypoint};

    /// Small enough for an interpreter: this is the test that runs under Miri.
    fn features(mut seed: u32, n: usize) -> Features {
        let mut next = |below: u32| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 16) % below
        };
        let keypoints = (0..n)
            .map(|_| Keypoint {
                x: 0.0,
                y: 0.0,
                sigma: 1.0 + 0.1 * next(30) as f32,
                angle: 0.1 * next(60) as f32 - 3.0,
                response: 0.1,
                bright: next(3) > 0,
                octave: 0,
                layer: 1,
            })
            .collect();
        // Every third is one of two, and as long as can be.
        let mut descriptor = |i: usize| {
            let which = next(2) as usize;
            Descriptor::new(std::array::from_fn(|k| match (i % 3, k % 64) {
                (0, 40..42) if k / 64 == which => 127,
                (0, 60) => 127,
                (0, _) => 0,
                _ => next(32) as u8,
            }))
        };
        let descriptors = (0..n).map(|i| descriptor(i).unwrap()).collect();
        Features {
            width: 1,
            height: 1,
            keypoints,
            descriptors,
        }
    }

    fn kernels_equal_the_scalar_search(gate: Gate) {
        // Miri knows neither the casts of rayon's queues nor haste: no threads, and little more than one block of each kernel.
        let here = rayon::ThreadPoolBuilder::new().num_threads(1);
        let _here = here.use_current_thread().build_global();
        let (query, train) = (features(1, 9), features(2, 33));
        let scalar = Simd::at(crate::Level::Scalar).unwrap();
        let expected = search(scalar, &query, &train, &gate, packed::CHUNK);
        for simd in Simd::available() {
            for chunk in [packed::CHUNK, 20] {
                let found = search(simd, &query, &train, &gate, chunk);
                assert_eq!(found, expected, "{}, {chunk}", simd.level());
            }
        }
    }

    #[test]
    fn kernels_equal_the_scalar_search_in_one_piece_or_many() {
        kernels_equal_the_scalar_search(Gate::default());
        kernels_equal_the_scalar_search(Gate {
            same_polarity: true,
            ..Gate::default()
        });
    }

    #[test]
    #[cfg_attr(
        all(miri, target_feature = "avx512f"),
        ignore = "Miri does not know how AVX-512 compares floats"
    )]
    fn kernels_equal_the_scalar_search_behind_a_gate() {
        kernels_equal_the_scalar_search(Gate {
            sigma_ratio: Some((0.7, 1.5)),
            turn_rad: Some((3.0, 1.0)),
            same_polarity: true,
        });
    }
}

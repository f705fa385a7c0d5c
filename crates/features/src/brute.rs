//! Exact matching of any descriptors, pair by pair.

use crate::{FeatureError, Features, Gate, Match, MatchOptions};

/// For each feature of `query` its nearest in `train` among the pairs that the gate admits, with the ratio test and the mutual test (Lowe,
/// IJCV 2004, section 7.1). Of equal distances the lowest index wins.
///
/// Cost: a distance for each pair.
///
/// # Errors
/// [`FeatureError::OtherEngine`] when the two cannot be compared.
pub fn match_brute_force(
    query: &Features,
    train: &Features,
    options: &MatchOptions,
    gate: &Gate,
) -> Result<Vec<Match>, FeatureError> {
    query.comparable(train)?;
    let mut nearest_of_train = vec![(u32::MAX, usize::MAX); train.len()];
    let mut found = Vec::with_capacity(query.len());
    for (i, q) in query.keypoints.iter().enumerate() {
        let mut nearest = (u32::MAX, usize::MAX);
        let mut second_sq = u32::MAX;
        for (j, t) in train.keypoints.iter().enumerate() {
            if !gate.admits(q, t) {
                continue;
            }
            let Some(distance_sq) = query.descriptors.distance_sq(i, &train.descriptors, j) else {
                continue;
            };
            nearest_of_train[j] = nearest_of_train[j].min((distance_sq, i));
            if distance_sq < nearest.0 {
                second_sq = nearest.0;
                nearest = (distance_sq, j);
            } else {
                second_sq = second_sq.min(distance_sq);
            }
        }
        found.push((nearest, second_sq));
    }
    let ratio_sq = f64::from(options.ratio).max(0.0).powi(2);
    let matched = found
        .into_iter()
        .enumerate()
        .filter_map(|(query, (nearest, second_sq))| {
            let (distance_sq, train) = nearest;
            let alone = second_sq == u32::MAX;
            let distinct = alone || f64::from(distance_sq) < ratio_sq * f64::from(second_sq);
            let mutual = || !options.mutual || nearest_of_train[train].1 == query;
            (train != usize::MAX && distinct && mutual()).then_some(Match {
                query,
                train,
                distance_sq,
                second_sq,
            })
        });
    Ok(matched.collect())
}

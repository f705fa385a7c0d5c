//! Matches against a search that follows the definition word by word.

mod common;

use common::Random;
use scopeservo_sift::{
    Descriptor, Features, Keypoint, Match, MatchOptions, match_features, match_features_gated,
};

/// `n` keypoints with descriptors of few distinct values, so that ties are frequent; `levels` up to 256.
fn random(seed: u64, n: usize, levels: f64) -> Features {
    let mut r = Random(seed);
    let keypoints = (0..n)
        .map(|_| Keypoint {
            x: r.range(0.0, 99.0) as f32,
            y: r.range(0.0, 99.0) as f32,
            sigma: 2.0,
            angle: 0.0,
            response: 0.1,
            octave: 0,
            layer: 1,
        })
        .collect();
    let step = 255.0 / (levels - 1.0);
    let descriptors = (0..n)
        .map(|_| {
            let used = if levels < 3.0 { 4 } else { 128 };
            Descriptor(std::array::from_fn(|i| {
                if i < used {
                    ((r.unit() * levels).floor() * step) as u8
                } else {
                    0
                }
            }))
        })
        .collect();
    Features {
        width: 100,
        height: 100,
        keypoints,
        descriptors,
    }
}

fn distance_sq(a: &Descriptor, b: &Descriptor) -> u32 {
    a.0.iter()
        .zip(&b.0)
        .map(|(&a, &b)| (i32::from(a) - i32::from(b)).pow(2) as u32)
        .sum()
}

fn naive(
    a: &Features,
    b: &Features,
    options: &MatchOptions,
    gate: impl Fn(&Keypoint, &Keypoint) -> bool,
) -> Vec<Match> {
    let distance = |i: usize, j: usize| {
        gate(&a.keypoints[i], &b.keypoints[j])
            .then(|| distance_sq(&a.descriptors[i], &b.descriptors[j]))
    };
    (0..a.len())
        .filter_map(|i| {
            let mut ranked: Vec<(u32, usize)> = (0..b.len())
                .filter_map(|j| Some((distance(i, j)?, j)))
                .collect();
            ranked.sort();
            let &(first, j) = ranked.first()?;
            let second = ranked.get(1).map(|r| r.0);
            let back = (0..a.len())
                .filter_map(|i| Some((distance(i, j)?, i)))
                .min()?
                .1;
            let ratio_sq = f64::from(options.ratio).powi(2);
            let distinct = second.is_none_or(|s| f64::from(first) < ratio_sq * f64::from(s));
            (distinct && (!options.mutual || back == i)).then_some(Match {
                query: i,
                train: j,
                distance_sq: first,
                second_sq: second.unwrap_or(u32::MAX),
            })
        })
        .collect()
}

#[test]
fn equals_the_definition() {
    let mut total = 0;
    for (n, m) in [
        (0, 5),
        (5, 0),
        (1, 1),
        (3, 1),
        (1, 3),
        (63, 65),
        (128, 64),
        (129, 200),
        (300, 257),
    ] {
        for levels in [2.0, 3.0, 256.0] {
            let (a, b) = (
                random(n as u64 + 1, n, levels),
                random(m as u64 + 1000, m, levels),
            );
            for ratio in [0.0, 0.8, 0.97, 1.0, 2.0] {
                for mutual in [true, false] {
                    let options = MatchOptions { ratio, mutual };
                    let found = match_features(&a, &b, &options);
                    assert_eq!(
                        found,
                        naive(&a, &b, &options, |_, _| true),
                        "{n} x {m}, {levels} levels, {options:?}"
                    );
                    total += found.len();
                    for reach in [0.0, 4.0, 20.0] {
                        let gate =
                            |p: &Keypoint, q: &Keypoint| (p.x - q.x).hypot(p.y - q.y) < reach;
                        let found = match_features_gated(&a, &b, &options, gate);
                        assert_eq!(
                            found,
                            naive(&a, &b, &options, gate),
                            "{n} x {m}, gate {reach}, {options:?}"
                        );
                    }
                }
            }
        }
    }
    assert!(total > 1000, "{total}");
}

#[test]
fn extreme_descriptors_do_not_overflow() {
    let with = |v: u8| Features {
        descriptors: vec![Descriptor([v; 128])],
        ..random(1, 1, 2.0)
    };
    let m = match_features(&with(0), &with(255), &MatchOptions::default());
    assert_eq!(
        m,
        [Match {
            query: 0,
            train: 0,
            distance_sq: 128 * 255 * 255,
            second_sq: u32::MAX
        }]
    );
    assert_eq!(
        match_features(&with(255), &with(255), &MatchOptions::default())[0].distance_sq,
        0
    );
}

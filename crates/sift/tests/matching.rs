//! Matches at every level against a search that follows the definition word by word.

mod common;

use std::f32::consts::PI;

use common::Random;
use scopeservo_sift::{
    Descriptor, Features, Gate, Keypoint, Match, MatchOptions, Simd, match_features,
    match_features_at, match_features_gated,
};

/// `n` keypoints of any sigma from 1 to 16 and any angle, with descriptors of few distinct values, so that ties are frequent, or
/// of all values from 0 to 31.
fn random(seed: u64, n: usize, ties: bool) -> Features {
    let mut r = Random(seed);
    let keypoints = (0..n)
        .map(|_| Keypoint {
            x: r.range(0.0, 99.0) as f32,
            y: r.range(0.0, 99.0) as f32,
            sigma: r.range(0.0, 4.0).exp2() as f32,
            angle: r.range(-std::f64::consts::PI, std::f64::consts::PI) as f32,
            response: 0.1,
            bright: r.unit() < 0.6,
            octave: 0,
            layer: 1,
        })
        .collect();
    let mut component = |i: usize| match ties {
        true if !i.is_multiple_of(32) => 0,
        true => 127 * (r.unit() * 2.0) as u8,
        false => (r.unit() * 32.0) as u8,
    };
    let descriptors = (0..n)
        .map(|_| Descriptor::new(std::array::from_fn(&mut component)).unwrap())
        .collect();
    Features {
        width: 100,
        height: 100,
        keypoints,
        descriptors,
    }
}

fn distance_sq(a: &Descriptor, b: &Descriptor) -> i64 {
    let difference = |(&a, &b): (&u8, &u8)| i64::from(a) - i64::from(b);
    let pairs = a.components().iter().zip(b.components());
    pairs.map(|p| difference(p).pow(2)).sum()
}

/// In f64, where rounding plays no part for the values tested.
fn admits(gate: &Gate, query: &Keypoint, train: &Keypoint) -> bool {
    let (q, t) = (query, train);
    let in_scale = gate.sigma_ratio.is_none_or(|(least, most)| {
        let ratio = f64::from(t.sigma) / f64::from(q.sigma);
        f64::from(least) < ratio && ratio < f64::from(most)
    });
    let turned = gate.turn_rad.is_none_or(|(turn, off)| {
        let d = f64::from(t.angle) - f64::from(q.angle) - f64::from(turn);
        d.sin().atan2(d.cos()).abs() < f64::from(off)
    });
    let alike = !gate.same_polarity || q.bright == t.bright;
    in_scale && turned && alike
}

fn naive(a: &Features, b: &Features, options: &MatchOptions, gate: &Gate) -> Vec<Match> {
    let distances: Vec<Vec<Option<i64>>> = (0..a.len())
        .map(|i| {
            (0..b.len())
                .map(|j| {
                    admits(gate, &a.keypoints[i], &b.keypoints[j])
                        .then(|| distance_sq(&a.descriptors[i], &b.descriptors[j]))
                })
                .collect()
        })
        .collect();
    (0..a.len())
        .filter_map(|i| {
            let mut ranked: Vec<(i64, usize)> = (0..b.len())
                .filter_map(|j| Some((distances[i][j]?, j)))
                .collect();
            ranked.sort();
            let &(first, j) = ranked.first()?;
            let second = ranked.get(1).map(|r| r.0);
            let back = (0..a.len())
                .filter_map(|i| Some((distances[i][j]?, i)))
                .min()?
                .1;
            let ratio_sq = f64::from(options.ratio).powi(2);
            let distinct = second.is_none_or(|s| (first as f64) < ratio_sq * s as f64);
            (distinct && (!options.mutual || back == i)).then_some(Match {
                query: i,
                train: j,
                distance_sq: first as u32,
                second_sq: second.map_or(u32::MAX, |s| s as u32),
            })
        })
        .collect()
}

/// Everything that can be found, without a test and with each.
const OPTIONS: [MatchOptions; 4] = [
    MatchOptions {
        ratio: f32::INFINITY,
        mutual: false,
    },
    MatchOptions {
        ratio: f32::INFINITY,
        mutual: true,
    },
    MatchOptions {
        ratio: 0.97,
        mutual: true,
    },
    MatchOptions {
        ratio: 0.0,
        mutual: false,
    },
];

fn gates() -> [Gate; 8] {
    let gate = |sigma_ratio, turn_rad| Gate {
        sigma_ratio,
        turn_rad,
        same_polarity: false,
    };
    let same_polarity = |gate| Gate {
        same_polarity: true,
        ..gate
    };
    [
        Gate::default(),
        gate(Some((0.6, 1.7)), None),
        gate(None, Some((0.3, 0.5))),
        gate(Some((2.0, 9.0)), Some((PI - 0.1, 0.7))),
        gate(Some((0.0, f32::INFINITY)), Some((-3.0 * PI, 2.5))),
        gate(Some((0.1, 0.2)), Some((-2.0, 0.05))),
        same_polarity(Gate::default()),
        same_polarity(gate(Some((0.6, 1.7)), Some((0.3, 0.9)))),
    ]
}

/// The number of matches, the same at every level as by definition.
fn check(a: &Features, b: &Features, options: &[MatchOptions], gates: &[Gate]) -> usize {
    let mut total = 0;
    for gate in gates {
        for options in options {
            let expected = naive(a, b, options, gate);
            for simd in Simd::available() {
                let found = match_features_at(simd, a, b, options, gate);
                let (n, m, level) = (a.len(), b.len(), simd.level());
                assert_eq!(found, expected, "{n} x {m}, {level}, {options:?}, {gate:?}");
            }
            total += expected.len();
        }
    }
    total
}

#[test]
fn equals_the_definition_for_every_tail() {
    let mut total = 0;
    for n in 0..=70 {
        let (a, b) = (random(1, n, n % 2 == 0), random(2, 70, n % 2 == 0));
        total += check(&a, &b, &OPTIONS[..2], &gates()[..1]);
        total += check(&b, &a, &OPTIONS[..2], &gates()[..1]);
    }
    assert!(total > 3000, "{total}");
}

#[test]
fn equals_the_definition_with_every_option_and_gate() {
    let mut total = 0;
    for (n, m) in [
        (0, 5),
        (5, 0),
        (1, 1),
        (3, 1),
        (1, 3),
        (31, 33),
        (64, 130),
        (129, 200),
        (600, 557),
    ] {
        for ties in [true, false] {
            let (a, b) = (random(n as u64, n, ties), random(1000, m, ties));
            total += check(&a, &b, &OPTIONS, &gates());
        }
    }
    assert!(total > 3000, "{total}");
}

#[test]
fn many_equal_features_give_the_lowest_index_whatever_their_size_and_angle() {
    let mut a = random(1, 90, true);
    let mut b = random(2, 150, true);
    // Not at distance 0, which no ratio lets pass twice.
    a.descriptors.fill(Descriptor::new([9; 128]).unwrap());
    b.descriptors.fill(Descriptor::new([10; 128]).unwrap());
    assert!(check(&a, &b, &OPTIONS, &gates()) > 0);
    let options = MatchOptions {
        ratio: f32::INFINITY,
        mutual: true,
    };
    let found = match_features(&a, &b, &options);
    assert_eq!((found.len(), found[0].query, found[0].train), (1, 0, 0));
}

/// The longest descriptors and those with the largest components, whose products come next to 2^16 in one pair of components or
/// spread over all.
#[test]
fn the_largest_products_lose_no_carry() {
    let at = |from: usize, step: usize, v: [u8; 8]| {
        let mut components = [0; 128];
        for (k, v) in v.into_iter().enumerate() {
            components[(from + k * step) % 128] = v;
        }
        Descriptor::new(components).unwrap()
    };
    let longest = [127, 127, 127, 127, 31, 7, 3, 0];
    assert_eq!(at(0, 1, longest).norm_sq(), Descriptor::MAX_NORM_SQ);
    let mut descriptors = vec![
        Descriptor::ZERO,
        Descriptor::new([22; 128]).unwrap(),
        Descriptor::new(std::array::from_fn(|i| if i % 2 == 0 { 31 } else { 0 })).unwrap(),
        Descriptor::new(std::array::from_fn(|i| if i % 4 == 1 { 45 } else { 0 })).unwrap(),
    ];
    for from in 0..8 {
        for step in [1, 2, 4, 8, 16] {
            descriptors.push(at(from, step, longest));
            descriptors.push(at(from, step, [127, 0, 127, 0, 127, 0, 127, 0]));
        }
    }
    let features = |reverse: bool| {
        let mut descriptors = descriptors.clone();
        if reverse {
            descriptors.reverse();
        }
        Features {
            descriptors,
            ..random(1, 84, true)
        }
    };
    check(&features(false), &features(true), &OPTIONS, &gates());
    // The farthest that two can be.
    let one = |d: Descriptor| Features {
        descriptors: vec![d],
        ..random(1, 1, true)
    };
    let (a, b) = (one(at(0, 1, longest)), one(at(64, 1, longest)));
    for simd in Simd::available() {
        let options = MatchOptions::default();
        let found = match_features_at(simd, &a, &b, &options, &Gate::default());
        let expected = Match {
            query: 0,
            train: 0,
            distance_sq: 2 * 65535,
            second_sq: u32::MAX,
        };
        assert_eq!(found, [expected], "{}", simd.level());
    }
}

#[test]
fn angles_wrap_and_bounds_are_exclusive() {
    let one = |sigma: f32, angle: f32| {
        let mut features = random(1, 1, true);
        (features.keypoints[0].sigma, features.keypoints[0].angle) = (sigma, angle);
        features
    };
    let turn = |turn: f32, off: f32| Gate {
        turn_rad: Some((turn, off)),
        ..Gate::default()
    };
    let ratio = |least: f32, most: f32| Gate {
        sigma_ratio: Some((least, most)),
        ..Gate::default()
    };
    for (query, train, gate, expected) in [
        ((1.0, 3.1), (1.0, -3.1), turn(0.0, 0.1), true),
        ((1.0, -3.1), (1.0, 3.1), turn(0.0, 0.1), true),
        ((1.0, 3.1), (1.0, -3.1), turn(0.0, 0.08), false),
        ((1.0, 3.0), (1.0, -3.0), turn(3.0, 0.5), false),
        ((1.0, 3.0), (1.0, -0.2), turn(3.0, 0.2), true),
        // Angles beyond pi and whole turns in the gate.
        (
            (1.0, 9.0),
            (1.0, 9.0 - 4.0 * PI),
            turn(2.0 * PI, 0.01),
            true,
        ),
        ((1.0, 0.5), (1.0, 1.0), turn(0.0, 0.5), false),
        ((1.0, 0.0), (1.0, PI), turn(0.0, 3.2), true),
        ((1.0, 0.0), (1.0, 0.0), turn(0.0, 0.0), false),
        ((2.0, 0.0), (4.0, 0.0), ratio(1.0, 2.0), false),
        ((2.0, 0.0), (4.0, 0.0), ratio(2.0, 3.0), false),
        ((2.0, 0.0), (4.0, 0.0), ratio(1.9, 2.1), true),
        (
            (f32::NAN, 0.0),
            (4.0, 0.0),
            ratio(0.0, f32::INFINITY),
            false,
        ),
        (
            (2.0, 0.0),
            (f32::NAN, 0.0),
            ratio(0.0, f32::INFINITY),
            false,
        ),
        ((2.0, f32::NAN), (2.0, 0.0), turn(0.0, 9.0), false),
        (
            (f32::NAN, f32::NAN),
            (f32::NAN, f32::NAN),
            Gate::default(),
            true,
        ),
    ] {
        let (a, b) = (one(query.0, query.1), one(train.0, train.1));
        let case = format!("{query:?} {train:?} {gate:?}");
        assert_eq!(
            gate.admits(&a.keypoints[0], &b.keypoints[0]),
            expected,
            "{case}"
        );
        for simd in Simd::available() {
            let found = match_features_at(simd, &a, &b, &MatchOptions::default(), &gate);
            assert_eq!(!found.is_empty(), expected, "{case}, {}", simd.level());
        }
    }
}

#[test]
fn damaged_keypoints_hide_no_others() {
    let (mut a, mut b) = (random(1, 300, false), random(2, 300, false));
    for k in a.keypoints.iter_mut().chain(&mut b.keypoints).step_by(7) {
        k.sigma = f32::NAN;
    }
    for k in a.keypoints.iter_mut().chain(&mut b.keypoints).step_by(11) {
        k.angle = -f32::NAN;
    }
    for gate in gates() {
        check(&a, &b, &OPTIONS[..2], &[gate]);
    }
}

#[test]
fn the_same_on_any_number_of_threads() {
    let (a, b) = (random(1, 700, false), random(2, 500, false));
    for gate in gates() {
        let options = MatchOptions::default();
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let pool = pool.build().unwrap();
            pool.install(|| match_features_gated(&a, &b, &options, &gate))
        };
        let one = on(1);
        assert!([2, 3, 7].into_iter().all(|threads| on(threads) == one));
    }
}

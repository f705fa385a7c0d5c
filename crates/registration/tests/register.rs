//! The registration on made-up features: what is found, what is not, and how often by chance.

use scopeservo_features::{Descriptors, Engine, Features, Keypoint};
use scopeservo_geometry::{Affine2, Similarity, SplitMix64, cholesky_inverse};
use scopeservo_registration::{
    Method, NotFound, Options, Prior, Registration, Rival, RotationPrior, ScalePrior, find_rivals,
};

const SIZE: [usize; 2] = [640, 480];

fn empty() -> Features {
    Features {
        descriptors: Descriptors::Bytes {
            length: 128,
            data: Vec::new(),
        },
        ..Features::none(Engine::default().name(), SIZE[0], SIZE[1])
    }
}

fn push(features: &mut Features, keypoint: Keypoint, descriptor: &[u8; 128]) {
    features.keypoints.push(keypoint);
    if let Descriptors::Bytes { data, .. } = &mut features.descriptors {
        data.extend(descriptor);
    }
}

fn register(view: &Features, target: &Features, prior: &Prior, options: &Options) -> Registration {
    scopeservo_registration::register(&*Engine::default(), view, target, prior, options)
}

fn keypoint(at: [f64; 2], sigma: f64, angle: f64) -> Keypoint {
    Keypoint {
        x: at[0] as f32,
        y: at[1] as f32,
        sigma: sigma as f32,
        angle: angle.sin().atan2(angle.cos()) as f32,
        response: 0.1,
        bright: true,
        octave: 0,
        layer: 1,
    }
}

fn place(rng: &mut SplitMix64) -> [f64; 2] {
    [rng.uniform() * 640.0, rng.uniform() * 480.0]
}

const TRUTH: Similarity = Similarity {
    scale: 1.4,
    angle_rad: 0.6,
    offset: [30.0, -80.0],
};

/// `good` pairs that obey TRUTH with `noise` px and `bad` pairs that obey nothing; a pair shares its descriptor. The good
/// ones lie within `spot` of the image's size.
fn pairs(good: usize, bad: usize, noise: f64, seed: u64, spot: f64) -> (Features, Features) {
    let mut rng = SplitMix64::new(seed);
    let (mut view, mut target) = (empty(), empty());
    let truth = Affine2::from(TRUTH);
    for i in 0..good + bad {
        let descriptor = std::array::from_fn(|_| rng.below(32) as u8);
        let anywhere = place(&mut rng);
        let p = [0, 1].map(|k| 200.0 + spot * (anywhere[k] - 200.0));
        let (sigma, angle) = (2.0 + 2.0 * rng.uniform(), 6.0 * rng.uniform());
        push(&mut view, keypoint(p, sigma, angle), &descriptor);
        let there = if i < good {
            let q = truth.apply(p);
            let q = [q[0] + noise * rng.normal(), q[1] + noise * rng.normal()];
            keypoint(q, 1.4 * sigma, angle + 0.6)
        } else {
            let (s, a) = (2.0 + 4.0 * rng.uniform(), 6.0 * rng.uniform());
            keypoint(place(&mut rng), s, a)
        };
        push(&mut target, there, &descriptor);
    }
    (view, target)
}

#[test]
fn a_quarter_of_good_matches_is_found_by_both_methods() {
    for method in [Method::Oriented, Method::ThreePoint] {
        let (view, target) = pairs(60, 180, 0.3, 1, 1.0);
        let options = Options {
            method,
            ..Options::default()
        };
        let answer = register(&view, &target, &Prior::default(), &options);
        let found = answer.found().expect("60 of 240 agree");
        assert!((55..=64).contains(&answer.inliers), "{}", answer.inliers);
        let centre = [319.5, 239.5];
        let (p, q) = (
            found.target_from_view.apply(centre),
            Affine2::from(TRUTH).apply(centre),
        );
        let off = f64::hypot(p[0] - q[0], p[1] - q[1]);
        assert!(off < 6.0 * found.sigma_px && off < 0.5, "{method:?} {off}");
    }
}

#[test]
fn the_claimed_sigmas_are_the_scatter() {
    let (mut place_sq, mut turn_sq) = (0.0, 0.0);
    let draws = 200;
    for seed in 0..draws {
        let (view, target) = pairs(80, 40, 0.4, seed, 1.0);
        let answer = register(&view, &target, &Prior::default(), &Options::default());
        let found = answer.found().expect("80 of 120 agree");
        let centre = [319.5, 239.5];
        let (p, q) = (
            found.target_from_view.apply(centre),
            Affine2::from(TRUTH).apply(centre),
        );
        let off_sq = ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)) / 2.0;
        place_sq += off_sq / found.sigma_px.powi(2);
        let angle = found.target_from_view.linear.rotation_angle();
        let turn = angle.expect("a found transform turns") - 0.6;
        turn_sq += (turn / found.sigma_angle_rad).powi(2);
    }
    let [place, turn] = [place_sq, turn_sq].map(|s: f64| (s / draws as f64).sqrt());
    assert!((0.8..1.25).contains(&place), "place {place}");
    assert!((0.8..1.25).contains(&turn), "turn {turn}");
}

/// `clumps` of six keypoints within a few pixels that share most of their error, each described one to four times.
fn clumped(clumps: usize, shared: f64, own: f64, seed: u64) -> (Features, Features) {
    let mut rng = SplitMix64::new(seed);
    let (mut view, mut target) = (empty(), empty());
    let truth = Affine2::from(TRUTH);
    for _ in 0..clumps {
        let centre = place(&mut rng);
        let off = [0, 1].map(|_| shared * rng.normal());
        for _ in 0..6 {
            let p = centre.map(|c| c + 3.0 * rng.normal());
            let q = truth.apply(p);
            let q = [0, 1].map(|k| q[k] + off[k] + own * rng.normal());
            let sigma = 2.0 + 2.0 * rng.uniform();
            for _ in 0..=rng.below(4) {
                let descriptor = std::array::from_fn(|_| rng.below(32) as u8);
                let angle = 6.0 * rng.uniform();
                push(&mut view, keypoint(p, sigma, angle), &descriptor);
                push(
                    &mut target,
                    keypoint(q, 1.4 * sigma, angle + 0.6),
                    &descriptor,
                );
            }
        }
    }
    (view, target)
}

#[test]
fn the_covariance_is_true_where_neighbours_share_their_errors() {
    let truth: [[f64; 3]; 2] = Affine2::from(TRUTH).into();
    // Shared for the most part, not at all, and by few: they tell how large each error is, and less well how six go together.
    for (clumps, shared, own, at_most) in [
        (60, 0.4, 0.1, 1.3),
        (60, 0.0, 0.3, 1.3),
        (20, 0.4, 0.1, 1.7),
    ] {
        let (mut place_sq, mut turn_sq, mut all_sq) = (0.0, 0.0, 0.0);
        let draws = 200;
        for seed in 0..draws {
            let (view, target) = clumped(clumps, shared, own, seed);
            let answer = register(&view, &target, &Prior::default(), &Options::default());
            let found = answer.found().expect("all agree");
            let m: [[f64; 3]; 2] = found.target_from_view.into();
            let off: [f64; 6] = std::array::from_fn(|i| m[i / 3][i % 3] - truth[i / 3][i % 3]);
            let at = [319.5, 239.5, 1.0];
            let there = [0, 1].map(|k| (0..3).map(|i| off[3 * k + i] * at[i]).sum::<f64>());
            place_sq += (there[0].powi(2) + there[1].powi(2)) / 2.0 / found.sigma_px.powi(2);
            let angle = found.target_from_view.linear.rotation_angle();
            turn_sq += ((angle.expect("it turns") - 0.6) / found.sigma_angle_rad).powi(2);
            let inverse = cholesky_inverse(&found.covariance).expect("it is a covariance");
            for i in 0..6 {
                for j in 0..6 {
                    all_sq += off[i] * inverse[i][j] * off[j] / 6.0;
                }
            }
        }
        let [place, turn, all] = [place_sq, turn_sq, all_sq].map(|s| (s / draws as f64).sqrt());
        assert!((0.85..1.15).contains(&place), "{clumps} {shared}: {place}");
        assert!((0.85..1.15).contains(&turn), "{clumps} {shared}: {turn}");
        assert!((0.85..at_most).contains(&all), "{clumps} {shared}: {all}");
    }
}

#[test]
fn nothing_is_known_for_sure() {
    let (view, target) = pairs(80, 0, 0.0, 9, 1.0);
    let answer = register(&view, &target, &Prior::default(), &Options::default());
    let found = answer.found().expect("all agree");
    assert!(found.sigma_px > 5e-4, "{}", found.sigma_px);
    assert!(found.sigma_angle_rad > 1e-6 && found.corner_sigma_px > found.sigma_px);
    assert!(cholesky_inverse(&found.covariance).is_some());
}

#[test]
fn random_matches_are_found_less_often_than_promised() {
    // At one false alarm in ten: the bound is far from tight, and must hold.
    let options = Options {
        false_alarms: 0.1,
        max_corner_sigma_px: f64::INFINITY,
        ..Options::default()
    };
    let known = Prior {
        scale: Some(ScalePrior {
            ratio: 1.4,
            tolerance: 0.1,
        }),
        rotation: Some(RotationPrior {
            angle_rad: 0.6,
            tolerance_rad: 0.2,
        }),
        ..Prior::default()
    };
    for prior in [Prior::default(), known] {
        let found = (0..300)
            .filter(|&seed| {
                let (view, target) = pairs(0, 400, 0.0, 1000 + seed, 1.0);
                register(&view, &target, &prior, &options).found().is_some()
            })
            .count();
        assert!(found <= 30, "{found} of 300");
    }
}

#[test]
fn what_is_not_found_says_why() {
    let options = Options::default();
    let reason = |v: &Features, t: &Features, p: &Prior, o: &Options| {
        let answer = register(v, t, p, o);
        answer.outcome.expect_err("this is not to be found")
    };
    let (view, target) = pairs(50, 0, 0.2, 3, 1.0);
    let free = Prior::default();
    let none = reason(&empty(), &target, &free, &options);
    assert!(
        matches!(none, NotFound::TooFewFeatures { view: 0, .. }),
        "{none}"
    );
    let (other, _) = pairs(50, 0, 0.2, 4, 1.0);
    let strict = Options {
        ratio: 0.1,
        ..options
    };
    let unlike = reason(&other, &target, &free, &strict);
    assert!(matches!(unlike, NotFound::TooFewMatches { .. }), "{unlike}");
    // A scale that the prior rules out.
    let wrong = Prior {
        scale: Some(ScalePrior {
            ratio: 4.0,
            tolerance: 0.03,
        }),
        rotation: None,
        ..Prior::default()
    };
    let ruled_out = reason(&view, &target, &wrong, &options);
    assert!(
        matches!(ruled_out, NotFound::TooFewMatches { .. }),
        "{ruled_out}"
    );
    // Nothing agrees, and a handful among many proves nothing.
    let (view, target) = pairs(0, 300, 0.2, 5, 1.0);
    let nothing = reason(&view, &target, &free, &options);
    assert!(
        matches!(
            nothing,
            NotFound::NoAgreement { .. } | NotFound::ByChance { .. }
        ),
        "{nothing}"
    );
    let (view, target) = pairs(4, 40, 0.2, 5, 1.0);
    let chance = reason(&view, &target, &free, &options);
    assert!(matches!(chance, NotFound::ByChance { .. }), "{chance}");
    // Many, but all in one part: they cannot tell where the corners go.
    let (view, target) = pairs(60, 0, 1.0, 6, 0.25);
    let loose = Options {
        max_corner_sigma_px: 0.3,
        ..options
    };
    let open = reason(&view, &target, &free, &loose);
    assert!(matches!(open, NotFound::Uncertain { .. }), "{open}");
}

#[test]
fn a_mirrored_arrangement_is_not_found() {
    let (view, mut target) = pairs(120, 0, 0.2, 7, 1.0);
    for k in &mut target.keypoints {
        k.x = 639.0 - k.x;
        k.angle = std::f32::consts::PI - k.angle;
    }
    let answer = register(&view, &target, &Prior::default(), &Options::default());
    assert!(answer.found().is_none());
}

#[test]
fn the_same_input_gives_the_same_answer() {
    let (view, target) = pairs(60, 180, 0.3, 8, 1.0);
    let answer = || register(&view, &target, &Prior::default(), &Options::default());
    assert_eq!(answer(), answer());
}

/// A wafer's die holds an array of equal cells and other things; the next die is as much like it.
#[test]
fn a_copy_far_away_is_a_rival_though_nearer_things_look_alike_among_themselves() {
    let mut rng = SplitMix64::new(5);
    let at = |i: usize, y: f64| [12.0 * (i % 12) as f64, y + 12.0 * (i / 12) as f64];
    let mut die: Vec<([f64; 2], [u8; 128])> = (0..144).map(|i| (at(i, 0.0), [10; 128])).collect();
    die.extend((0..60).map(|i| (at(i, 160.0), std::array::from_fn(|_| rng.below(32) as u8))));
    let drawn = |corners: &[[f64; 2]]| {
        let mut all = empty();
        for corner in corners {
            for (p, descriptor) in &die {
                let place = [corner[0] + p[0], corner[1] + p[1]];
                push(&mut all, keypoint(place, 2.0, 0.5), descriptor);
            }
        }
        all
    };
    let view = drawn(&[[40.0, 40.0], [340.0, 40.0]]);
    let target = drawn(&[[100.0, 100.0]]);
    let (prior, options) = (Prior::default(), Options::default());
    let answer = register(&view, &target, &prior, &options);
    assert!(answer.found().is_some());
    let all = find_rivals(&view, &target, &answer, &prior, &options, false);
    let far = |r: &Rival| (f64::hypot(r.shift_px[0], r.shift_px[1]) - 300.0).abs() < 3.0;
    assert!(all.iter().any(far), "{all:?}");
    assert!(all.is_sorted_by_key(|r| std::cmp::Reverse(r.places)));
}

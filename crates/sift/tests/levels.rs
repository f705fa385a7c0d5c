//! Every level that this processor has against [`Level::Scalar`], on any number of threads, in new engines and used ones.

#![expect(
    clippy::print_stdout,
    reason = "the measured shares are worth reading with --nocapture"
)]

mod common;

use common::{Random, Scene};
use scopeservo_sift::{
    Features, Gate, GrayImage, Keypoint, Level, Match, MatchOptions, Options, Sift, Simd,
    match_features_at,
};

/// Share of features and of matches that must be the same, as the documentation of [`Level`] states it.
const SAME: f64 = 0.995;

/// The tolerances of [`Level`].
fn same(a: &Keypoint, b: &Keypoint) -> bool {
    let turn = a.angle - b.angle;
    (a.x - b.x).hypot(a.y - b.y) < 0.01
        && (a.sigma / b.sigma - 1.0).abs() < 0.01
        && turn.sin().atan2(turn.cos()).abs() < 0.01
        && a.octave == b.octave
}

/// Share of `a` that is also in `b`, descriptors included.
fn shared(a: &Features, b: &Features) -> f64 {
    let near = |i: usize, j: usize| {
        let pairs = (a.descriptors[i].components().iter()).zip(b.descriptors[j].components());
        same(&a.keypoints[i], &b.keypoints[j])
            && pairs.map(|(a, b)| a.abs_diff(*b)).max() <= Some(8)
    };
    let found = (0..a.len()).filter(|&i| (0..b.len()).any(|j| near(i, j)));
    found.count() as f64 / a.len().max(1) as f64
}

fn first_octave(first_octave: i32) -> Options {
    Options {
        first_octave,
        ..Options::default()
    }
}

/// A scene and itself turned, shifted and zoomed a little: spots, spots with noise, stripes and checks, noise alone.
fn pairs() -> Vec<(&'static str, GrayImage, GrayImage)> {
    let scene = Scene::random(5, 1600, 420.0, 0.9..10.0);
    let turned = |x: f64, y: f64| {
        let (sin, cos) = 0.3_f64.sin_cos();
        (
            60.0 + 0.95 * (cos * x - sin * y),
            0.95 * (sin * x + cos * y),
        )
    };
    let straight = |x: f64, y: f64| (x + 30.0, y + 50.0);
    let mut r = Random(4);
    let mut noisy = |image: &GrayImage, noise: f64| {
        let mut noise = || (noise * r.normal()) as f32;
        GrayImage::from_fn(image.width(), image.height(), |x, y| {
            image.get(x, y) + noise()
        })
        .unwrap()
    };
    let checks = |x: f64, y: f64| {
        let wave = (0.31 * x + 0.1 * y).sin() * (0.23 * y - 0.07 * x).cos() + (0.011 * x * y).sin();
        let check = if ((x / 9.0).floor() + (y / 13.0).floor()) as i64 % 2 == 0 {
            0.3
        } else {
            0.0
        };
        (0.5 + 0.1 * wave + check) as f32
    };
    let from = |w, h, at: &dyn Fn(f64, f64) -> (f64, f64)| {
        GrayImage::from_fn(w, h, |x, y| {
            let (x, y) = at(x as f64, y as f64);
            checks(x, y)
        })
        .unwrap()
    };
    let (a, b) = (
        scene.render(301, 203, straight),
        scene.render(257, 222, turned),
    );
    let (noisy_a, noisy_b) = (noisy(&a, 0.02), noisy(&b, 0.02));
    // Eight bits in rows with padding, odd from every side.
    let bytes: Vec<u8> = (noisy_a.data().chunks(301))
        .flat_map(|row| (row.iter().map(|v| (255.0 * v) as u8)).chain([77; 22]))
        .collect();
    let padded = GrayImage::from_u8(293, 199, 323, &bytes[2 * 323 + 5..]).unwrap();
    let grey = GrayImage::from_fn(181, 143, |_, _| 0.5).unwrap();
    vec![
        ("spots", a, b),
        ("spots with noise", noisy_a, noisy_b.clone()),
        ("eight bits", padded, noisy_b),
        (
            "stripes and checks",
            from(240, 161, &straight),
            from(163, 259, &turned),
        ),
        (
            "wider than a tile",
            scene.render(1311, 45, |x, y| (0.3 * x + 5.0, y + 90.0)),
            scene.render(1290, 47, |x, y| (0.3 * x + 8.0, y + 89.0)),
        ),
        ("noise", noisy(&grey, 0.3), noisy(&grey, 0.3)),
    ]
}

#[test]
fn levels_agree_with_the_scalar_one() {
    let scalar = Simd::at(Level::Scalar).unwrap();
    let matched = |simd: Simd, a: &Features, b: &Features| {
        match_features_at(simd, a, b, &MatchOptions::default(), &Gate::default())
    };
    // Over all scenes, per level: features, features not shared, matches, matches not shared.
    let mut sums = std::collections::BTreeMap::new();
    for (name, a, b) in pairs() {
        for octave in [-1, 0, 1] {
            let at = |simd: Simd, image: &GrayImage| {
                let mut sift = Sift::with(first_octave(octave), simd).unwrap();
                sift.detect_and_describe(image)
            };
            let (a0, b0) = (at(scalar, &a), at(scalar, &b));
            let pairs_0 = matched(scalar, &a0, &b0);
            for simd in Simd::available().skip(1) {
                let (a1, b1) = (at(simd, &a), at(simd, &b));
                let pairs_1 = matched(simd, &a1, &b1);
                let share = shared(&a0, &a1).min(shared(&a1, &a0));
                let is_in = |m: &Match,
                             (a, b): (&Features, &Features),
                             pairs: &[Match],
                             (c, d): (&Features, &Features)| {
                    pairs.iter().any(|n| {
                        same(&a.keypoints[m.query], &c.keypoints[n.query])
                            && same(&b.keypoints[m.train], &d.keypoints[n.train])
                    })
                };
                let forward = pairs_0
                    .iter()
                    .filter(|m| is_in(m, (&a0, &b0), &pairs_1, (&a1, &b1)))
                    .count();
                let backward = pairs_1
                    .iter()
                    .filter(|m| is_in(m, (&a1, &b1), &pairs_0, (&a0, &b0)))
                    .count();
                println!(
                    "{name}, from octave {octave}, {}: {} and {} features, {:.2} % the same; {} and {} matches, {} the same",
                    simd.level(),
                    a0.len(),
                    a1.len(),
                    100.0 * share,
                    pairs_0.len(),
                    pairs_1.len(),
                    forward.min(backward)
                );
                let sum: &mut [f64; 4] = sums.entry(simd.level().to_string()).or_default();
                sum[0] += a0.len() as f64;
                sum[1] += a0.len() as f64 * (1.0 - share);
                sum[2] += pairs_0.len() as f64;
                sum[3] += (pairs_0.len() - forward).max(pairs_1.len() - backward) as f64;
            }
        }
    }
    for (level, [features, lost, matches, other]) in sums {
        println!(
            "{level}: {lost:.1} of {features} features and {other} of {matches} matches differ"
        );
        assert!(
            features > 3000.0 && lost / features <= 1.0 - SAME,
            "{level}"
        );
        assert!(matches > 1000.0 && other / matches <= 1.0 - SAME, "{level}");
    }
}

#[test]
fn threads_do_not_change_a_bit_at_any_level() {
    let scene = Scene::random(5, 1400, 420.0, 0.9..10.0);
    let mut r = Random(4);
    let image = scene.render(301, 333, |x, y| (x + 30.0, y + 50.0));
    let image =
        GrayImage::from_fn(301, 333, |x, y| image.get(x, y) + 0.01 * r.normal() as f32).unwrap();
    let pools = [1, 2, 5].map(|n| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(n)
            .build()
            .unwrap()
    });
    for simd in Simd::available() {
        for octave in [-1, 0, 1] {
            let on = |pool: &rayon::ThreadPool| {
                pool.install(|| {
                    let mut sift = Sift::with(first_octave(octave), simd).unwrap();
                    sift.detect_and_describe(&image)
                })
            };
            let one = on(&pools[0]);
            assert!(one.len() > 20, "{}", one.len());
            for pool in &pools[1..] {
                assert_eq!(on(pool), one, "{}, from octave {octave}", simd.level());
            }
        }
    }
}

/// On several threads the strongest of the fine octaves are oriented before the coarse ones have been searched. Here those show up
/// to sixty that are stronger.
#[test]
fn what_coarse_octaves_show_takes_the_place_of_what_was_begun() {
    let spot = |x: usize, y: usize, step: f32, sigma: f32| {
        let d = [x, y].map(|v| (v as f32 + 0.31 * step).rem_euclid(step) - 0.5 * step);
        (-0.5 * (d[0] * d[0] + d[1] * d[1]) / (sigma * sigma)).exp()
    };
    let image = GrayImage::from_fn(301, 333, |x, y| {
        // No two spots as bright as each other.
        let slope = 1.0 + 1e-3 * x as f32 + 7e-4 * y as f32;
        slope * (0.4 * spot(x, y, 43.0, 6.3) - 0.15 * spot(x, y, 19.0, 1.6))
    })
    .unwrap();
    let pools = [1, 2, 3].map(|n| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(n)
            .build()
            .unwrap()
    });
    let mut taken = [0, 0];
    for max_features in [1, 2, 3, 7, 60, 200, 400, 600, 1000] {
        let options = Options {
            max_features,
            ..Options::default()
        };
        let [one, two, three] = pools.each_ref().map(|pool| {
            let mut sift = Sift::new(options.clone()).unwrap();
            pool.install(|| sift.detect_and_describe(&image))
        });
        assert_eq!(two, one, "{max_features}");
        assert_eq!(three, one, "{max_features}");
        assert!(one.len() <= max_features);
        let coarse = one.keypoints.iter().filter(|k| k.octave > 0).count();
        taken[usize::from(coarse < one.len())] += 1;
    }
    assert!(taken.iter().all(|n| *n >= 3), "{taken:?}");
}

/// Also after images of other sizes, on other numbers of threads, and without anything in them.
#[test]
fn a_used_engine_gives_what_a_new_one_gives() {
    let scene = Scene::random(9, 1400, 700.0, 0.9..10.0);
    let image = |w, h| scene.render(w, h, |x, y| (x + 30.0, y + 50.0));
    let grey = |w, h| GrayImage::from_fn(w, h, |_, _| 0.5).unwrap();
    let images = [
        image(120, 90),
        image(331, 217),
        grey(331, 217),
        image(60, 55),
        grey(1, 1),
        image(5, 300),
        image(660, 130),
        image(120, 90),
        image(131, 400),
    ];
    let pools = [1, 3].map(|n| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(n)
            .build()
            .unwrap()
    });
    for simd in Simd::available() {
        for octave in [-1, 0, 1] {
            let new = || Sift::with(first_octave(octave), simd).unwrap();
            let mut used = new();
            for (i, image) in images.iter().enumerate() {
                let expected = new().detect_and_describe(image);
                let found = pools[i % 2].install(|| used.detect_and_describe(image));
                assert_eq!(
                    found,
                    expected,
                    "image {i} at {}, from octave {octave}",
                    simd.level()
                );
                assert_eq!(used.detect(image), expected.keypoints);
            }
        }
    }
}

//! Odd images, dim images, options and threads.

mod common;

use common::{Random, Scene, features};
use scopeservo_sift::{Features, GrayImage, Keypoint, Options, SiftError, detect_and_describe};

fn image(f: impl FnMut(usize, usize) -> f32) -> GrayImage {
    GrayImage::from_fn(160, 120, f).unwrap()
}

/// Share of `a` found again in `b`: same place within half a pixel, size within 10 %, angle within 0.1 rad.
fn repeated(a: &Features, b: &Features) -> f64 {
    let same = |p: &Keypoint, q: &Keypoint| {
        let turn = p.angle - q.angle;
        (p.x - q.x).hypot(p.y - q.y) < 0.5
            && (0.9..1.1).contains(&(p.sigma / q.sigma))
            && turn.sin().atan2(turn.cos()).abs() < 0.1
    };
    let found = a
        .keypoints
        .iter()
        .filter(|p| b.keypoints.iter().any(|q| same(p, q)))
        .count();
    found as f64 / a.len() as f64
}

#[test]
fn a_dim_image_has_the_keypoints_of_the_bright_one() {
    let bright =
        Scene::random(5, 900, 300.0, 0.9..10.0).render(240, 200, |x, y| (x + 30.0, y + 50.0));
    let dim = |gain: f32, offset: f32| {
        GrayImage::new(
            240,
            200,
            bright.data().iter().map(|v| gain * v + offset).collect(),
        )
        .unwrap()
    };
    let truth = features(&bright);
    assert!(truth.len() > 100, "{}", truth.len());
    for (gain, offset) in [(0.1, 0.0), (0.1, 0.4), (0.03, 0.9), (2.0, -0.5)] {
        let f = features(&dim(gain, offset));
        assert!(
            repeated(&truth, &f) > 0.98 && repeated(&f, &truth) > 0.98,
            "gain {gain}, offset {offset}"
        );
    }
    // Stored in 8 bits, a tenth of the range is 25 grey levels.
    let bytes = dim(0.1, 0.4)
        .data()
        .iter()
        .map(|v| (v * 255.0).round() / 255.0)
        .collect();
    let f = features(&GrayImage::new(240, 200, bytes).unwrap());
    assert!(repeated(&truth, &f) > 0.6, "{}", repeated(&truth, &f));
    // Without adaptation Lowe's threshold stands as it is.
    let fixed = Options {
        adapt_contrast: false,
        ..Options::default()
    };
    assert!(detect_and_describe(&dim(0.1, 0.4), &fixed).unwrap().len() < truth.len() / 4);
}

#[test]
fn noise_alone_gives_few_keypoints_and_does_not_hide_a_spot() {
    let mut r = Random(11);
    let noise = image(|_, _| 0.5 + 0.02 * r.normal() as f32);
    let f = features(&noise);
    f.check().unwrap();
    assert!(f.len() < 100, "{}", f.len());
    let spotted = image(|x, y| {
        let r_sq = (x as f32 - 70.3).powi(2) + (y as f32 - 60.6).powi(2);
        noise.get(x, y) + 0.2 * (-r_sq / 32.0).exp()
    });
    let strongest = features(&spotted).keypoints[0];
    assert!(
        (strongest.x - 70.3).hypot(strongest.y - 60.6) < 0.5,
        "{strongest:?}"
    );
}

#[test]
fn bright_spots_are_bright_and_dark_ones_dark() {
    for (height, bright) in [(0.3, true), (-0.3, false)] {
        let f = features(&image(|x, y| {
            let d_sq = (x as f32 - 50.0).powi(2) + (y as f32 - 40.0).powi(2);
            0.5 + height * (-d_sq / 8.0).exp()
        }));
        assert!(f.keypoints[0].x.round() == 50.0 && f.keypoints[0].bright == bright);
    }
}

#[test]
fn spots_on_black_that_fill_no_percentile_are_found() {
    let f = features(&image(|x, y| {
        (-((x as f32 - 50.0).powi(2) + (y as f32 - 40.0).powi(2)) / 8.0).exp()
    }));
    assert!(
        f.keypoints
            .iter()
            .any(|k| (k.x - 50.0).hypot(k.y - 40.0) < 0.01),
        "{f:?}"
    );
}

#[test]
fn nothing_to_see_is_no_error() {
    for v in [0.0, 0.3, 1.0, -7.0] {
        assert!(features(&image(|_, _| v)).is_empty(), "{v}");
        let fixed = Options {
            adapt_contrast: false,
            contrast_threshold: 0.0,
            ..Options::default()
        };
        assert!(
            detect_and_describe(&image(|_, _| v), &fixed)
                .unwrap()
                .is_empty()
        );
    }
    assert!(features(&image(|x, y| 0.003 * x as f32 + 0.002 * y as f32)).is_empty());
}

#[test]
fn small_and_narrow_images_do_not_panic() {
    let mut r = Random(2);
    for (w, h) in [
        (1, 1),
        (1, 500),
        (500, 1),
        (2, 2),
        (5, 5),
        (6, 6),
        (7, 7),
        (7, 300),
        (12, 12),
        (13, 90),
        (33, 17),
    ] {
        for first_octave in [-1, 0, 1] {
            let image = GrayImage::from_fn(w, h, |_, _| r.unit() as f32).unwrap();
            let f = detect_and_describe(
                &image,
                &Options {
                    first_octave,
                    ..Options::default()
                },
            )
            .unwrap();
            f.check().unwrap();
            if w.min(h) < 6 {
                assert!(f.is_empty());
            }
        }
    }
}

#[test]
fn extreme_values_do_not_panic() {
    let mut r = Random(3);
    for scale in [1e-38, 1e-20, 1e4, 1e9, 1e12] {
        let f = features(&image(|_, _| scale * r.unit() as f32));
        f.check().unwrap();
    }
}

#[test]
fn every_option_set_within_range_works() {
    let scene =
        Scene::random(5, 300, 200.0, 0.9..10.0).render(160, 120, |x, y| (x + 20.0, y + 40.0));
    let d = Options::default;
    for options in [
        Options {
            intervals: 2,
            ..d()
        },
        Options {
            intervals: 5,
            ..d()
        },
        Options {
            intervals: 16,
            ..d()
        },
        Options {
            first_octave: 0,
            ..d()
        },
        Options { sigma: 1.01, ..d() },
        Options { sigma: 16.0, ..d() },
        Options {
            assumed_blur: 0.0,
            ..d()
        },
        Options {
            contrast_threshold: 0.0,
            ..d()
        },
        Options {
            edge_ratio: 1e6,
            ..d()
        },
        Options {
            max_features: usize::MAX,
            ..d()
        },
    ] {
        let f = detect_and_describe(&scene, &options).unwrap();
        f.check().unwrap();
        for k in &f.keypoints {
            assert!(
                (0..options.intervals as u32).contains(&k.layer)
                    && k.octave >= options.first_octave
            );
            assert!(k.angle > -std::f32::consts::PI && k.angle <= std::f32::consts::PI);
        }
    }
    let bad = Options {
        max_features: 0,
        ..d()
    };
    assert!(matches!(
        detect_and_describe(&scene, &bad),
        Err(SiftError::Option {
            name: "max_features",
            ..
        })
    ));
}

#[test]
fn the_budget_keeps_the_strongest() {
    let scene =
        Scene::random(5, 900, 300.0, 0.9..10.0).render(240, 200, |x, y| (x + 30.0, y + 50.0));
    let all = features(&scene);
    assert!(
        all.keypoints
            .windows(2)
            .all(|w| w[0].response >= w[1].response)
    );
    let some = detect_and_describe(
        &scene,
        &Options {
            max_features: 60,
            ..Options::default()
        },
    )
    .unwrap();
    assert!((60..=90).contains(&some.len()), "{}", some.len());
    assert_eq!(some, all.subset(&(0..some.len()).collect::<Vec<_>>()));
}

#[test]
fn threads_do_not_change_a_bit() {
    let mut r = Random(4);
    let scene =
        Scene::random(5, 900, 300.0, 0.9..10.0).render(240, 200, |x, y| (x + 30.0, y + 50.0));
    let noisy = GrayImage::new(
        240,
        200,
        scene
            .data()
            .iter()
            .map(|v| v + 0.01 * r.normal() as f32)
            .collect(),
    )
    .unwrap();
    let on = |threads| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(|| features(&noisy))
    };
    let one = on(1);
    assert!(one.len() > 100);
    assert_eq!(one, on(2));
    assert_eq!(one, on(5));
}

#[test]
fn features_survive_storage_and_damage_is_noticed() {
    let f = features(
        &Scene::random(5, 300, 200.0, 0.9..10.0).render(160, 120, |x, y| (x + 20.0, y + 40.0)),
    );
    let mut back: Features = serde_json::from_str(&serde_json::to_string(&f).unwrap()).unwrap();
    back.check().unwrap();
    assert_eq!(back, f);
    back.keypoints[3].x = f32::INFINITY;
    assert_eq!(back.check(), Err(SiftError::BadKeypoint { index: 3 }));
    back.keypoints.pop();
    assert!(matches!(
        back.check(),
        Err(SiftError::FeatureLengths { .. })
    ));
}

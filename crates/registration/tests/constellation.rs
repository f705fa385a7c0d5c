//! Places in a world of numbers: what is scattered by chance is found by how it lies, and nothing else is.

use scopeservo_features::{Descriptors, Features, Keypoint};
use scopeservo_geometry::{Affine2, Similarity, SplitMix64, Vec2};
use scopeservo_registration::constellation::{Constellation, constellation};
use scopeservo_registration::{Options, Prior, RotationPrior, ScalePrior};
use std::f64::consts::{PI, TAU};

const RATIO: f64 = 4.0;
const SIZE: [f64; 2] = [640.0, 480.0];

/// Things on a plane, in pixels of the view: where, and how large.
type Things = Vec<(Vec2, f64)>;

fn scattered(count: usize, rng: &mut SplitMix64) -> Things {
    let thing = |_| {
        let at = SIZE.map(|n| n * rng.uniform());
        (at, 1.5 + 1.5 * rng.uniform())
    };
    (0..count).map(thing).collect()
}

/// As keypoints of an image of which `image_from_plane` tells where it lies, each off by so many pixels.
fn seen(
    things: &Things,
    image_from_plane: &Affine2,
    off_px: f64,
    rng: &mut SplitMix64,
) -> Features {
    let scale = image_from_plane.linear.det().sqrt();
    let mut features = Features::none("test", SIZE[0] as usize, SIZE[1] as usize);
    for (at, sigma) in things {
        let at = image_from_plane
            .apply(*at)
            .map(|v| v + off_px * rng.normal());
        let inside = |k: usize| (0.0..SIZE[k]).contains(&at[k]);
        if !inside(0) || !inside(1) {
            continue;
        }
        features.keypoints.push(Keypoint {
            x: at[0] as f32,
            y: at[1] as f32,
            sigma: (sigma * scale) as f32,
            angle: (TAU * rng.uniform() - PI) as f32,
            response: rng.uniform() as f32,
            bright: false,
            octave: 0,
            layer: 1,
        });
    }
    // All look alike.
    features.descriptors = Descriptors::Bytes {
        length: 4,
        data: vec![7; 4 * features.len()],
    };
    features
}

/// Four times as large, turned, with this place of the plane in its middle.
fn target_at(middle: Vec2, angle_rad: f64) -> Affine2 {
    let turned = Affine2::from(Similarity {
        scale: RATIO,
        angle_rad,
        offset: [0.0; 2],
    });
    let at = turned.apply(middle);
    Affine2 {
        offset: [0, 1].map(|k| SIZE[k] / 2.0 - at[k]),
        ..turned
    }
}

fn prior() -> Prior {
    Prior {
        scale: Some(ScalePrior {
            ratio: RATIO,
            tolerance: 0.02,
        }),
        ..Prior::default()
    }
}

fn look(view: &Features, target: &Features, prior: &Prior) -> Option<Constellation> {
    constellation(view, target, prior, &Options::default())
}

/// How far the target's middle is from where it lies, pixels of the view.
fn off_px(found: &Constellation, truth: &Affine2) -> Option<f64> {
    let got = found.registration.found()?.target_from_view;
    let middle = SIZE.map(|n| n / 2.0);
    let lies = truth.inverse()?.apply(middle);
    let at = got.apply(lies);
    Some(f64::hypot(at[0] - middle[0], at[1] - middle[1]) / RATIO)
}

#[test]
fn things_that_look_alike_are_found_by_how_they_lie() {
    let mut found = 0;
    for seed in 0..40 {
        let mut rng = SplitMix64::new(seed);
        // Six to twenty in the target.
        let things = scattered(96 + 6 * seed as usize, &mut rng);
        let truth = target_at(
            [180.0 + 280.0 * rng.uniform(), 140.0 + 200.0 * rng.uniform()],
            TAU * rng.uniform(),
        );
        let view = seen(&things, &Affine2::IDENTITY, 0.1, &mut rng);
        let target = seen(&things, &truth, 0.2, &mut rng);
        let answer = look(&view, &target, &prior());
        let Some(off) = answer.as_ref().and_then(|a| off_px(a, &truth)) else {
            // By chance the target has less.
            assert!(target.len() < 7, "{} things were not found", target.len());
            continue;
        };
        let answer = answer.unwrap();
        assert!(off < 1.0, "{off}");
        assert_eq!(answer.rivals, []);
        let sigma_px = answer.registration.found().unwrap().sigma_px / RATIO;
        assert!(off < 5.0 * sigma_px.max(0.1), "{off} {sigma_px}");
        found += 1;
    }
    assert!(found >= 34, "{found} of 40");
}

#[test]
fn a_third_that_is_hidden_and_as_much_that_is_new_hide_no_constellation() {
    let mut found = 0;
    for seed in 0..20 {
        let mut rng = SplitMix64::new(1000 + seed);
        let things = scattered(320, &mut rng);
        let truth = target_at([320.0, 240.0], 2.0);
        let hidden = |k: usize| k.is_multiple_of(3);
        let mut left: Things = (0..things.len())
            .filter(|k| !hidden(*k))
            .map(|k| things[k])
            .collect();
        left.extend(scattered(100, &mut rng));
        let view = seen(&left, &Affine2::IDENTITY, 0.1, &mut rng);
        let target = seen(&things, &truth, 0.2, &mut rng);
        let answer = look(&view, &target, &prior()).expect("looked for");
        // By chance half of a target is hidden.
        if let Some(off) = off_px(&answer, &truth) {
            assert!(off < 1.0, "{off}");
            found += 1;
        }
    }
    assert!(found >= 16, "{found} of 20");
}

#[test]
fn what_lies_otherwise_is_not_found() {
    for seed in 0..100 {
        let mut rng = SplitMix64::new(2000 + seed);
        let count = 20 + 3 * seed as usize;
        let (here, there) = (scattered(count, &mut rng), scattered(count, &mut rng));
        let view = seen(&here, &Affine2::IDENTITY, 0.1, &mut rng);
        let target = seen(&there, &target_at([320.0, 240.0], 0.5), 0.2, &mut rng);
        let found = look(&view, &target, &prior());
        let found = found.and_then(|a| a.registration.found().cloned());
        assert_eq!(found, None, "{count} things");
    }
}

/// Clusters of cells, each as many by chance: where they are dense a match says less.
#[test]
fn clusters_that_lie_otherwise_are_not_found() {
    for seed in 0..20 {
        let mut rng = SplitMix64::new(3000 + seed);
        let mut clusters = |count: usize| -> Things {
            let mut all = Things::new();
            for _ in 0..count {
                let middle = SIZE.map(|n| n * rng.uniform());
                for _ in 0..6 + rng.next_u64() % 6 {
                    let at = middle.map(|v| v + 8.0 * rng.normal());
                    all.push((at, 2.0));
                }
            }
            all
        };
        let (here, there) = (clusters(30), clusters(30));
        let view = seen(&here, &Affine2::IDENTITY, 0.1, &mut rng);
        let target = seen(&there, &target_at([320.0, 240.0], 0.5), 0.2, &mut rng);
        let found = look(&view, &target, &prior());
        let found = found.and_then(|a| a.registration.found().cloned());
        assert_eq!(found, None);
    }
}

#[test]
fn a_lattice_is_ambiguous() {
    for pitch in [16.0, 23.0, 31.0] {
        let mut rng = SplitMix64::new(7);
        let columns = (SIZE[0] / pitch) as usize;
        let rows = (SIZE[1] / pitch) as usize;
        let things: Things = (0..columns * rows)
            .map(|k| {
                let at = [(k % columns) as f64, (k / columns) as f64];
                (at.map(|v| pitch * (v + 0.5)), 2.0)
            })
            .collect();
        let view = seen(&things, &Affine2::IDENTITY, 0.1, &mut rng);
        let target = seen(&things, &target_at([300.0, 250.0], 0.3), 0.2, &mut rng);
        let answer = look(&view, &target, &prior()).expect("looked for");
        let sure = answer.registration.found().is_some() && answer.rivals.is_empty();
        assert!(!sure, "pitch {pitch}: {answer:?}");
    }
}

#[test]
fn what_is_known_of_the_angle_is_kept_to_and_equal_magnifications_are_not_asked() {
    let mut rng = SplitMix64::new(9);
    let things = scattered(250, &mut rng);
    let truth = target_at([320.0, 240.0], 1.0);
    let view = seen(&things, &Affine2::IDENTITY, 0.1, &mut rng);
    let target = seen(&things, &truth, 0.2, &mut rng);
    let turned = |angle_rad| Prior {
        rotation: Some(RotationPrior {
            angle_rad,
            tolerance_rad: 0.1,
        }),
        ..prior()
    };
    let right = look(&view, &target, &turned(1.05)).expect("looked for");
    assert!(off_px(&right, &truth).expect("found") < 1.0);
    let other = look(&view, &target, &turned(2.0));
    assert!(other.is_none_or(|a| a.registration.found().is_none()));
    let alike = Prior {
        scale: Some(ScalePrior {
            ratio: 1.0,
            tolerance: 0.02,
        }),
        ..Prior::default()
    };
    assert_eq!(look(&view, &view, &alike), None);
    assert_eq!(look(&view, &target, &Prior::default()), None);
}

#[test]
fn three_things_are_too_few() {
    let mut rng = SplitMix64::new(11);
    let things = scattered(60, &mut rng);
    let truth = target_at([320.0, 240.0], 1.0);
    let view = seen(&things, &Affine2::IDENTITY, 0.1, &mut rng);
    let mut target = seen(&things, &truth, 0.2, &mut rng);
    target = target.subset(&[0, 1, 2]);
    assert_eq!(look(&view, &target, &prior()), None);
}

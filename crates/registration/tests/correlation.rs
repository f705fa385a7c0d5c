//! Finding a target without features: known transforms of scenes that are known everywhere.

mod common;

use common::{Scene, Spot, apart, frame, placed};
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Affine2, SplitMix64, Vec2};
use scopeservo_registration::correlation::{Correlation, Counts, Picture, correlate, look_alikes};
use scopeservo_registration::likeness::Pair;
use scopeservo_registration::{
    Estimate, Options, Rival, RotationPrior, ScalePrior, periods, undecided,
};

const SIZE: [usize; 2] = [640, 480];
const CENTRE: [f64; 2] = [319.5, 239.5];

fn seen(
    (view, view_counts): (&GrayImage, Option<&Counts<'_>>),
    (target, target_counts): (&GrayImage, Option<&Counts<'_>>),
    ratio: f64,
    rotation: Option<RotationPrior>,
) -> Correlation {
    let scale = ScalePrior {
        ratio,
        tolerance: 0.04,
    };
    let picture = |image, counts| Picture { image, counts };
    correlate(
        &picture(view, view_counts),
        (&picture(target, target_counts), &periods(target)),
        scale,
        rotation,
        &Options::default(),
    )
}

/// Places are in target pixels from the target's centre; the view is `ratio` times as wide.
fn tissue(seed: u64, ratio: f64) -> Scene {
    let reach = 420.0 * ratio;
    Scene::random(seed, (1400.0 * ratio * ratio) as usize, reach, 2.5..18.0)
}

fn target_from_scene() -> Affine2 {
    placed(1.0, 0.0, [0.0; 2], CENTRE)
}

/// A view whose centre is so far from the target's centre, target pixels, and turned.
fn view_from_scene(ratio: f64, angle_deg: f64, off: Vec2) -> Affine2 {
    placed(1.0 / ratio, -angle_deg, off, CENTRE)
}

fn truth(view: &Affine2) -> Affine2 {
    target_from_scene().after(&view.inverse().unwrap())
}

#[test]
fn a_target_is_found_at_any_angle_and_scale_to_a_part_of_a_pixel_of_the_view() {
    let mut rng = SplitMix64::new(8);
    let (mut over_sigma, mut count) = (0.0, 0.0);
    for (k, ratio) in [4.0, 4.35, 2.0, 2.0, 1.0, 1.0].into_iter().enumerate() {
        let scene = tissue(k as u64, ratio);
        let angle = 360.0 * rng.uniform();
        let off = [
            120.0 * ratio * (rng.uniform() - 0.5),
            90.0 * ratio * (rng.uniform() - 0.5),
        ];
        let from_scene = view_from_scene(ratio, angle, off);
        let target = scene.frame(SIZE, &target_from_scene(), 0.008, 1);
        let view = scene.frame(SIZE, &from_scene, 0.008, 2 + k as u64);
        let told = seen((&view, None), (&target, None), ratio, None);
        let found = told
            .registration
            .found()
            .unwrap_or_else(|| panic!("{ratio} {angle} {told:?}"));
        let right = truth(&from_scene);
        let back = right.inverse().unwrap().apply(CENTRE);
        let at = found.target_from_view.apply(back);
        let error = f64::hypot(at[0] - CENTRE[0], at[1] - CENTRE[1]);
        assert!(error <= 0.1 * ratio, "{ratio}: {error}");
        assert!(told.rivals.is_empty());
        over_sigma += (apart(&found.target_from_view, &right, SIZE) / found.sigma_px).powi(2) / 2.0;
        count += 1.0;
    }
    let ratio = f64::sqrt(over_sigma / count);
    assert!((0.2..2.5).contains(&ratio), "errors are {ratio} sigmas");
}

#[test]
fn what_is_blurred_dark_noisy_and_hidden_by_two_fifths_is_found() {
    let ratio = 4.0;
    let scene = tissue(11, ratio);
    let target = scene.frame(SIZE, &target_from_scene(), 0.008, 1);
    let from_scene = view_from_scene(ratio, 77.0, [300.0, -200.0]);
    let right = truth(&from_scene);
    let off = |view: &GrayImage, what: &str| {
        let told = seen((view, None), (&target, None), ratio, None);
        let found = told.registration.found();
        let found = found.unwrap_or_else(|| panic!("{what}: {:?}", told.registration.outcome));
        let back = right.inverse().unwrap().apply(CENTRE);
        let at = found.target_from_view.apply(back);
        f64::hypot(at[0] - CENTRE[0], at[1] - CENTRE[1])
    };
    let blurred = scene.light(SIZE, &from_scene, 4.0);
    assert!(off(&frame(&blurred, SIZE, 0.008, 2), "blur") < 4.0);
    let light = scene.light(SIZE, &from_scene, 0.0);
    let dark: Vec<f64> = light.iter().map(|v| 0.2 * v).collect();
    assert!(off(&frame(&dark, SIZE, 0.01, 3), "dark") < 0.8);
    assert!(off(&frame(&light, SIZE, 0.06, 4), "noise") < 1.6);
    let hidden = |i: usize| {
        let p = right.apply([(i % SIZE[0]) as f64, (i / SIZE[0]) as f64]);
        (120.0..376.0).contains(&p[0]) && (0.0..480.0).contains(&p[1])
    };
    let grey: Vec<f64> = light
        .iter()
        .enumerate()
        .map(|(i, v)| if hidden(i) { 0.4 } else { *v })
        .collect();
    assert!(off(&frame(&grey, SIZE, 0.008, 5), "hidden") < 1.6);
}

#[test]
fn a_few_degrees_are_looked_at_where_they_are_known_and_no_others() {
    let scene = tissue(21, 2.0);
    let target = scene.frame(SIZE, &target_from_scene(), 0.008, 1);
    let from_scene = view_from_scene(2.0, 33.0, [40.0, 25.0]);
    let view = scene.frame(SIZE, &from_scene, 0.008, 2);
    let angle_rad = truth(&from_scene).linear.rotation_angle().unwrap();
    let around = |off: f64| {
        Some(RotationPrior {
            angle_rad: angle_rad + off,
            tolerance_rad: 0.17,
        })
    };
    assert!(
        seen((&view, None), (&target, None), 2.0, around(0.1))
            .registration
            .found()
            .is_some()
    );
    assert!(
        seen((&view, None), (&target, None), 2.0, around(1.0))
            .registration
            .found()
            .is_none()
    );
}

#[test]
fn other_specimens_blank_glass_and_mirror_images_are_not_found() {
    for (k, ratio) in [4.0, 2.0, 1.0].into_iter().enumerate() {
        let seed = 30 + k as u64;
        let target = tissue(seed, ratio).frame(SIZE, &target_from_scene(), 0.008, 1);
        let from_scene = view_from_scene(ratio, 20.0, [30.0, 10.0]);
        let no = |view: &GrayImage, what: &str| {
            let told = seen((view, None), (&target, None), ratio, None);
            assert!(
                told.registration.found().is_none(),
                "{what} at {ratio}: {told:?}"
            );
        };
        no(
            &tissue(seed + 100, ratio).frame(SIZE, &from_scene, 0.008, 2),
            "another specimen",
        );
        no(
            &frame(&vec![0.85; SIZE[0] * SIZE[1]], SIZE, 0.008, 3),
            "blank glass",
        );
        no(
            &frame(&vec![0.85; SIZE[0] * SIZE[1]], SIZE, 0.0, 3),
            "a clean blank",
        );
        let view = tissue(seed, ratio).frame(SIZE, &from_scene, 0.008, 4);
        let mirror = GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| view.get(SIZE[0] - 1 - x, y));
        no(&mirror.unwrap(), "its mirror image");
    }
}

#[test]
fn a_lattice_and_two_equal_places_are_never_told_as_one() {
    // Also so fine that a block reaches its neighbours' places.
    for (ratio, spacing) in [
        (4.0, 40.0),
        (4.0, 24.0),
        (2.0, 33.0),
        (1.0, 29.0),
        (1.0, 25.0),
    ] {
        let scene = Scene::lattice(spacing, 500.0 * ratio, 0.2 * spacing);
        let target = scene.frame(SIZE, &target_from_scene(), 0.008, 1);
        let view = scene.frame(SIZE, &view_from_scene(ratio, 12.0, [9.0, 5.0]), 0.008, 2);
        let told = seen((&view, None), (&target, None), ratio, None);
        assert!(
            told.registration.found().is_none() || !told.rivals.is_empty(),
            "a lattice at {ratio}: {told:?}"
        );
    }
    // What the target shows lies in the view twice.
    let once: Vec<Spot> = Scene::random(50, 900, 300.0, 2.5..18.0).spots;
    let twice = once.iter().flat_map(|s| {
        [-600.0, 600.0].map(|x| Spot {
            at: [s.at[0] + x, s.at[1]],
            ..*s
        })
    });
    let scene = Scene {
        spots: twice.collect(),
    };
    let target = Scene { spots: once }.frame(SIZE, &target_from_scene(), 0.008, 1);
    let view = scene.frame(SIZE, &view_from_scene(4.0, 5.0, [0.0; 2]), 0.008, 2);
    let told = seen((&view, None), (&target, None), 4.0, None);
    assert!(
        told.registration.found().is_none() || told.rivals.len() == 1,
        "{told:?}"
    );
    if let Some(rival) = told.rivals.first() {
        let [x, y] = rival.shift_px;
        assert!((f64::hypot(x, y) - 1200.0).abs() < 2.0, "{x} {y}");
    }
    // Whichever of the two is found otherwise, the other one looks like it.
    for x in [-600.0, 600.0] {
        let found = truth(&view_from_scene(4.0, 5.0, [-x, 0.0]));
        let alike = beside(&view, &target, &found);
        let [by_x, by_y] = alike[0].shift_px;
        let off = (f64::hypot(by_x, by_y) - 1200.0).abs();
        assert!(alike.len() == 1 && off < 2.0, "{x}: {alike:?}");
    }
}

/// What is as like the target, at 4:1.
fn beside(view: &GrayImage, target: &GrayImage, first: &Affine2) -> Vec<Rival> {
    let scale = ScalePrior {
        ratio: 4.0,
        tolerance: 0.04,
    };
    let picture = |image| Picture {
        image,
        counts: None,
    };
    let [view, target] = [view, target].map(picture);
    look_alikes(&view, &target, scale, first, &Options::default())
}

/// A peak is known to several pixels there, and the pixels are asked within one and a half.
#[test]
fn on_a_large_camera_a_twin_is_told_where_it_lies_and_the_pixels_do_not_dismiss_it() {
    const LARGE: [usize; 2] = [2448, 2048];
    let middle = LARGE.map(|n| (n as f64 - 1.0) / 2.0);
    let once = Scene::random(50, 900, 1200.0, 8.0..30.0).spots;
    for (k, angle_deg) in [93.3].into_iter().enumerate() {
        let twice = once.iter().flat_map(|s| {
            [-2400.0, 2400.0].map(|x| Spot {
                at: [s.at[0] + x, s.at[1] + 37.0],
                ..*s
            })
        });
        let both = Scene {
            spots: twice.collect(),
        };
        let one = Scene {
            spots: once.clone(),
        };
        let target_from_scene = placed(1.0, 0.0, [0.0; 2], middle);
        let view_from_scene = |off| placed(0.25, -angle_deg, off, middle);
        let target = one.frame(LARGE, &target_from_scene, 0.008, 1);
        let view = both.frame(LARGE, &view_from_scene([0.0; 2]), 0.008, 2 + k as u64);
        // The target's middle lies at the first place, or at the second.
        let at = |x: f64| {
            let back = view_from_scene([-x, -37.0]).inverse().unwrap();
            target_from_scene.after(&back)
        };
        let (first, second) = (at(-2400.0), at(2400.0));
        let alike = beside(&view, &target, &first);
        assert_eq!(alike.len(), 1, "{angle_deg}: {alike:?}");
        let there = second.inverse().unwrap().apply(middle);
        let told = alike[0].target_from_view.apply(there);
        let off_px = f64::hypot(told[0] - middle[0], told[1] - middle[1]);
        // Target pixels: a quarter of one of the view.
        assert!(off_px < 1.0, "{angle_deg}: {off_px} px");
        let estimate = Estimate {
            target_from_view: first,
            covariance: [[0.0; 6]; 6],
            sigma_px: 0.1,
            corner_sigma_px: 0.1,
            sigma_angle_rad: 1e-4,
        };
        let pair = Pair::new(&view, &target, 4.0);
        let open = undecided(&pair, &estimate, (&target, &[]), &alike, true, |_| true);
        assert!(open.is_some(), "{angle_deg}: the twin is dismissed");
    }
}

#[test]
fn a_place_of_which_half_is_in_view_has_no_look_alikes_in_what_is_less_like_it() {
    let mut others = 0;
    for seed in 0..6 {
        let scene = tissue(60 + seed, 4.0);
        let target = scene.frame(SIZE, &target_from_scene(), 0.008, 1);
        // The target's middle lies at the edge.
        let view_from_scene = view_from_scene(4.0, 30.0 * seed as f64, [1270.0, 0.0]);
        let view = scene.frame(SIZE, &view_from_scene, 0.008, 2);
        let told = seen((&view, None), (&target, None), 4.0, None);
        let found = truth(&view_from_scene);
        let alike = beside(&view, &target, &found);
        assert!(alike.is_empty(), "{seed}: {alike:?}");
        others += told.perhaps.len();
    }
    assert!(others > 20, "{others}");
}

/// Thirty soft shadows of 15 %, fixed to the sensor.
fn behind_dust(image: &GrayImage, spots: &[[f64; 3]]) -> GrayImage {
    GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        let shadow = |[sx, sy, r]: &[f64; 3]| {
            let d = (x as f64 - sx).powi(2) + (y as f64 - sy).powi(2);
            1.0 - 0.15 * (-0.5 * d / (r * r)).exp()
        };
        image.get(x, y) * spots.iter().map(shadow).product::<f64>() as f32
    })
    .unwrap()
}

#[test]
fn dust_is_masked_and_what_it_hides_is_found_behind_it() {
    let mut rng = SplitMix64::new(60);
    let spots: Vec<[f64; 3]> = (0..30)
        .map(|_| {
            [
                640.0 * rng.uniform(),
                480.0 * rng.uniform(),
                4.0 + 8.0 * rng.uniform(),
            ]
        })
        .collect();
    let free = |p: Vec2| {
        !spots
            .iter()
            .any(|[x, y, r]| f64::hypot(p[0] - x, p[1] - y) < 3.0 * r + 4.0)
    };
    let counts: &Counts<'_> = &free;
    // Sparse: a few dozen things in the field.
    let scene = Scene::random(61, 220, 500.0, 4.0..12.0);
    let from_scene = view_from_scene(1.0, 0.0, [90.0, -60.0]);
    let target = behind_dust(&scene.frame(SIZE, &target_from_scene(), 0.008, 1), &spots);
    let view = behind_dust(&scene.frame(SIZE, &from_scene, 0.008, 2), &spots);
    let told = seen((&view, Some(counts)), (&target, Some(counts)), 1.0, None);
    if let Some(found) = told.registration.found() {
        let off = apart(&found.target_from_view, &truth(&from_scene), SIZE);
        assert!(off < 1.0 || !told.rivals.is_empty(), "{off}: {told:?}");
    }
    // Glass with the same dust, masked: nothing is left to agree.
    let blank = |seed| frame(&vec![0.85; SIZE[0] * SIZE[1]], SIZE, 0.008, seed);
    let (one, other) = (
        behind_dust(&blank(3), &spots),
        behind_dust(&blank(4), &spots),
    );
    let told = seen((&one, Some(counts)), (&other, Some(counts)), 1.0, None);
    assert!(told.registration.found().is_none(), "{told:?}");
}

#[test]
fn the_answer_is_the_same_on_any_number_of_threads() {
    let scene = tissue(70, 4.0);
    let target = scene.frame(SIZE, &target_from_scene(), 0.008, 1);
    let view = scene.frame(SIZE, &view_from_scene(4.0, -50.0, [200.0, 100.0]), 0.008, 2);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap()
            .install(|| seen((&view, None), (&target, None), 4.0, None))
    };
    assert_eq!(on(1), on(3));
}

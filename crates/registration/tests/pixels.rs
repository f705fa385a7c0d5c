//! Images computed by formula, and what is done to them.

use scopeservo_features::{GrayImage, Mask};
use scopeservo_geometry::{Affine2, Mat2, Similarity, SplitMix64, Vec2};
use scopeservo_registration::Estimate;
use scopeservo_registration::pixels::{
    Abstained, Judgement, Pictures, Refined, Sharpness, refine, sharpness, weigh,
};

const SIZE: [usize; 2] = [320, 240];

/// A sum of waves, known everywhere and under any blur.
struct Scene {
    /// Wave number along x and y, phase, amplitude.
    waves: Vec<[f64; 4]>,
}

impl Scene {
    fn new(seed: u64) -> Self {
        let mut rng = SplitMix64::new(seed);
        let waves = (0..45).map(|_| {
            let k = (0.04f64.ln() + rng.uniform() * (1.4f64 / 0.04).ln()).exp();
            let (s, c) = (std::f64::consts::TAU * rng.uniform()).sin_cos();
            let phase = std::f64::consts::TAU * rng.uniform();
            [k * c, k * s, phase, 0.06 * (k / 0.2).powf(-0.5)]
        });
        Self {
            waves: waves.collect(),
        }
    }

    /// As a camera sees it whose pixel p lies at `scene_from_pixel(p)`, under a Gaussian blur of `blur` of its pixels. Along a row each wave
    /// turns on by one angle.
    fn image(&self, scene_from_pixel: &Affine2, blur: f64) -> GrayImage {
        let sigma = scene_from_pixel.linear.det().sqrt() * blur;
        let mut values = vec![0.5; SIZE[0] * SIZE[1]];
        for (y, row) in values.chunks_exact_mut(SIZE[0]).enumerate() {
            let p = scene_from_pixel.apply([0.0, y as f64]);
            let [[ax, _], [ay, _]] = scene_from_pixel.linear.0;
            for &[kx, ky, phase, amplitude] in &self.waves {
                let damped = amplitude * (-0.5 * (kx * kx + ky * ky) * sigma * sigma).exp();
                let (mut s, mut c) = (kx * p[0] + ky * p[1] + phase).sin_cos();
                let (ds, dc) = (kx * ax + ky * ay).sin_cos();
                for value in row.iter_mut() {
                    *value += damped * c;
                    (s, c) = (s * dc + c * ds, c * dc - s * ds);
                }
            }
        }
        let values = values.iter().map(|&v| v as f32).collect();
        GrayImage::new(SIZE[0], SIZE[1], values).unwrap()
    }
}

fn middle() -> Vec2 {
    SIZE.map(|side| (side as f64 - 1.0) / 2.0)
}

/// Of an image whose middle shows `at`.
fn placed(at: Vec2, angle_rad: f64, pitch: f64) -> Affine2 {
    let turned = Affine2::from(Similarity {
        scale: pitch,
        angle_rad,
        offset: [0.0; 2],
    });
    let off = turned.apply(middle());
    Affine2 {
        offset: [at[0] - off[0], at[1] - off[1]],
        ..turned
    }
}

struct Case {
    view: GrayImage,
    target: GrayImage,
    target_from_view: Affine2,
    zoom: f64,
}

/// The target has pixels of 1; the view's are `zoom` times as large.
fn case(seed: u64, zoom: f64, angle_rad: f64, [view_blur, target_blur]: [f64; 2]) -> Case {
    let scene = Scene::new(seed);
    let view = placed([3.3, -8.7], 0.1, zoom);
    let target = placed([10.4, 6.2], 0.1 + angle_rad, 1.0);
    Case {
        view: scene.image(&view, view_blur),
        target: scene.image(&target, target_blur),
        target_from_view: target.inverse().unwrap().after(&view),
        zoom,
    }
}

fn noisy(image: &GrayImage, sigma: f64, seed: u64) -> GrayImage {
    let mut rng = SplitMix64::new(seed);
    changed(image, |_, v| {
        let v = v + sigma * rng.normal();
        (v.clamp(0.0, 1.0) * 255.0).round() / 255.0
    })
}

fn changed(image: &GrayImage, mut change: impl FnMut(Vec2, f64) -> f64) -> GrayImage {
    GrayImage::from_fn(image.width(), image.height(), |x, y| {
        let v = f64::from(image.get(x, y));
        change([x as f64, y as f64], v) as f32
    })
    .unwrap()
}

fn at(image: &GrayImage, p: Vec2) -> f64 {
    f64::from(image.get(p[0] as usize, p[1] as usize))
}

impl Case {
    fn noisy(mut self, sigma: f64) -> Self {
        self.view = noisy(&self.view, sigma, 5);
        self.target = noisy(&self.target, sigma, 6);
        self
    }

    fn view(mut self, change: impl FnMut(Vec2, f64) -> f64) -> Self {
        self.view = changed(&self.view, change);
        self
    }

    /// A start that is off by so much in the middle of the view, coarse pixels, and known as well as that.
    fn start(&self, off: f64) -> Estimate {
        let off_px = off * self.zoom;
        let turn = off / 200.0;
        let t = &self.target_from_view;
        let wrong = Affine2 {
            linear: Mat2::rotation(turn) * t.linear,
            offset: t.offset,
        };
        let [p, q] = [wrong.apply(middle()), t.apply(middle())];
        let wrong = Affine2 {
            offset: [0, 1].map(|k| wrong.offset[k] + q[k] - p[k] + off_px * [0.8, -0.6][k]),
            ..wrong
        };
        let [x, y] = middle();
        // Shift and turn about the middle, each known as well as they are off.
        let way = |linear: Mat2, shift: Vec2| {
            let [bx, by] = linear * [x, y];
            let [[a, b], [c, d]] = linear.0;
            [a, b, shift[0] - bx, c, d, shift[1] - by]
        };
        let zero = Mat2::diagonal(0.0, 0.0);
        let turned = Mat2([[0.0, -1.0], [1.0, 0.0]]) * (turn * self.zoom);
        let mut covariance = [[0.0; 6]; 6];
        for deviation in [
            way(zero, [off_px, 0.0]),
            way(zero, [0.0, off_px]),
            way(turned, [0.0; 2]),
        ] {
            for (row, a) in covariance.iter_mut().zip(deviation) {
                for (cell, b) in row.iter_mut().zip(deviation) {
                    *cell += a * b;
                }
            }
        }
        Estimate {
            target_from_view: wrong,
            covariance,
            sigma_px: off_px,
            corner_sigma_px: 1.5 * off_px,
            sigma_angle_rad: turn,
        }
    }

    fn pictures(&self) -> Pictures<'_> {
        Pictures {
            view: &self.view,
            target: &self.target,
            of_view: None,
            of_target: None,
        }
    }

    fn refine(&self, off: f64) -> Result<Refined, Abstained> {
        refine(&self.pictures(), &self.start(off))
    }

    /// Target pixels in the middle of the view.
    fn error(&self, found: &Affine2) -> f64 {
        let (p, q) = (found.apply(middle()), self.target_from_view.apply(middle()));
        f64::hypot(p[0] - q[0], p[1] - q[1])
    }

    fn turned_rad(&self, found: &Affine2) -> f64 {
        let left = found.after(&self.target_from_view.inverse().unwrap());
        left.linear.rotation_angle().unwrap()
    }
}

/// Soft shadows fixed to a camera: middle, radius, depth.
fn dust(seed: u64, count: usize) -> impl Fn(Vec2) -> f64 {
    let mut rng = SplitMix64::new(seed);
    let [w, h] = SIZE.map(|v| v as f64);
    let all: Vec<[f64; 4]> = (0..count)
        .map(|_| {
            let at = [rng.uniform() * w, rng.uniform() * h];
            [at[0], at[1], 5.0 + 10.0 * rng.uniform(), 0.15]
        })
        .collect();
    move |p| {
        all.iter()
            .map(|&[x, y, r, depth]| {
                let d = ((p[0] - x).powi(2) + (p[1] - y).powi(2)) / (r * r);
                1.0 - depth * (-0.5 * d).exp()
            })
            .product()
    }
}

#[test]
fn a_transform_is_refined_to_the_noise_at_every_scale_and_known_as_well_as_it_says() {
    // At 4:1 so small a target has 80 x 60 pixels of the view's: a quarter of what a camera's has, and so twice the noise.
    for (zoom, most_px) in [(1.0, 0.004), (2.0, 0.008), (4.0, 0.04)] {
        let (mut errors, mut pulls) = (Vec::new(), Vec::new());
        for seed in 0..6 {
            let angle = 0.4 * seed as f64;
            let case = case(seed, zoom, angle, [0.6, 0.6]).noisy(0.008);
            let found = case.refine(0.3).unwrap().estimate;
            let off = case.error(&found.target_from_view);
            errors.push(off);
            pulls.push(off / found.sigma_px / std::f64::consts::SQRT_2);
            pulls.push(case.turned_rad(&found.target_from_view).abs() / found.sigma_angle_rad);
        }
        errors.sort_by(f64::total_cmp);
        assert!(errors[4] <= most_px, "{zoom}:1 {errors:?}");
        let mean_sq = pulls.iter().map(|p| p * p).sum::<f64>() / pulls.len() as f64;
        assert!(mean_sq < 4.0 && mean_sq > 0.1, "{zoom}:1 {pulls:?}");
    }
}

#[test]
fn whatever_lies_between_it_helps_or_abstains() {
    type Change = Box<dyn Fn(Case) -> Case>;
    let covered = |p: Vec2| p[0] > 0.6 * SIZE[0] as f64;
    let other = Scene::new(77).image(&placed([0.0; 2], 0.4, 1.0), 1.0);
    let changes: Vec<(&str, Change)> = vec![
        (
            "covered by grey",
            Box::new(move |c| c.view(|p, v| if covered(p) { 0.4 } else { v })),
        ),
        (
            "covered by something else",
            Box::new(move |c| c.view(|p, v| if covered(p) { at(&other, p) } else { v })),
        ),
        ("gamma 2", Box::new(|c| c.view(|_, v| v.max(0.0).powf(2.0)))),
        (
            "gamma 0.5",
            Box::new(|c| c.view(|_, v| v.max(0.0).powf(0.5))),
        ),
        ("a tenth of the light", Box::new(|c| c.view(|_, v| 0.1 * v))),
        (
            "1.8 times the light, clipped",
            Box::new(|c| c.view(|_, v| (1.8 * v).min(1.0))),
        ),
        (
            "darker by 80",
            Box::new(|c| c.view(|_, v| (v - 80.0 / 255.0).max(0.0))),
        ),
        (
            "30 soft shadows",
            Box::new(|c| {
                let d = dust(3, 30);
                c.view(move |p, v| v * d(p))
            }),
        ),
        (
            "light from a side",
            Box::new(|c| c.view(|p, v| v * (0.5 + 0.002 * p[0]))),
        ),
    ];
    for zoom in [1.0, 4.0] {
        for (name, change) in &changes {
            for noise in [0.01, 0.05] {
                let case = change(case(11, zoom, 0.03, [0.6, 0.6])).noisy(noise);
                let (start, found) = (case.start(0.1), case.refine(0.1));
                let was = case.error(&start.target_from_view) / zoom;
                let told = found
                    .as_ref()
                    .map(|f| case.error(&f.estimate.target_from_view) / zoom);
                if let Ok(is) = told {
                    assert!(is < was + 0.05, "{zoom}:1 {name}, noise {noise}: {is}");
                    assert!(noise > 0.01 || is < 0.06, "{zoom}:1 {name}: {is}");
                }
                assert!(noise > 0.01 || told.is_ok(), "{zoom}:1 {name}: {found:?}");
            }
        }
    }
}

#[test]
fn out_of_focus_it_helps_or_abstains_whichever_image_is_the_softer() {
    for blurs in [
        [2.0, 0.6],
        [0.6, 2.0],
        [4.0, 0.6],
        [0.6, 4.0],
        [4.0, 4.0],
        [6.0, 0.6],
    ] {
        for seed in [21, 22] {
            let case = case(seed, 1.0, 0.03, blurs).noisy(0.01);
            let found = case.refine(0.1);
            let told = found
                .as_ref()
                .map(|f| case.error(&f.estimate.target_from_view));
            if let Ok(is) = told {
                assert!(
                    is < if blurs[0] > 4.0 { 0.15 } else { 0.06 },
                    "{blurs:?}: {is}"
                );
            }
            assert!(blurs[0] > 4.0 || told.is_ok(), "{blurs:?}: {found:?}");
        }
    }
}

#[test]
fn a_rough_start_is_refined_in_softer_images_first() {
    for seed in [31, 32, 33] {
        let case = case(seed, 1.0, 0.5, [0.6, 0.6]).noisy(0.01);
        let found = case.refine(1.5).unwrap();
        let off = case.error(&found.estimate.target_from_view);
        assert!(off < 0.01, "{off}");
    }
}

#[test]
fn nothing_and_something_else_are_left_as_they_are() {
    let blank = case(1, 1.0, 0.0, [0.6, 0.6]).view(|_, _| 0.7);
    let empty = Case {
        target: blank.view.clone(),
        ..blank
    }
    .noisy(0.01);
    assert!(
        matches!(empty.refine(0.1), Err(Abstained::TooLittleTexture { .. })),
        "{:?}",
        empty.refine(0.1)
    );
    for seed in 40..46 {
        let one = case(seed, 1.0, 0.0, [0.6, 0.6]);
        let other = Case {
            view: case(seed + 100, 1.0, 0.0, [0.6, 0.6]).view,
            ..one
        }
        .noisy(0.01);
        assert!(other.refine(0.3).is_err(), "{:?}", other.refine(0.3));
    }
}

#[test]
fn what_is_masked_out_does_not_count() {
    // The same picture covers three quarters of both, where it is: fixed to the camera.
    let fixed = Scene::new(99).image(&placed([0.0; 2], 0.4, 1.0), 0.6);
    let covers = |p: Vec2| p[0] > 0.25 * SIZE[0] as f64;
    let put = |image: &GrayImage| changed(image, |p, v| if covers(p) { at(&fixed, p) } else { v });
    let case = case(51, 1.0, 0.0, [0.6, 0.6]);
    let dirty = Case {
        view: put(&case.view),
        target: put(&case.target),
        ..case
    }
    .noisy(0.01);
    let mask = Mask::of_cells(SIZE[0], SIZE[1], 8, |p| !covers([p[0] + 4.0, p[1]]));
    let masked = Pictures {
        of_view: Some(&mask),
        of_target: Some(&mask),
        ..dirty.pictures()
    };
    let found = refine(&masked, &dirty.start(0.2)).unwrap();
    let off = dirty.error(&found.estimate.target_from_view);
    assert!(off < 0.05, "{off}");
    // Where everything stays the camera agrees with itself, and that is no evidence.
    let stays = Affine2::IDENTITY;
    let all = weigh(&dirty.pictures(), &stays, &[]);
    assert_eq!(all.judgement, Judgement::Agrees);
    let free = weigh(&masked, &stays, &[]);
    assert_ne!(free.judgement, Judgement::Agrees, "{free:?}");
}

#[test]
fn pixels_agree_where_the_transform_is_right_and_contradict_one_that_is_wrong() {
    for zoom in [1.0, 2.0] {
        for seed in [61, 62, 63] {
            let right = case(seed, zoom, 0.3, [0.6, 0.6]).noisy(0.02);
            let t = right.target_from_view;
            let seen = weigh(&right.pictures(), &t, &[]);
            assert_eq!(seen.judgement, Judgement::Agrees, "{seen:?}");
            assert!(seen.share > 0.9, "{seen:?}");
            // Half covered is enough.
            let half = case(seed, zoom, 0.3, [0.6, 0.6])
                .view(|p, v| if p[0] > 160.0 { 0.5 } else { v })
                .noisy(0.02);
            let seen = weigh(&half.pictures(), &t, &[]);
            assert_ne!(seen.judgement, Judgement::Contradicts, "{seen:?}");
            assert!(
                zoom > 1.0 || seen.judgement == Judgement::Agrees,
                "{seen:?}"
            );
            for off in [5.0, 40.0] {
                let wrong = Affine2 {
                    offset: [t.offset[0] + off * zoom, t.offset[1]],
                    ..t
                };
                let seen = weigh(&right.pictures(), &wrong, &[]);
                assert_eq!(
                    seen.judgement,
                    Judgement::Contradicts,
                    "{zoom} {off} {seen:?}"
                );
            }
        }
    }
    let blank = case(1, 1.0, 0.0, [0.6, 0.6]).view(|_, _| 0.7);
    let empty = Case {
        target: blank.view.clone(),
        ..blank
    }
    .noisy(0.01);
    let seen = weigh(&empty.pictures(), &empty.target_from_view, &[]);
    assert_eq!((seen.judgement, seen.asked), (Judgement::CannotTell, 0));
}

#[test]
fn blocks_without_features_are_asked_alone_where_there_are_enough() {
    let case = case(71, 1.0, 0.1, [0.6, 0.6]).noisy(0.01);
    // A feature on each spot of the left half.
    let fitted: Vec<Vec2> = (0..2400)
        .map(|i| [4.0 * (i % 40) as f64, 4.0 * (i / 40) as f64])
        .collect();
    let seen = weigh(&case.pictures(), &case.target_from_view, &fitted);
    assert!(seen.held_out && seen.asked >= 10, "{seen:?}");
    assert!(seen.blocks.iter().all(|b| b.in_view[0] > 150.0));
    let everywhere: Vec<Vec2> = fitted
        .iter()
        .flat_map(|&[x, y]| [[x, y], [x + 160.0, y]])
        .collect();
    let all = weigh(&case.pictures(), &case.target_from_view, &everywhere);
    assert!(!all.held_out && all.asked > seen.asked, "{all:?}");
}

/// Features lie on what both images show, so that the blocks without any are those that something covers.
#[test]
fn what_covers_two_fifths_is_no_evidence_and_what_looks_alike_in_a_quarter_or_scattered_is() {
    let other = Scene::new(77).image(&placed([0.0; 2], 0.4, 1.0), 1.0);
    let seen = |seed: u64, alike: f64| {
        let case = case(seed, 1.0, 0.1, [0.6, 0.6])
            .view(|p, v| if p[0] < alike { v } else { at(&other, p) })
            .noisy(0.01);
        let fitted: Vec<Vec2> = (0..4800)
            .map(|i| [4.0 * (i % 80) as f64, 4.0 * (i / 80) as f64])
            .filter(|p| p[0] < alike)
            .collect();
        weigh(&case.pictures(), &case.target_from_view, &fitted)
    };
    for seed in [81, 82, 83] {
        for alike in [144.0, 192.0, 208.0, 256.0] {
            let covered = seen(seed, alike);
            assert_ne!(covered.judgement, Judgement::Contradicts, "{covered:?}");
        }
        // Grey over two fifths, in a corner or in the middle of one side.
        for at in [[0.0, 0.0], [1.0, 0.4], [0.3, 1.0]] {
            let case = case(seed, 1.0, 0.1, [0.6, 0.6]);
            let (w, h) = (SIZE[0] as f64, SIZE[1] as f64);
            let (sides, share) = ([0.63 * w, 0.63 * h], [0.37 * w, 0.37 * h]);
            let covers =
                |p: Vec2| (0..2).all(|k| (0.0..sides[k]).contains(&(p[k] - at[k] * share[k])));
            let case = case
                .view(|p, v| if covers(p) { 0.5 } else { v })
                .noisy(0.01);
            let all = (0..4800).map(|i| [4.0 * (i % 80) as f64, 4.0 * (i / 80) as f64]);
            let fitted: Vec<Vec2> = all.filter(|p| !covers(*p)).collect();
            let covered = weigh(&case.pictures(), &case.target_from_view, &fitted);
            assert_ne!(
                covered.judgement,
                Judgement::Contradicts,
                "{at:?} {covered:?}"
            );
        }
        // Of another place as much looks alike, in spots that lie scattered, as dirt on the camera does.
        let spot = |p: Vec2| {
            let cell = p.map(|v| (v / 40.0) as u64);
            (cell[0] * 7 + cell[1] * 5 + seed) % 5 < 2
        };
        let case = case(seed, 1.0, 0.1, [0.6, 0.6])
            .view(|p, v| if spot(p) { v } else { at(&other, p) })
            .noisy(0.01);
        let all = (0..4800).map(|i| [4.0 * (i % 80) as f64, 4.0 * (i / 80) as f64]);
        let fitted: Vec<Vec2> = all.filter(|p| spot(*p)).collect();
        let scattered = weigh(&case.pictures(), &case.target_from_view, &fitted);
        assert_eq!(scattered.judgement, Judgement::Contradicts, "{scattered:?}");
        for alike in [48.0, 80.0] {
            let elsewhere = seen(seed, alike);
            assert_eq!(elsewhere.judgement, Judgement::Contradicts, "{elsewhere:?}");
            assert!(elsewhere.held_out);
        }
    }
}

fn sharp_of(case: &Case) -> Option<Sharpness> {
    let pictures = Pictures {
        view: &case.view,
        target: &case.target,
        of_view: None,
        of_target: None,
    };
    sharpness(&pictures, &case.target_from_view)
}

fn sharp(case: &Case) -> Sharpness {
    sharp_of(case).expect("it can be told")
}

/// The blur that the view has more than the target, as it is and as it is found.
fn softer_is(name: &str, found: &Sharpness, truth: f64, within: f64) {
    let off = (found.softer_px2 - truth).abs();
    assert!(off <= within, "{name}: {found:?}, {truth}");
}

#[test]
fn how_much_softer_a_view_is_comes_out_as_the_variance_of_its_blur() {
    let blurs = [
        [0.6, 0.6],
        [0.7, 0.6],
        [0.8, 0.6],
        [1.2, 0.6],
        [0.6, 1.2],
        [2.0, 0.7],
        [2.2, 2.0],
        [3.0, 0.6],
    ];
    for (seed, blurs) in (1..).zip(blurs) {
        let [view, target] = blurs;
        let truth = view * view - target * target;
        for angle_rad in [0.0, 0.4] {
            let found = sharp(&case(seed, 1.0, angle_rad, blurs));
            softer_is(
                &format!("{blurs:?}"),
                &found,
                truth,
                0.06 + 0.1 * truth.abs(),
            );
            let is_sharper = found.ratio >= 1.0;
            assert!(
                is_sharper == (truth <= 0.0) || truth.abs() < 0.1,
                "{found:?}"
            );
        }
    }
}

#[test]
fn light_tone_noise_and_what_covers_a_part_make_no_difference_to_how_soft_a_view_is() {
    type Change = fn(&GrayImage, u64) -> GrayImage;
    let all: [(&str, Change); 6] = [
        ("half the light", |i, _| changed(i, |_, v| 0.5 * v)),
        ("gamma", |i, _| changed(i, |_, v| v.max(0.0).powf(1.6))),
        ("less contrast", |i, _| changed(i, |_, v| 0.2 + 0.5 * v)),
        ("noise", |i, seed| {
            noisy(&changed(i, |_, v| 0.5 + 0.3 * (v - 0.5)), 0.004, seed)
        }),
        ("dust", |i, seed| {
            let takes = dust(seed, 12);
            changed(i, |p, v| v * takes(p))
        }),
        ("a quarter covered", |i, _| {
            changed(i, |p, v| if p[0] < 80.0 { 0.3 } else { v })
        }),
    ];
    for (name, change) in all {
        for (seed, blurs) in [(3, [0.7, 0.7]), (4, [1.0, 0.7]), (5, [0.7, 1.0])] {
            let mut case = case(seed, 1.0, 0.0, blurs);
            case.view = change(&case.view, seed);
            let truth = blurs[0] * blurs[0] - blurs[1] * blurs[1];
            softer_is(name, &sharp(&case), truth, 0.13);
        }
    }
}

#[test]
fn how_sharp_is_not_said_of_other_pixels_nor_of_nothing() {
    assert_eq!(sharp_of(&case(1, 2.0, 0.0, [0.6, 0.6])), None);
    assert_eq!(sharp_of(&case(1, 0.9, 0.0, [0.6, 0.6])), None);
    let mut blank = case(1, 1.0, 0.0, [0.6, 0.6]);
    blank.view = noisy(&changed(&blank.view, |_, _| 0.7), 0.01, 2);
    assert_eq!(sharp_of(&blank), None);
}

//! Following a view: known motions of scenes that are known everywhere.

mod common;

use common::{Scene, apart, frame, placed};
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Affine2, SplitMix64};
use scopeservo_registration::tracking::{Lost, Tracker};

const SIZE: [usize; 2] = [640, 480];
const CENTRE: [f64; 2] = [319.5, 239.5];

fn scene(seed: u64) -> Scene {
    Scene::random(seed, 2500, 450.0, 1.5..12.0)
}

fn at_rest() -> Affine2 {
    placed(1.0, 0.0, [0.0; 2], CENTRE)
}

fn reference(seed: u64) -> GrayImage {
    scene(seed).frame(SIZE, &at_rest(), 0.01, 1)
}

/// Reference from frame, for a frame that is moved by this.
fn truth(moved: &Affine2) -> Affine2 {
    at_rest().after(&moved.inverse().unwrap())
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn a_view_is_followed_from_60_px_and_a_degree_and_a_half_to_0_03_px() {
    let scene = scene(1);
    let mut tracker = Tracker::new(&reference(1)).unwrap();
    let mut rng = SplitMix64::new(4);
    let (mut errors, mut angles, mut over_sigma) = (vec![], vec![], vec![]);
    for seed in 0..24 {
        // On the rim of what is to be captured, and inside.
        let far = [60.0, 60.0, 25.0, 3.0][seed % 4];
        let way = rng.uniform() * std::f64::consts::TAU;
        let turn = [1.5, -1.5, 0.7][seed % 3];
        let scale = 1.0 + 0.003 * rng.normal();
        let to = [CENTRE[0] + far * way.cos(), CENTRE[1] + far * way.sin()];
        let moved = placed(scale, turn, [0.0; 2], to);
        let view = scene.frame(SIZE, &moved, 0.01, 100 + seed as u64);
        let found = tracker.follow(&view).unwrap();
        let right = truth(&moved);
        let error = apart(&found.target_from_view, &right, SIZE);
        let angle = |t: &Affine2| t.linear.rotation_angle().unwrap();
        errors.push(error);
        angles.push(angle(&found.target_from_view) - angle(&right));
        over_sigma.push(error / std::f64::consts::SQRT_2 / found.sigma_px);
    }
    let worst = errors.iter().copied().fold(0.0, f64::max);
    assert!(worst <= 0.03, "{worst} of {errors:?}");
    assert!(rms(&angles) < 1e-4, "{angles:?}");
    // What it says of itself is about what it does.
    let ratio = rms(&over_sigma);
    assert!((0.4..2.5).contains(&ratio), "{ratio}");
}

#[test]
fn light_and_a_hidden_quarter_move_nothing() {
    let scene = scene(2);
    let mut tracker = Tracker::new(&reference(2)).unwrap();
    let moved = placed(1.0, -0.8, [0.0; 2], [CENTRE[0] + 21.3, CENTRE[1] - 14.8]);
    let light = scene.light(SIZE, &moved, 0.0);
    let darker: Vec<f64> = light.iter().map(|v| 0.5 * v + 0.02).collect();
    let off = |t: &mut Tracker, view: &GrayImage| {
        let found = t.follow(view).unwrap();
        apart(&found.target_from_view, &truth(&moved), SIZE)
    };
    let dark = off(&mut tracker, &frame(&darker, SIZE, 0.005, 3));
    assert!(dark <= 0.03, "{dark}");
    let mut hidden = light;
    for (i, v) in hidden.iter_mut().enumerate() {
        let (x, y) = (i % SIZE[0], i / SIZE[0]);
        if (150..470).contains(&x) && (100..340).contains(&y) {
            *v = 0.3;
        }
    }
    let hidden = off(&mut tracker, &frame(&hidden, SIZE, 0.01, 4));
    assert!(hidden <= 0.06, "{hidden}");
}

#[test]
fn what_is_something_else_or_too_far_away_is_lost() {
    let mut tracker = Tracker::new(&reference(3)).unwrap();
    for seed in 10..20 {
        let other = scene(seed).frame(SIZE, &at_rest(), 0.01, seed);
        let lost = tracker.follow(&other);
        assert!(matches!(lost, Err(Lost::Elsewhere { .. })), "{lost:?}");
    }
    // The same specimen a field and a half away shares nothing with the reference.
    let away = placed(1.0, 0.0, [0.0; 2], [CENTRE[0] + 700.0, CENTRE[1]]);
    let away = Scene::random(3, 12_000, 1000.0, 1.5..12.0).frame(SIZE, &away, 0.01, 5);
    assert!(tracker.follow(&away).is_err());
    let blank = frame(&vec![0.85; SIZE[0] * SIZE[1]], SIZE, 0.01, 6);
    assert!(tracker.follow(&blank).is_err());
    let small = frame(&vec![0.85; 320 * 240], [320, 240], 0.01, 7);
    assert_eq!(tracker.follow(&small), Err(Lost::Size));
    assert!(Tracker::new(&blank).is_none_or(|mut t| t.follow(&reference(3)).is_err()));
    assert!(Tracker::new(&frame(&vec![0.5; 80 * 80], [80, 80], 0.0, 1)).is_none());
}

#[test]
fn a_lost_frame_changes_nothing_for_the_next() {
    let moved = placed(1.0, 0.4, [0.0; 2], [CENTRE[0] - 8.0, CENTRE[1] + 5.5]);
    let view = scene(4).frame(SIZE, &moved, 0.01, 2);
    let mut fresh = Tracker::new(&reference(4)).unwrap();
    let mut tracker = Tracker::new(&reference(4)).unwrap();
    let _ = tracker.follow(&scene(5).frame(SIZE, &at_rest(), 0.01, 3));
    assert_eq!(tracker.follow(&view), fresh.follow(&view));
}

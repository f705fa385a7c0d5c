//! What is fixed to the camera stays where it is, whatever the specimen does.

mod common;

use common::{Bench, clean, grey, waves};
use scopeservo_scope::{Axis, Frame, StagePose};
use scopeservo_twin::{Config, DustConfig, Mark, StageConfig};

fn dust(specks: usize) -> DustConfig {
    DustConfig {
        specks,
        radius_px: [4.0, 12.0],
        attenuation: [0.3, 0.6],
        steepness: [1, 40],
        stretch: [1.0, 4.0],
        rings: 0.2,
    }
}

fn camera(change: impl FnOnce(&mut Config)) -> Config {
    let mut config = clean(StageConfig::hexapod());
    change(&mut config);
    config
}

fn shown(frame: &Frame) -> Vec<f32> {
    frame.luminance()
}

fn x(um: f64) -> StagePose {
    StagePose::default().with_si(Axis::X, um * 1e-6)
}

#[test]
fn dust_stays_where_it_is_while_the_specimen_moves() {
    // The image without dust, of the same places, tells what the dust took.
    let bench = |specks: usize| {
        let config = camera(|c| c.camera.dust = vec![dust(specks)]);
        let bench = Bench::new(config, waves());
        bench.focus(0.0);
        bench
    };
    let (dusty, clear) = (bench(20), bench(0));
    let mut taken = [0.0, 60.0].map(|um| {
        for b in [&dusty, &clear] {
            b.move_to(x(um));
        }
        let (d, c) = (shown(&dusty.grab()), shown(&clear.grab()));
        d.iter()
            .zip(&c)
            .map(|(d, c)| d / c.max(1e-3))
            .collect::<Vec<f32>>()
    });
    let (before, after) = taken.split_at_mut(1);
    let pairs = || before[0].iter().zip(&after[0]);
    assert!(before[0].iter().filter(|&&v| v < 0.8).count() > 500);
    // Eight bits: a grey level or two.
    assert!(pairs().all(|(a, b)| (a - b).abs() < 0.04));
}

#[test]
fn dust_comes_and_goes_and_the_reticle_and_the_dead_pixels_stay() {
    let config = camera(|c| {
        c.camera.dust = vec![dust(5)];
        c.camera.dead_pixels = 12;
        c.camera.marks = vec![Mark::Reticle {
            centre_px: [320.0, 240.0],
            arm_px: 200.0,
            line_px: 1.5,
            tick_px: 20.0,
            circles_px: vec![],
            attenuation: 0.6,
        }];
    });
    let bench = Bench::new(config, grey(0.9));
    let look = || shown(&bench.grab());
    let first = look();
    bench.twin.clean_window();
    let clean = look();
    bench.twin.settle_dust(&[dust(8)], 77).unwrap();
    let other = look();
    bench.twin.clean_window();
    assert_eq!(look(), clean);
    bench.twin.settle_dust(&[dust(8)], 77).unwrap();
    assert_eq!(look(), other, "the same seed, the same dust");
    assert!(first != clean && other != clean && first != other);
    for picture in [&first, &clean, &other] {
        assert!(picture[240 * 640 + 200] < 0.6 * picture[220 * 640 + 190]);
    }
    let said = bench.twin.settle_dust(
        &[DustConfig {
            rings: 2.0,
            ..dust(1)
        }],
        1,
    );
    assert!(said.unwrap_err().to_string().contains("rings"));
}

#[test]
fn the_digits_in_the_picture_follow_the_stage() {
    let config = camera(|c| {
        c.camera.marks = vec![Mark::StagePlace {
            at_px: [20, 440],
            dot_px: 2,
            level: 1.0,
            box_level: Some(0.0),
            packed: false,
        }];
    });
    let bench = Bench::new(config, grey(0.5));
    let look = |um: f64| {
        bench.move_to(x(um));
        shown(&bench.grab())
    };
    let (here, there, again) = (look(100.0), look(-250.0), look(100.0));
    assert_eq!(here, again);
    let changed: Vec<usize> = (0..here.len()).filter(|&i| here[i] != there[i]).collect();
    assert!(!changed.is_empty());
    // Within the line, and the label X keeps its place.
    for i in changed {
        let (x, y) = (i % 640, i / 640);
        assert!((440..454).contains(&y) && x >= 20 + 2 * 6 * 2, "{x}, {y}");
    }
}

#[test]
fn a_picture_is_as_bright_as_the_light_is_set() {
    let bench = Bench::new(Config::noiseless(), grey(0.5));
    let mean = || {
        let grey = bench.grab().luminance();
        grey.iter().map(|v| f64::from(*v)).sum::<f64>() / grey.len() as f64
    };
    let light = bench.twin.light();
    assert_eq!(light.level(), Ok(1.0));
    let full = mean();
    assert_eq!(light.set_level(0.5), Ok(0.5));
    let half = mean();
    assert!((half / full - 0.5).abs() < 0.02, "{half} of {full}");
    assert!(light.set_level(f64::NAN).is_err() && light.set_level(-0.1).is_err());
    light.set_level(0.0).unwrap();
    assert!(mean() < 0.01 * full);
}

//! What is fixed to the camera stays where it is, whatever the specimen does.

mod common;

use common::{Bench, Formula, clean, grey, waves};
use scopeservo_scope::{Axis, Clock, Frame, StagePose};
use scopeservo_twin::{
    AutoExposureConfig, Config, DriftingHair, DustConfig, Mark, Specimen, StageConfig, StageFault,
};
use std::sync::Arc;

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

fn mean(picture: &[f32]) -> f32 {
    picture.iter().sum::<f32>() / picture.len() as f32
}

#[test]
fn a_camera_that_exposes_by_itself_comes_to_its_own_brightness() {
    let config = camera(|c| {
        c.camera.auto_exposure = Some(AutoExposureConfig {
            mean_level: 0.4,
            settle_s: 0.2,
            most: 4.0,
        });
    });
    let bench = Bench::new(config, grey(0.6));
    let exposure = bench.twin.camera().exposure().unwrap();
    let after = |s: f64| {
        bench.clock.sleep(std::time::Duration::from_secs_f64(s));
        mean(&shown(&bench.grab()))
    };
    after(0.0);
    after(2.0);
    assert!((after(1.0) - 0.4).abs() < 0.01);
    // A third of the light: dark at first, then as bright as before; a twentieth is more than it can make up for.
    drop(bench.twin.light().set_level(0.33));
    let dark = after(0.0);
    assert!(dark < 0.2, "{dark}");
    after(1.0);
    let again = after(1.0);
    assert!((again - 0.4).abs() < 0.02, "{again}");
    assert_eq!(
        bench.twin.camera().exposure().unwrap(),
        exposure,
        "nor says so"
    );
    drop(bench.twin.light().set_level(0.05));
    (0..4).for_each(|_| {
        after(1.0);
    });
    assert!(after(1.0) < 0.25);
    // What it is told changes the image for a moment only.
    drop(bench.twin.light().set_level(1.0));
    (0..4).for_each(|_| {
        after(1.0);
    });
    bench.twin.camera().set_exposure(exposure / 2).unwrap();
    assert!(after(0.0) < 0.3);
    after(1.0);
    assert!((after(1.0) - 0.4).abs() < 0.02);
}

/// Stripes along x, `period_um` apart: in the image they run from above to below.
fn stripes(period_um: f64) -> Arc<dyn Specimen> {
    Arc::new(Formula(move |s: [f64; 2]| {
        [0.5 + 0.3 * (std::f64::consts::TAU * s[1] / period_um).cos(); 3]
    }))
}

/// How far the stripes of a row lie along, in periods.
fn phase(picture: &[f32], row: usize, px: usize) -> f64 {
    let (mut re, mut im) = (0.0, 0.0);
    for (x, v) in picture[row * 640..row * 640 + 640 / px * px]
        .iter()
        .enumerate()
    {
        let (s, c) = (std::f64::consts::TAU * x as f64 / px as f64).sin_cos();
        (re, im) = (re + c * f64::from(*v), im + s * f64::from(*v));
    }
    im.atan2(re) / std::f64::consts::TAU
}

#[test]
fn rows_that_are_exposed_later_see_a_moving_specimen_farther_on() {
    let period_um = 40.0 * 1e6 / 448_672.0;
    let bench = |rolling: bool| {
        let config = camera(|c| {
            c.camera.rolling = rolling;
            c.camera.readout_ms = 30.0;
            c.camera.exposure_range_ms[0] = 0.05;
            (c.camera.exposure_ms, c.camera.nominal_exposure_ms) = (0.1, 0.1);
        });
        let bench = Bench::new(config, stripes(period_um));
        bench.focus(0.0);
        bench
    };
    let (rolling, global) = (bench(true), bench(false));
    assert_eq!(shown(&rolling.grab()), shown(&global.grab()), "at rest");
    let rest = shown(&global.grab());
    // At full speed, on the way over 4 mm.
    let moving = |b: &Bench| {
        b.stage
            .start_move(&StagePose::default().with_si(Axis::Y, 4e-3))
            .unwrap();
        b.sleep(0.1);
        let before = b.stage.position().unwrap().si(Axis::Y).unwrap();
        let t = b.clock.now().seconds();
        let frame = b.grab();
        let way = b.stage.position().unwrap().si(Axis::Y).unwrap() - before;
        (frame, 1e6 * way / (b.clock.now().seconds() - t))
    };
    let ((rolled, um_per_s), (whole, _)) = (moving(&rolling), moving(&global));
    assert!(um_per_s > 500.0, "{um_per_s}");
    let along = |frame: &Frame, row: usize| {
        let off = phase(&shown(frame), row, 40) - phase(&rest, row, 40);
        off - off.round()
    };
    let first = along(&whole, 0);
    let steps: Vec<f64> = (0..480)
        .map(|row| {
            let whole = along(&whole, row) - first;
            assert!((whole - whole.round()).abs() < 0.02, "{row}");
            along(&rolled, row) - first
        })
        .collect();
    // Whole periods are not seen: neighbouring rows differ by less than half of one.
    let mut way = 0.0;
    for pair in steps.windows(2) {
        let step = pair[1] - pair[0];
        way += step - step.round();
    }
    let expected_um = um_per_s * 0.030 * 479.0 / 480.0;
    let seen_um = way.abs() * period_um;
    assert!(
        (seen_um - expected_um).abs() < 0.02 * expected_um,
        "{seen_um} um and not {expected_um}"
    );
    assert!(
        (steps[0] - steps[0].round()).abs() < 0.02,
        "the first row is as early"
    );
    // The truth of a frame is that of its middle row.
    let at = |b: &Bench, f: &Frame| b.twin.truth(f.sequence).unwrap().stage.si(Axis::Y).unwrap();
    let later_um = 1e6 * (at(&rolling, &rolled) - at(&global, &whole));
    assert!((later_um - 0.5 * um_per_s * 0.030).abs() < 0.02 * expected_um);
}

#[test]
fn a_hair_drifts_through_the_image() {
    let bench = Bench::new(camera(|_| {}), grey(0.8));
    let clean = shown(&bench.grab());
    bench.twin.fault(StageFault::Hair(Some(DriftingHair {
        at_px: [100.0, 240.0],
        px_per_s: [50.0, 0.0],
        radius_px: 3.0,
        stretch: 20.0,
        angle_deg: 90.0,
        attenuation: 0.7,
    })));
    let middle = |picture: &[f32]| {
        let shade = |i: usize| f64::from((clean[i] - picture[i]).max(0.0));
        let row: Vec<f64> = (0..640).map(|x| shade(240 * 640 + x)).collect();
        let sum: f64 = row.iter().sum();
        row.iter()
            .enumerate()
            .map(|(x, v)| x as f64 * v)
            .sum::<f64>()
            / sum
    };
    let first = middle(&shown(&bench.grab()));
    bench.clock.sleep(std::time::Duration::from_secs(4));
    let later = middle(&shown(&bench.grab()));
    assert!((later - first - 200.0).abs() < 5.0, "{first} {later}");
    bench.twin.fault(StageFault::Hair(None));
    assert_eq!(shown(&bench.grab()), clean);
}

/// How much of the stripes is seen in some rows.
fn contrast(picture: &[f32], rows: std::ops::Range<usize>) -> f64 {
    let of = |row: usize| {
        let row = &picture[row * 640..(row + 1) * 640];
        let (low, high) = row
            .iter()
            .fold((f32::MAX, f32::MIN), |(a, b), v| (a.min(*v), b.max(*v)));
        f64::from((high - low) / (high + low))
    };
    let n = rows.len() as f64;
    rows.map(of).sum::<f64>() / n
}

/// What moves through the focus while it is exposed looks as the mean of the heights that it was at, and each row of a rolling shutter as at its own time.
#[test]
fn a_frame_that_is_taken_while_the_focus_moves_shows_all_heights_that_it_passed() {
    let period_um = 6.0 * 1e6 / 448_672.0;
    let mut differs: f64 = 0.0;
    for (um_per_s, exposure_ms) in [(3000.0, 20.0), (1500.0, 20.0), (5000.0, 5.0)] {
        for rolling in [false, true] {
            let config = camera(|c| {
                c.camera.rolling = rolling;
                c.camera.readout_ms = 20.0;
                (c.camera.exposure_ms, c.camera.nominal_exposure_ms) = (exposure_ms, exposure_ms);
            });
            let bench = Bench::new(config, stripes(period_um));
            // From too far to too near, in the middle of it the focus.
            let z = |bench: &Bench| bench.stage.position().unwrap().si(Axis::Z).unwrap();
            bench.focus(0.0);
            let sharp = z(&bench);
            let at = |um: f64| StagePose::default().with_si(Axis::Z, sharp + um * 1e-6);
            bench.move_to(at(-120.0));
            bench
                .stage
                .start_move_at(&at(120.0), um_per_s * 1e-6)
                .unwrap();
            let reaches = 120.0 / um_per_s + 0.010;
            bench.sleep(reaches - 0.5e-3 * exposure_ms - if rolling { 0.02 } else { 0.01 });
            let moving = bench.grab();
            let start = bench.twin.truth(moving.sequence).unwrap();
            let picture = shown(&moving);
            while bench.stage.poll().unwrap() == scopeservo_scope::Motion::Moving {
                bench.sleep(0.01);
            }
            // The truth's height is that of the middle of the exposure of the middle row.
            let per_row_um = if rolling {
                um_per_s * 0.020 / 480.0
            } else {
                0.0
            };
            for row in [40, 240, 440] {
                let middle = start.defocus_um + per_row_um * (row as f64 - 240.0);
                let way = um_per_s * 1e-3 * exposure_ms;
                let heights = 8;
                let mean = (0..heights)
                    .map(|k| {
                        let um = middle + way * ((f64::from(k) + 0.5) / f64::from(heights) - 0.5);
                        bench.move_to(at(um));
                        contrast(&shown(&bench.grab()), row - 8..row + 8)
                    })
                    .sum::<f64>()
                    / f64::from(heights);
                let seen = contrast(&picture, row - 8..row + 8);
                bench.move_to(at(middle));
                differs =
                    differs.max((contrast(&shown(&bench.grab()), row - 8..row + 8) - mean).abs());
                assert!(
                    (seen - mean).abs() < 0.03 + 0.05 * mean,
                    "{um_per_s} um/s, rolling {rolling}, row {row}, {middle:.1} um: {seen:.3} and not {mean:.3}"
                );
            }
        }
    }
    // A picture of the middle height alone would not have passed.
    assert!(differs > 0.1, "{differs}");
}

#[test]
fn a_stage_goes_as_slowly_as_it_is_told_and_no_faster_than_it_can() {
    let bench = Bench::new(camera(|_| {}), grey(0.5));
    for (um_per_s, seconds) in [(500.0, 1.02), (2500.0, 0.22), (1e6, 0.07)] {
        let here = bench.stage.position().unwrap().si(Axis::Z).unwrap();
        let to = StagePose::default().with_si(Axis::Z, here + 0.5e-3);
        let begun = bench.clock.now();
        bench.stage.start_move_at(&to, um_per_s * 1e-6).unwrap();
        while bench.stage.poll().unwrap() == scopeservo_scope::Motion::Moving {
            bench.sleep(0.001);
        }
        let took =
            bench.clock.now().since(begun).as_secs_f64() - bench.twin.config().stage.settle_s;
        assert!((took - seconds).abs() < 0.005, "{um_per_s} um/s: {took} s");
    }
    let here = bench.stage.position().unwrap();
    for m_per_s in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let to = StagePose::default().with_si(Axis::Z, 1e-3);
        assert!(bench.stage.start_move_at(&to, m_per_s).is_err());
        assert_eq!(bench.stage.position().unwrap(), here);
    }
}

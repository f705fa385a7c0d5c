//! Every modelled term, seen in the images.

mod common;

use common::{Bench, clean, difference, dot, edge, grey, mean, sharpness, waves};
use scopeservo_scope::{Axis, Clock, Samples, StagePose, SystemClock};
use scopeservo_twin::{Blank, Config, SpecimenEvent, StageConfig, StageFault, Twin};
use std::sync::Arc;
use std::time::Duration;

fn hexapod() -> Config {
    clean(StageConfig::hexapod())
}

fn x(um: f64) -> StagePose {
    StagePose::default().with_si(Axis::X, um * 1e-6)
}

#[test]
fn the_same_seed_and_calls_give_the_same_frames_on_any_number_of_threads() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let bench = Bench::new(Config::realistic(), waves());
            let first = bench.grab();
            bench.stage.start_move(&x(500.0)).unwrap();
            let moving = bench.grab();
            bench.select("40x");
            vec![first, moving, bench.grab()]
        })
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_ne!(one[0].samples, one[2].samples);
}

#[test]
fn another_seed_is_another_instrument() {
    let frame = |seed| {
        let clock = Arc::new(scopeservo_scope::VirtualClock::new());
        let twin = Twin::new(Config::realistic(), waves(), seed, clock).unwrap();
        twin.camera().grab().unwrap().samples
    };
    assert_ne!(frame(1), frame(2));
}

#[test]
fn focus_is_sharpest_in_the_middle_and_tells_its_sign() {
    let bench = Bench::new(hexapod(), waves());
    bench.select("40x");
    let at = |um: f64| {
        bench.focus(um);
        bench.grab()
    };
    let (near, focused, far) = (at(4.0), at(0.0), at(-4.0));
    assert!(sharpness(&focused) > 1.02 * sharpness(&near));
    assert!(sharpness(&focused) > 1.02 * sharpness(&far));
    assert!(
        difference(&near, &far) > 0.001,
        "{}",
        difference(&near, &far)
    );
    // Nearly everything is gone at 300 um, and it stays cheap and finite.
    assert!(sharpness(&at(300.0)) < 0.01 * sharpness(&focused));
    assert!(sharpness(&at(-3000.0)) < 0.01 * sharpness(&focused));
}

#[test]
fn a_sharp_edge_has_the_width_of_the_aperture() {
    // 10 % to 90 % of a Gaussian edge is 2.563 sigma; defocus of 6 um at NA 0.65: 6 * 0.855 / 2 = 2.57 um.
    let mut config = hexapod();
    for o in &mut config.optics {
        o.chromatic_dof = [0.0; 3];
        o.spherical = 0.0;
    }
    let bench = Bench::new(config, edge());
    bench.select("40x");
    bench.twin.centre_specimen([0.0; 2], 0.0);
    bench.focus(-6.0);
    let frame = bench.grab();
    let m = bench
        .twin
        .truth(frame.sequence)
        .unwrap()
        .specimen_from_pixel;
    let grey = frame.luminance();
    // Specimen x runs along the rows of the image: read the middle column.
    let column: Vec<f64> = (0..frame.height)
        .map(|y| f64::from(grey[y * 640 + 320]))
        .collect();
    let (lo, hi) = column
        .iter()
        .fold((1.0f64, 0.0f64), |(a, b), &v| (a.min(v), b.max(v)));
    let between = column
        .iter()
        .filter(|&&v| v > lo + 0.1 * (hi - lo) && v < lo + 0.9 * (hi - lo))
        .count();
    let sigma = between as f64 * m[0][1].abs() / 2.563;
    assert!((sigma - 2.57).abs() < 0.25, "{sigma}");
}

#[test]
fn tilting_the_stage_blurs_one_side() {
    let mut config = hexapod();
    config.mount.eta_mm = [0.0; 2];
    let bench = Bench::new(config, waves());
    bench.select("40x");
    bench.move_to(StagePose::default().with_si(Axis::Rx, 0.05));
    bench.focus(0.0);
    let frame = bench.grab();
    let grey = frame.luminance();
    // The image's columns run along specimen y, which rotation about x lifts.
    let strip = |x0: usize| {
        (0..480)
            .flat_map(|y| (x0..x0 + 60).map(move |x| y * 640 + x))
            .map(|i| f64::from(grey[i + 1] - grey[i]).powi(2))
            .sum::<f64>()
    };
    assert!(
        strip(290) > 1.15 * strip(0) && strip(290) > 1.15 * strip(575),
        "{} {} {}",
        strip(0),
        strip(290),
        strip(575)
    );
}

#[test]
fn the_defocus_slopes_as_slide_and_stage_are_tilted_against_each_other() {
    for (tilt_mrad, rx, ry) in [
        ([3.0, -2.0], 0.0, 0.0),
        ([0.0, 0.0], 1e-3, 2e-3),
        ([3.0, -2.0], 1e-3, 2e-3),
        ([-3.0, 2.0], -2e-3, -3e-3),
    ] {
        let mut config = hexapod();
        config.mount.phi_deg = 0.0;
        config.mount.eta_mm = [0.0; 2];
        config.slide.tilt_mrad = tilt_mrad;
        let (kx, ky) = (config.optics[0].kx_px_per_m, config.optics[0].ky_px_per_m);
        let bench = Bench::new(config, waves());
        let tipped = StagePose::default().with_si(Axis::Rx, rx);
        bench.move_to(tipped.with_si(Axis::Ry, ry));
        let slope = bench.twin.truth_now().defocus_slope_um_per_px;
        // To the right lies y of the stage, downwards x.
        let right = (1e-3 * tilt_mrad[1] + rx) * 1e6 / kx.abs();
        let down = (1e-3 * tilt_mrad[0] - ry) * 1e6 / ky.abs();
        assert!(
            (slope[0] - right).abs() < 1e-6 && (slope[1] - down).abs() < 1e-6,
            "{slope:?} {right} {down}"
        );
    }
}

#[test]
fn saturation_and_exposure() {
    let bench = Bench::new(hexapod(), grey(0.5));
    let normal = mean(&bench.grab());
    assert_eq!(
        bench.camera.set_exposure(Duration::from_millis(5)).unwrap(),
        Duration::from_millis(5)
    );
    let half = mean(&bench.grab());
    assert!((normal / half - 2.0).abs() < 0.03);
    bench
        .camera
        .set_exposure(Duration::from_millis(60))
        .unwrap();
    assert!((mean(&bench.grab()) - 1.0).abs() < 1e-6);
    assert!(bench.camera.set_exposure(Duration::from_secs(5)).is_err());
    assert!(bench.camera.set_exposure(Duration::ZERO).is_err());
}

#[test]
fn frames_come_at_thirty_a_second_and_never_from_before_the_call() {
    let bench = Bench::new(hexapod(), grey(0.5));
    bench.sleep(0.001);
    let (a, b) = (bench.grab(), bench.grab());
    assert_eq!(b.sequence, a.sequence + 1);
    assert!((b.exposure_start.since(a.exposure_start).as_secs_f64() - 1.0 / 30.0).abs() < 1e-6);
    let taken = bench.clock.now().since(b.exposure_start);
    assert!(taken >= Duration::from_millis(15) && taken < Duration::from_millis(16));
    bench
        .camera
        .set_exposure(Duration::from_millis(100))
        .unwrap();
    let (a, b) = (bench.grab(), bench.grab());
    assert!((b.exposure_start.since(a.exposure_start).as_secs_f64() - 0.105).abs() < 1e-6);
}

#[test]
fn dropped_late_and_torn_frames() {
    let bench = Bench::new(hexapod(), waves());
    let before = bench.grab().sequence;
    bench.twin.fault(StageFault::DropFrames(3));
    assert_eq!(bench.grab().sequence, before + 4);
    assert_eq!(bench.grab().sequence, before + 5);

    bench.twin.fault(StageFault::LateFrames {
        count: 1,
        delay_s: 0.5,
    });
    let late = bench.grab();
    assert!(bench.clock.now().since(late.exposure_start) > Duration::from_millis(500));
    let timely = bench.grab();
    assert!(bench.clock.now().since(timely.exposure_start) < Duration::from_millis(20));

    // While the stage moves, the halves of a torn frame differ from a whole one only below.
    let grab = |torn: bool| {
        let bench = Bench::new(hexapod(), waves());
        bench.stage.start_move(&x(5000.0)).unwrap();
        bench.sleep(0.15);
        if torn {
            bench.twin.fault(StageFault::TornFrame);
        }
        bench.grab().luminance()
    };
    let (whole, torn) = (grab(false), grab(true));
    let half = 640 * 240;
    assert_eq!(whole[..half], torn[..half]);
    assert_ne!(whole[half..], torn[half..]);
}

#[test]
fn a_frozen_camera_shows_one_image_again_with_new_time_stamps() {
    let bench = Bench::new(Config::realistic(), waves());
    let shown = bench.grab();
    bench.twin.fault(StageFault::FrozenCamera(true));
    bench.move_to(x(100.0));
    let [first, second] = [bench.grab(), bench.grab()];
    assert!(first.samples == shown.samples && second.samples == shown.samples);
    assert!(second.sequence > first.sequence && second.exposure_start > first.exposure_start);
    bench.twin.fault(StageFault::FrozenCamera(false));
    assert!(bench.grab().samples != shown.samples);
}

#[test]
fn stale_images_come_so_many_grabs_late() {
    let still = Bench::new(hexapod(), waves());
    let at: Vec<_> = (0..6)
        .map(|k| {
            still.move_to(x(20.0 * f64::from(k)));
            still.grab().samples
        })
        .collect();
    let bench = Bench::new(hexapod(), waves());
    let mut shown = Vec::new();
    for k in 0..6 {
        if k == 1 {
            bench.twin.fault(StageFault::StaleFrames(2));
        }
        bench.move_to(x(20.0 * f64::from(k)));
        shown.push(bench.grab().samples);
    }
    // The one that was shown last until the queue is full, and then two late.
    for (k, late) in [0, 0, 0, 1, 2, 3].into_iter().enumerate() {
        assert!(shown[k] == at[late], "{k}");
    }
}

#[test]
fn a_silent_camera_gives_nothing_and_says_so() {
    let bench = Bench::new(hexapod(), waves());
    bench.twin.fault(StageFault::SilentCamera(true));
    let error = bench.camera.grab().unwrap_err();
    assert!(error.to_string().contains("camera"), "{error}");
    bench.twin.fault(StageFault::SilentCamera(false));
    bench.grab();
}

#[test]
fn a_binned_image_is_the_mean_of_its_pixels_and_a_turned_camera_turns_the_image() {
    let bench = Bench::new(hexapod(), waves());
    let whole = bench.grab();
    bench.twin.fault(StageFault::Binned(2));
    let half = bench.grab();
    assert_eq!(
        (half.width, half.height),
        (whole.width / 2, whole.height / 2)
    );
    let (all, binned) = (whole.luminance(), half.luminance());
    let (x, y) = (100, 70);
    let four: f32 = [0, 1, whole.width, whole.width + 1]
        .map(|k| all[2 * y * whole.width + 2 * x + k])
        .iter()
        .sum();
    assert!((binned[y * half.width + x] - four / 4.0).abs() < 1.0 / 255.0);
    bench.twin.fault(StageFault::Binned(1));
    let before = bench.twin.truth_now();
    bench.twin.fault(StageFault::CameraTurned(30.0));
    let after = bench.twin.truth_now();
    let turn = (after.angle_deg - before.angle_deg).abs();
    assert!((turn - 30.0).abs() < 1e-9, "{turn}");
    assert!((0..2).all(|k| (after.centre_um[k] - before.centre_um[k]).abs() < 1e-9));
}

#[test]
fn motion_during_the_exposure_smears() {
    let bench = Bench::new(hexapod(), waves());
    let still = sharpness(&bench.grab());
    bench.stage.start_move(&x(5000.0)).unwrap();
    bench.sleep(0.1);
    let moving = sharpness(&bench.grab());
    assert!(moving < 0.5 * still, "{moving} {still}");
}

#[test]
fn vibration_smears_and_settles() {
    let mut config = hexapod();
    config.stage.vibration_um = 12.0;
    let bench = Bench::new(config, waves());
    bench.select("40x");
    bench.move_to(x(0.0));
    let still = bench.grab();
    bench.stage.start_move(&x(1.0)).unwrap();
    let shaking = bench.grab();
    bench.sleep(0.2);
    bench.move_to(x(0.0));
    bench.sleep(0.1);
    let settled = bench.grab();
    assert!(sharpness(&shaking) < 0.995 * sharpness(&still));
    assert!(difference(&still, &settled) < 0.2 * difference(&still, &shaking));
}

#[test]
fn a_stuck_axis_reports_what_it_does_not_do() {
    let bench = Bench::new(hexapod(), waves());
    let before = bench.grab();
    bench.twin.fault(StageFault::StuckAxis {
        axis: Axis::X,
        stuck: true,
    });
    bench.move_to(x(300.0));
    assert_eq!(
        bench.stage.position().unwrap().x.unwrap().um().round(),
        300.0
    );
    assert_eq!(bench.grab().samples, before.samples);
    bench.twin.fault(StageFault::StuckAxis {
        axis: Axis::X,
        stuck: false,
    });
    assert_ne!(bench.grab().samples, before.samples);
}

#[test]
fn lost_steps_backlash_and_drift_move_the_view_and_not_the_report() {
    let centre = |b: &Bench| b.twin.truth_now().centre_um[0];
    let bench = Bench::new(hexapod(), waves());
    let start = centre(&bench);
    bench.twin.fault(StageFault::LostSteps {
        axis: Axis::X,
        si: 7e-6,
    });
    assert!((centre(&bench) - start - 7.0).abs() < 1e-6);
    assert_eq!(bench.stage.position().unwrap().si(Axis::X), Some(0.0));

    bench.twin.fault(StageFault::Backlash {
        axis: Axis::X,
        si: 3e-6,
    });
    bench.move_to(x(-50.0));
    bench.move_to(x(0.0));
    let from_below = centre(&bench);
    bench.move_to(x(50.0));
    bench.move_to(x(0.0));
    assert!((centre(&bench) - from_below - 3.0).abs() < 1e-6);

    let before = centre(&bench);
    bench.twin.fault(StageFault::Drift {
        um_per_s: [0.5, 0.0, 0.0],
    });
    bench.sleep(10.0);
    assert!((centre(&bench) - before - 5.0).abs() < 1e-6);
}

#[test]
fn what_happens_to_the_specimen_is_seen() {
    let bench = Bench::new(hexapod(), waves());
    let before = bench.grab();
    bench.twin.inject(SpecimenEvent::Bleach { factor: 0.5 });
    assert!(mean(&bench.grab()) > 1.1 * mean(&before));

    let bench = Bench::new(hexapod(), waves());
    bench.twin.inject(SpecimenEvent::counterstain());
    assert!(difference(&bench.grab(), &before) > 0.02);

    let bench = Bench::new(hexapod(), waves());
    let centre_um = bench.twin.truth_now().centre_um;
    bench.twin.inject(SpecimenEvent::Occlusion {
        centre_um,
        size_um: [400.0, 200.0],
        rgb: [0, 0, 0],
    });
    let frame = bench.grab();
    let dark = frame.luminance().iter().filter(|&&v| v < 0.02).count() as f64;
    let um = bench.twin.truth_now().um_per_px;
    assert!((dark * um * um / 80_000.0 - 1.0).abs() < 0.03, "{dark}");
    bench.twin.inject(SpecimenEvent::Clean);
    assert_eq!(bench.grab().samples, before.samples);

    bench.twin.inject(SpecimenEvent::Bubble {
        centre_um,
        radius_um: 200.0,
    });
    let bubble = bench.grab();
    let changed = bubble
        .luminance()
        .iter()
        .zip(before.luminance())
        .filter(|(a, b)| (*a - b).abs() > 0.02)
        .count();
    let area = std::f64::consts::PI * 200.0 * 200.0 / um / um;
    assert!(
        (0.6..1.3).contains(&(changed as f64 / area)),
        "{changed} {area}"
    );

    let focus = bench.twin.truth_now().defocus_um;
    bench.twin.inject(SpecimenEvent::Height { um: 9.0 });
    assert!((bench.twin.truth_now().defocus_um - focus - 9.0).abs() < 1e-9);

    bench.twin.replace_specimen(Arc::new(Blank));
    assert!(sharpness(&bench.grab()) < 1e-5);
}

#[test]
fn it_is_dark_while_the_nosepiece_turns() {
    let bench = Bench::new(hexapod(), grey(0.5));
    bench
        .twin
        .nosepiece()
        .start_change(&scopeservo_scope::ObjectiveId("40x".into()))
        .unwrap();
    assert_eq!(mean(&bench.grab()), 0.0);
    bench.sleep(2.0);
    assert!(mean(&bench.grab()) > 0.3);
}

#[test]
fn the_realistic_microscope_is_noisy_and_the_noiseless_one_is_not() {
    let pair = |config: Config| {
        let bench = Bench::new(config, grey(0.5));
        (bench.grab(), bench.grab())
    };
    let (a, b) = pair(Config::noiseless());
    assert_eq!(a.samples, b.samples);
    let (a, b) = pair(Config::realistic());
    let levels = 255.0 * difference(&a, &b);
    // Mean absolute difference of two noisy luminances: 1.128 sigma, and luminance averages the channels.
    assert!((0.6..2.5).contains(&levels), "{levels}");
    assert!(matches!(a.samples, Samples::U8(_)));
}

#[test]
fn truth_is_kept_for_every_frame_at_mid_exposure() {
    let bench = Bench::new(hexapod(), dot([0.0; 2], 13.0));
    bench.stage.start_move(&x(5000.0)).unwrap();
    bench.sleep(0.1);
    let frames: Vec<_> = (0..3).map(|_| bench.grab()).collect();
    let at = |i: usize| bench.twin.truth(frames[i].sequence).unwrap().centre_um[0];
    // 10 mm/s, 1/30 s apart.
    assert!(
        (at(1) - at(0) - 1e4 / 30.0).abs() < 0.01,
        "{}",
        at(1) - at(0)
    );
    assert!((at(2) - at(1) - 1e4 / 30.0).abs() < 0.01);
    assert_eq!(bench.twin.truth(99), None);
}

#[test]
fn the_wall_clock_works_as_well() {
    let clock = Arc::new(SystemClock::new());
    let mut config = hexapod();
    config.camera.width = 64;
    config.camera.height = 48;
    let twin = Twin::new(config, grey(0.5), 1, clock.clone()).unwrap();
    let asked = clock.now();
    let frame = twin.camera().grab().unwrap();
    assert!(frame.exposure_start >= asked);
    assert!(clock.now().since(asked) >= Duration::from_millis(15));
    let stage = twin.stage();
    stage.start_move(&x(100.0)).unwrap();
    assert_eq!(stage.poll().unwrap(), scopeservo_scope::Motion::Moving);
    clock.sleep(Duration::from_millis(200));
    assert_eq!(stage.poll().unwrap(), scopeservo_scope::Motion::Settled);
}

//! The tilt of a view as the focus sees it, and levelling, against what only the simulator knows.

mod common;

use common::{Bench, Listener, PLACE_UM, bench_over};
use scopeservo_scope::{
    Axis, CancelToken, Devices, Instrument, Motion, PositiveZ, ScopeError, Stage, StageInfo,
    StagePose,
};
use scopeservo_servo::{
    ErrorCode, Event, Level, LevelError, LevelOptions, LevelReport, MeasureTilt, NoSink, Procedure,
    Progress, ServoError, Tilt, TiltReport, run,
};
use scopeservo_twin::specimen::{Blank, Tissue};
use scopeservo_twin::{Config, SpecimenEvent, StageConfig, StageFault};
use std::sync::Arc;

/// One objective of the paper's instrument over a slide that is tilted.
fn tilted(objective: &str, tilt_mrad: [f64; 2]) -> Config {
    let mut config = Config::realistic();
    config.optics.retain(|o| o.id.0 == objective);
    config.slide.tilt_mrad = tilt_mrad;
    config
}

/// Of 40x, with a quarter of the camera: tests that level take many images.
fn quarter(tilt_mrad: [f64; 2]) -> Config {
    let mut config = tilted("40x", tilt_mrad);
    (config.camera.width, config.camera.height) = (320, 240);
    config
}

fn over_tissue(config: Config) -> Bench {
    bench_over(config, Arc::new(Tissue::new(7)), Vec::new())
}

/// In focus by the truth: the focus has tests of its own.
fn in_focus(bench: &Bench) {
    let z = bench.scope.gate().position().unwrap().z.unwrap().um();
    let off = bench.twin.truth_now().defocus_um;
    let z = match bench.scope.gate().info().positive_z {
        PositiveZ::Closer => z - off,
        PositiveZ::Apart => z + off,
    };
    let there = StagePose::default().with_si(Axis::Z, 1e-6 * z);
    bench.scope.move_to(&there).unwrap();
}

fn measured(bench: &Bench) -> TiltReport {
    let objective = bench.scope.gate().objectives()[0].clone();
    run(&mut MeasureTilt::new(objective), &bench.scope, &mut NoSink).unwrap()
}

/// The true slope of the height in focus along image x and y, um per mm.
fn truth(bench: &Bench) -> [f64; 2] {
    let slope = bench.twin.truth_now().defocus_slope_um_per_px;
    let optics = &bench.twin.config().optics[0];
    let sign = match bench.scope.gate().info().positive_z {
        PositiveZ::Closer => -1.0,
        PositiveZ::Apart => 1.0,
    };
    let px_per_mm = [optics.kx_px_per_m, optics.ky_px_per_m].map(|k| 1e-3 * k.abs());
    [0, 1].map(|k| sign * slope[k] * px_per_mm[k])
}

/// Measures, and holds it against the truth.
fn told(name: &str, bench: &Bench, most_sigma: f64) -> Tilt {
    let report = measured(bench);
    let tilt = report
        .tilt
        .unwrap_or_else(|| panic!("{name}: {} heights", report.heights.len()));
    let truth = truth(bench);
    for (seen, truth) in tilt.slope_um_per_mm.iter().zip(truth) {
        let off = (seen.value - truth) / seen.sigma;
        assert!(
            off.abs() < 3.5 && seen.sigma < most_sigma,
            "{name}: {seen:?} {truth}"
        );
    }
    tilt
}

#[test]
fn a_tilt_is_seen_as_it_is_whatever_the_objective_and_the_camera() {
    type Change = fn(&mut Config);
    let plain: Change = |_| {};
    let turned: Change = |c| c.mount.phi_deg += 90.0;
    let mirrored: Change = |c| c.mount.mirrored = true;
    let noisy: Change = |c| c.camera.full_well_e = 5e3;
    let apart: Change = |c| c.stage.positive_z = PositiveZ::Apart;
    for (objective, tilt, name, change) in [
        ("40x", [0.0, 0.0], "plain", plain),
        ("40x", [2.0, 0.0], "plain", plain),
        ("40x", [0.0, -5.0], "plain", plain),
        ("40x", [5.0, -5.0], "turned", turned),
        ("40x", [-5.0, 2.0], "mirrored", mirrored),
        ("40x", [5.0, 5.0], "noisy", noisy),
        ("40x", [2.0, -5.0], "apart", apart),
        ("10x", [0.0, 0.0], "noisy", noisy),
        ("10x", [0.0, 2.0], "plain", plain),
        ("10x", [5.0, 5.0], "turned", turned),
    ] {
        let mut config = tilted(objective, tilt);
        change(&mut config);
        let bench = over_tissue(config);
        in_focus(&bench);
        let tilt = told(&format!("{objective} {tilt:?} {name}"), &bench, 0.35);
        assert!(tilt.goodness > 0.9 || !tilt.shown, "{tilt:?}");
    }
}

#[test]
fn a_weak_stain_and_half_a_field_show_a_tilt_and_know_it_worse() {
    let weak = over_tissue(tilted("40x", [5.0, -2.0]));
    weak.twin.inject(SpecimenEvent::Bleach { factor: 0.25 });
    in_focus(&weak);
    told("weak", &weak, 0.6);
    let half = over_tissue(tilted("40x", [2.0, 5.0]));
    half.twin.inject(SpecimenEvent::Occlusion {
        centre_um: [PLACE_UM[0] + 300.0, PLACE_UM[1]],
        size_um: [600.0, 1000.0],
        rgb: [243, 242, 244],
    });
    in_focus(&half);
    let report = measured(&half);
    assert!(report.heights.len() < 80, "{}", report.heights.len());
    told("half", &half, 0.8);
}

/// The corner of the view that is out of focus by most, by the truth, when the middle is sharp, um.
fn true_corner(bench: &Bench) -> f64 {
    let camera = &bench.twin.config().camera;
    let slope = bench.twin.truth_now().defocus_slope_um_per_px;
    0.5 * (slope[0].abs() * camera.width as f64 + slope[1].abs() * camera.height as f64)
}

fn levelling(bench: &Bench) -> Level {
    let objective = bench.scope.gate().objectives()[0].clone();
    let options = LevelOptions {
        apply: true,
        ..LevelOptions::default()
    };
    Level::new(objective, options)
}

/// Levels through JSON, and watches that objective and specimen never come nearer to each other than the search for a focus needs.
fn level(bench: &Bench) -> Result<LevelReport, ServoError> {
    let low = bench.scope.gate().objectives()[0].numerical_aperture < 0.5;
    let nearest_um = if low { 180.0 } else { 60.0 };
    let mut level = levelling(bench);
    let nearest = std::cell::Cell::new(f64::NEG_INFINITY);
    let ended = loop {
        let stored = serde_json::to_string(&level).unwrap();
        level = serde_json::from_str(&stored).unwrap();
        let mut watch = Listener(|_: &Event| {
            nearest.set(nearest.get().max(bench.twin.truth_now().defocus_um));
        });
        match level.step(&bench.scope, &mut watch) {
            Ok(Progress::Continue) => {}
            Ok(Progress::Done(report)) => break Ok(report),
            Err(error) => break Err(error),
        }
    };
    assert!(nearest.get() < nearest_um, "{} um too near", nearest.get());
    ended
}

/// A stage that is wired otherwise than it says: what is asked of rx and ry goes to these axes, times these factors.
struct Wired {
    stage: Box<dyn Stage>,
    goes: [(Axis, f64); 2],
}

impl Wired {
    const TIPS: [Axis; 2] = [Axis::Rx, Axis::Ry];
}

impl Stage for Wired {
    fn info(&self) -> &StageInfo {
        self.stage.info()
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        let at = self.stage.position()?;
        let each = Self::TIPS.into_iter().zip(self.goes);
        Ok(each.fold(at, |told, (axis, (real, factor))| {
            told.with_si(axis, at.si(real).unwrap() / factor)
        }))
    }
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        let mut real = StagePose {
            rx: None,
            ry: None,
            ..*to
        };
        for (axis, (goes, factor)) in Self::TIPS.into_iter().zip(self.goes) {
            if let Some(si) = to.si(axis) {
                real = real.with_si(goes, factor * si);
            }
        }
        self.stage.start_move(&real)
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        self.stage.poll()
    }
    fn stop(&self) -> Result<(), ScopeError> {
        self.stage.stop()
    }
}

fn wired(config: Config, goes: [(Axis, f64); 2]) -> Bench {
    let mut bench = over_tissue(config);
    let devices = bench.twin.devices();
    let devices = Devices {
        stage: devices
            .stage
            .map(|stage| Box::new(Wired { stage, goes }) as Box<dyn Stage>),
        ..devices
    };
    bench.cancel = CancelToken::new();
    bench.scope = Instrument::new(devices, bench.twin.rules(), bench.cancel.clone()).unwrap();
    bench
}

fn as_it_says() -> [(Axis, f64); 2] {
    [(Axis::Rx, 1.0), (Axis::Ry, 1.0)]
}

#[test]
fn a_view_is_levelled_whichever_way_the_axes_turn() {
    // The shift of the focus by a turn is that of the farther axis of the two.
    for (name, tilt, goes, lever_mm) in [
        ("as it says", [8.0, -8.0], as_it_says(), 125.0),
        (
            "negative",
            [0.0, 14.0],
            [(Axis::Rx, -1.0), (Axis::Ry, 1.0)],
            9.0,
        ),
        (
            "swapped",
            [-10.0, 4.0],
            [(Axis::Ry, 1.0), (Axis::Rx, -1.0)],
            9.0,
        ),
        ("10x turned", [9.0, 7.0], as_it_says(), 9.0),
    ] {
        let mut config = quarter(tilt);
        if name == "10x turned" {
            config.optics = tilted("10x", tilt).optics;
            config.mount.phi_deg += 90.0;
            config.mount.mirrored = true;
        }
        if lever_mm < 100.0 {
            config.mount.eta_mm = [6.0, -9.0];
        }
        let bench = wired(config, goes);
        in_focus(&bench);
        let before = true_corner(&bench);
        let report = level(&bench).unwrap_or_else(|e| panic!("{name}: {e}"));
        let levelled = report.levelled.as_ref().unwrap();
        let after = true_corner(&bench);
        let depth_um = report.before.depth_of_field_um;
        assert!(
            levelled.level && after < 0.38 * depth_um,
            "{name}: {before} {after} {levelled:?}"
        );
        let defocus_um = bench.twin.truth_now().defocus_um;
        assert!(defocus_um.abs() < 0.5 * depth_um, "{name}: {defocus_um}");
        assert!(
            before > 0.5 * depth_um && levelled.rounds <= 3,
            "{name}: {levelled:?}"
        );
        let seen = levelled.lever_um_per_mrad.map(|l| l.unwrap().abs());
        let longest = seen[0].max(seen[1]);
        assert!((longest / lever_mm - 1.0).abs() < 0.15, "{name}: {seen:?}");
    }
}

#[test]
fn what_is_level_or_cannot_be_levelled_moves_nothing_and_is_told() {
    let bench = over_tissue(quarter([0.0, 0.0]));
    in_focus(&bench);
    let report = level(&bench).unwrap();
    assert_eq!(
        (report.before.is_level(), &report.levelled, report.can_tip),
        (Some(true), &None, true)
    );
    for stage in [StageConfig::xyz(), StageConfig::xyz_theta()] {
        let bench = over_tissue(quarter([12.0, 0.0]).with_stage(stage));
        in_focus(&bench);
        let began = bench.scope.gate().position().unwrap();
        let report = level(&bench).unwrap();
        assert_eq!(
            (report.before.is_level(), &report.levelled, report.can_tip),
            (Some(false), &None, false)
        );
        told("no axis that tips", &bench, 1.2);
        let at = bench.scope.gate().position().unwrap();
        assert!((at.z.unwrap().um() - began.z.unwrap().um()).abs() < 0.5);
    }
}

fn back(name: &str, bench: &Bench, began: &StagePose) {
    let at = bench.scope.gate().position().unwrap();
    for axis in Axis::ALL {
        let off = at.si(axis).unwrap() - began.si(axis).unwrap();
        let most = if axis.is_rotation() { 5e-6 } else { 5e-7 };
        assert!(off.abs() < most, "{name}: {axis} {off} {at}");
    }
}

#[test]
fn what_fails_leaves_the_stage_where_it_began() {
    let blank = bench_over(quarter([8.0, 8.0]), Arc::new(Blank), Vec::new());
    let began = blank.scope.gate().position().unwrap();
    let error = level(&blank).unwrap_err();
    assert!(
        matches!(error, ServoError::Level(LevelError::TiltUnseen { .. })),
        "{error}"
    );
    assert_eq!(error.code(), ErrorCode::LevelFailed);
    back("blank", &blank, &began);

    for axis in [Axis::Rx, Axis::Ry] {
        let stuck = over_tissue(quarter([8.0, -8.0]));
        in_focus(&stuck);
        let began = stuck.scope.gate().position().unwrap();
        stuck
            .twin
            .fault(StageFault::StuckAxis { axis, stuck: true });
        let error = level(&stuck).unwrap_err();
        let named =
            matches!(error, ServoError::Level(LevelError::TiltStays { axis: a, .. }) if a == axis);
        assert!(named, "{error}");
        back("stuck", &stuck, &began);
        assert!(
            stuck.twin.truth_now().defocus_um.abs() < 1.0,
            "in focus as before"
        );
    }

    // It turns ten times as far as it says.
    let bench = wired(quarter([8.0, 8.0]), [(Axis::Rx, 1.0), (Axis::Ry, 10.0)]);
    in_focus(&bench);
    let began = bench.scope.gate().position().unwrap();
    let error = level(&bench).unwrap_err();
    assert_eq!(error.kind(), scopeservo_servo::ErrorKind::Answer, "{error}");
    back("too far", &bench, &began);
}

#[test]
fn a_stop_in_the_middle_leaves_the_stage_where_it_is() {
    for stopped_at in [20, 60, 100] {
        let bench = over_tissue(quarter([8.0, -8.0]));
        in_focus(&bench);
        let mut frames = 0;
        let mut listener = Listener(|event: &Event| {
            frames += usize::from(matches!(event, Event::FrameGrabbed { .. }));
            if frames == stopped_at {
                bench.cancel.cancel();
            }
        });
        let error = run(&mut levelling(&bench), &bench.scope, &mut listener).unwrap_err();
        assert_eq!(error.code(), ErrorCode::Interrupted, "{error}");
        let at = bench.scope.gate().position().unwrap();
        bench.scope.clock().sleep(std::time::Duration::from_secs(3));
        assert_eq!(bench.scope.gate().position().unwrap(), at);
    }
}

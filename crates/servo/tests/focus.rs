//! What stays on the camera is no focus, and does not hide one.

mod common;

use common::{Bench, bench_over, one_objective};
use scopeservo_scope::{Axis, AxisRange, Instrument, LargestStep, Limits, Rules, StagePose};
use scopeservo_servo::{
    ErrorCode, Focus, FocusOptions, FocusResult, NoSink, Procedure, Progress, ServoError, run,
};
use scopeservo_twin::specimen::Specimen;
use scopeservo_twin::{Blank, Config, DustConfig, Mark, PatternConfig, Sparse, SparseConfig};
use std::sync::Arc;

fn text() -> Vec<Mark> {
    let lines = ["LABORATORY 3, MICROSCOPE 2", "26 NOV 2026 10:14", "50 UM"];
    (0..)
        .zip(lines)
        .map(|(i, text)| Mark::Text {
            text: text.into(),
            at_px: [60, 20 + 150 * i],
            dot_px: 3,
            level: 0.0,
            box_level: Some(1.0),
        })
        .collect()
}

fn digits() -> Vec<Mark> {
    vec![Mark::StagePlace {
        at_px: [20, 430],
        dot_px: 3,
        level: 1.0,
        box_level: Some(0.0),
        packed: false,
    }]
}

fn reticle() -> Vec<Mark> {
    vec![Mark::Reticle {
        centre_px: [320.0, 240.0],
        arm_px: 200.0,
        line_px: 2.0,
        tick_px: 20.0,
        circles_px: vec![60.0],
        attenuation: 0.9,
    }]
}

/// The usual instrument with these on its camera and no dust.
fn with(marks: Vec<Mark>) -> Config {
    let mut config = one_objective();
    config.camera.dust.clear();
    config.camera.marks = marks;
    config
}

fn hard_dust() -> DustConfig {
    DustConfig {
        specks: 60,
        radius_px: [2.0, 12.0],
        attenuation: [0.3, 0.9],
        steepness: [15, 60],
        ..DustConfig::default()
    }
}

/// About a dozen cells in the view.
fn sparse(seed: u64) -> Arc<dyn Specimen> {
    let config = SparseConfig {
        seed,
        per_mm2: 250.0,
        contrast: 0.6,
        ..SparseConfig::default()
    };
    Arc::new(Sparse::new(config).unwrap())
}

fn focus(bench: &Bench) -> Result<FocusResult, ServoError> {
    let objective = bench.scope.gate().objectives()[0].clone();
    run(
        &mut Focus::new(objective, FocusOptions::default()),
        &bench.scope,
        &mut NoSink,
    )
}

fn put_out_of_focus(bench: &Bench, defocus_um: f64) {
    let z = bench.scope.gate().position().unwrap().si(Axis::Z).unwrap();
    let now = bench.twin.truth_now().defocus_um;
    let to = z + (defocus_um - now) * 1e-6;
    bench
        .scope
        .move_to(&StagePose::default().with_si(Axis::Z, to))
        .unwrap();
}

#[test]
fn sparse_tissue_is_brought_into_focus_beside_whatever_is_on_the_camera() {
    let nothing: Vec<Mark> = Vec::new();
    for seed in [3, 4] {
        for (name, marks, dust) in [
            ("nothing", nothing.clone(), vec![]),
            ("text", text(), vec![]),
            ("text and digits", [text(), digits()].concat(), vec![]),
            ("reticle", reticle(), vec![]),
            ("hard dust", nothing.clone(), vec![hard_dust()]),
        ] {
            let bench = bench_over(with(marks), sparse(seed), Vec::new());
            bench.twin.settle_dust(&dust, 3).unwrap();
            put_out_of_focus(&bench, 17.0);
            let found = focus(&bench).unwrap_or_else(|e| panic!("{name}, {seed}: {e}"));
            let off = bench.twin.truth_now().defocus_um;
            assert!(off.abs() < 2.0, "{name}, {seed}: {off} um, {found:?}");
        }
    }
}

/// With every objective of an instrument whose camera has its usual dust.
#[test]
fn of_ordinary_tissue_the_whole_picture_counts() {
    let tissue = Arc::new(scopeservo_twin::specimen::Tissue::new(7));
    let bench = bench_over(Config::realistic(), tissue, Vec::new());
    for objective in bench.scope.gate().objectives().to_vec() {
        bench.scope.select_objective(&objective.id).unwrap();
        put_out_of_focus(&bench, 11.0);
        let mut focus = Focus::new(objective, FocusOptions::default());
        while let Progress::Continue = focus.step(&bench.scope, &mut NoSink).unwrap() {
            let state = serde_json::to_value(&focus).unwrap();
            assert!(state.to_string().len() < 100_000, "a state stays small");
        }
        assert!(bench.twin.truth_now().defocus_um.abs() < 4.0);
    }
}

/// A camera without noise shows the steps of its digits far from focus, where nothing else is left: they make tops that are no focus.
#[test]
fn what_a_camera_without_noise_shows_far_away_is_no_focus() {
    let tissue = Arc::new(scopeservo_twin::specimen::Tissue::new(7));
    let mut config = Config::realistic();
    config.camera.shot_noise = false;
    config.camera.read_noise_e = 0.0;
    config.stage = config.stage.exact();
    let bench = bench_over(config, tissue, Vec::new());
    let finest = bench.scope.gate().objectives()[2].clone();
    bench.scope.select_objective(&finest.id).unwrap();
    for start_um in [-190.0, -150.0, -110.0, 110.0, 150.0, 180.0] {
        put_out_of_focus(&bench, start_um);
        let mut focus = Focus::new(finest.clone(), FocusOptions::default());
        let found = run(&mut focus, &bench.scope, &mut NoSink).unwrap();
        let off = bench.twin.truth_now().defocus_um;
        assert!(off.abs() < 0.33, "{start_um}: {off} um, {found:?}");
    }
}

/// Arrivals scatter by more than a high aperture bears, and the stage says that it is where it was sent: the image tells.
#[test]
fn a_stage_that_does_not_arrive_where_it_says_is_sent_again() {
    let tissue = Arc::new(scopeservo_twin::specimen::Tissue::new(7));
    let bench = bench_over(Config::realistic(), tissue, Vec::new());
    let finest = bench.scope.gate().objectives()[2].clone();
    bench.scope.select_objective(&finest.id).unwrap();
    let mut errors = Vec::new();
    for k in 0..12 {
        put_out_of_focus(&bench, 5.0 - f64::from(k));
        let mut focus = Focus::new(finest.clone(), FocusOptions::default());
        let found = run(&mut focus, &bench.scope, &mut NoSink).unwrap();
        let off = bench.twin.truth_now().defocus_um;
        errors.push(off / found.sigma_um.unwrap());
        assert!(off.abs() < 0.4, "{k}: {off} um, {found:?}");
    }
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    assert!((0.4..1.4).contains(&rms), "{rms}: {errors:?}");
}

/// Where limits, or the range that is asked for, end before the focus.
#[test]
fn a_focus_beyond_where_the_stage_may_go_is_told_and_the_stage_is_back() {
    let tissue = || Arc::new(scopeservo_twin::specimen::Tissue::new(7));
    let z_um = |bench: &Bench| bench.scope.gate().position().unwrap().z.unwrap().um();
    let free = bench_over(one_objective(), tissue(), Vec::new());
    put_out_of_focus(&free, 0.0);
    let sharp_um = z_um(&free);
    // Positive z is nearer to the specimen. From far a limit ends the search, from too near the range that is asked for.
    for (start_um, limit_um, half_range_um) in [(-60.0, -12.0, 200.0), (40.0, 400.0, 31.0)] {
        let range = AxisRange {
            axis: Axis::Z,
            min: -3e-3,
            max: (sharp_um + limit_um) * 1e-6,
        };
        let bench = bench_over(one_objective(), tissue(), vec![]);
        put_out_of_focus(&bench, start_um);
        let bench = Bench {
            scope: limited(&bench, range),
            ..bench
        };
        let began = z_um(&bench);
        let options = FocusOptions {
            half_range_um,
            ..FocusOptions::default()
        };
        let objective = bench.scope.gate().objectives()[0].clone();
        let mut focus = Focus::new(objective, options);
        let told = run(&mut focus, &bench.scope, &mut NoSink);
        assert!(
            matches!(told, Err(ServoError::FocusAtLimit { .. })),
            "{start_um}: {told:?}"
        );
        assert_eq!(told.unwrap_err().code(), ErrorCode::AtLimit);
        assert!((z_um(&bench) - began).abs() < 0.3);
    }
}

/// The same instrument with a limit.
fn limited(bench: &Bench, range: AxisRange) -> Instrument {
    let rules = Rules {
        limits: Limits {
            ranges: vec![range],
        },
        ..bench.twin.rules()
    };
    Instrument::new(bench.twin.devices(), rules, bench.cancel.clone()).unwrap()
}

#[test]
fn blank_glass_is_never_in_focus_whatever_is_on_the_camera() {
    let pattern = PatternConfig {
        offset_e: 60.0,
        gain: 0.02,
        column_offset_e: 40.0,
        column_gain: 0.005,
    };
    for (name, marks, dust) in [
        ("nothing", vec![], vec![]),
        ("text", text(), vec![]),
        ("digits", digits(), vec![]),
        (
            "all",
            [text(), digits(), reticle()].concat(),
            vec![hard_dust()],
        ),
        ("hard dust", vec![], vec![hard_dust()]),
    ] {
        for (read_noise_e, pattern) in [
            (10.0, PatternConfig::default()),
            (10.0, pattern),
            // One per cent of full scale.
            (100.0, PatternConfig::default()),
        ] {
            let mut config = with(marks.clone());
            config.camera.full_well_e = 10_000.0;
            config.camera.read_noise_e = read_noise_e;
            config.camera.pattern = pattern;
            let bench = bench_over(config, Arc::new(Blank), Vec::new());
            bench.twin.settle_dust(&dust, 3).unwrap();
            let told = focus(&bench);
            assert!(
                matches!(told, Err(ServoError::NoFocus { .. })),
                "{name}, {read_noise_e}: {told:?}"
            );
        }
    }
}

#[test]
fn a_focus_goes_in_steps_that_are_allowed_and_comes_back() {
    let longest_m = 40e-6;
    for specimen in [Arc::new(Blank) as Arc<dyn Specimen>, sparse(3)] {
        let blank = bench_over(one_objective(), specimen, Vec::new());
        let mut rules = blank.twin.rules();
        rules.largest_steps.push(LargestStep {
            axis: Axis::Z,
            step: longest_m,
        });
        let devices = blank.twin.devices();
        let scope = Instrument::new(devices, rules, blank.cancel.clone()).unwrap();
        let bench = Bench { scope, ..blank };
        put_out_of_focus_slowly(&bench);
        let z_m = || bench.scope.gate().position().unwrap().si(Axis::Z).unwrap();
        let began_m = z_m();
        match focus(&bench) {
            Ok(_) => {
                let off_um = bench.twin.truth_now().defocus_um;
                assert!(off_um.abs() < 1.0, "{off_um}");
            }
            Err(error) => {
                assert_eq!(error.code(), ErrorCode::NoFocus, "{error}");
                assert!((z_m() - began_m).abs() < 2e-6, "{} {began_m}", z_m());
            }
        }
    }
}

fn put_out_of_focus_slowly(bench: &Bench) {
    let z = bench.scope.gate().position().unwrap().si(Axis::Z).unwrap();
    let side = bench.scope.gate().info().positive_z;
    let to = StagePose::default().with_si(Axis::Z, side.away(z, 70e-6));
    bench.scope.move_in_steps(&to).unwrap();
}

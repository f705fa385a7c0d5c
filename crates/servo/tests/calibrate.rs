//! A calibration on sparse tissue behind dust and beside text is right, or says that it cannot be made.

mod common;

use common::{Bench, bench_over, one_objective};
use scopeservo_scope::Axis;
use scopeservo_servo::{
    Calibrate, CalibrateOptions, Calibration, ErrorCode, Identify, NoSink, ServoError,
    VisionOptions, run,
};
use scopeservo_twin::specimen::Specimen;
use scopeservo_twin::{Blank, Config, DustConfig, Mark, Sparse, SparseConfig, StageConfig};
use std::sync::Arc;

fn by_hand() -> Config {
    let mut stage = StageConfig::xyz_theta();
    stage.axes.retain(|a| a.axis != Axis::Z);
    one_objective().with_stage(stage)
}

/// Lines of text over much of the image.
fn text() -> Vec<Mark> {
    let lines = ["LABORATORY 3, MICROSCOPE 2", "26 NOV 2026 10:14", "50 UM"];
    (0..)
        .zip(lines)
        .map(|(i, text)| Mark::Text {
            text: text.into(),
            at_px: [30, 20 + 150 * i],
            dot_px: 3,
            level: 0.0,
            box_level: None,
        })
        .collect()
}

fn hard_dust(specks: usize) -> DustConfig {
    DustConfig {
        specks,
        radius_px: [2.0, 12.0],
        attenuation: [0.3, 0.9],
        steepness: [15, 60],
        ..DustConfig::default()
    }
}

fn sparse(seed: u64, per_mm2: f64) -> Arc<dyn Specimen> {
    let config = SparseConfig {
        seed,
        per_mm2,
        ..SparseConfig::default()
    };
    Arc::new(Sparse::new(config).unwrap())
}

fn over(mut config: Config, specimen: Arc<dyn Specimen>, specks: usize) -> Bench {
    config.camera.dust.clear();
    config.camera.marks = text();
    let bench = bench_over(config, specimen, Vec::new());
    bench.twin.settle_dust(&[hard_dust(specks)], 3).unwrap();
    bench
}

fn calibrate(bench: &Bench) -> Result<Calibration, ServoError> {
    let objective = bench.scope.gate().objectives()[0].clone();
    let mut calibrate = Calibrate::new(
        objective,
        CalibrateOptions::default(),
        VisionOptions::default(),
    );
    run(&mut calibrate, &bench.scope, &mut NoSink)
}

/// How far it is from the truth, in its own standard deviations.
fn sigmas_off(bench: &Bench, made: &Calibration) -> f64 {
    let truth = bench.twin.true_calibration(&made.objective).unwrap();
    let (read, variance) = (made.reading().unwrap(), made.covariance.unwrap());
    let share =
        (0..4).map(|k| variance[k][k]).fold(0.0, f64::max).sqrt() / (made.um_per_px() * 1e-6);
    let scales = [
        read.kx_px_per_m / truth.kx - 1.0,
        read.ky_px_per_m / truth.ky - 1.0,
        read.phi_rad - truth.phi_deg.to_radians(),
    ]
    .map(|off| off / share);
    let eta = made.rotation_centre_m.unwrap();
    let centre = [0, 1].map(|k| (eta[k] - truth.eta_mm[k] * 1e-3) / variance[4 + k][4 + k].sqrt());
    scales
        .into_iter()
        .chain(centre)
        .map(f64::abs)
        .fold(0.0, f64::max)
}

#[test]
fn sparse_tissue_behind_dust_and_text_is_calibrated_on_or_refused_and_never_wrongly() {
    let mut made = 0;
    for (seed, per_mm2, specks) in [
        (1, 600.0, 40),
        (2, 300.0, 80),
        (3, 300.0, 40),
        (4, 150.0, 80),
        (5, 150.0, 40),
        (6, 80.0, 120),
    ] {
        let bench = over(by_hand(), sparse(seed, per_mm2), specks);
        match calibrate(&bench) {
            Ok(calibration) => {
                let off = sigmas_off(&bench, &calibration);
                assert!(off < 6.0, "{seed}: {off} sigmas");
                made += 1;
            }
            Err(why) => assert_eq!(why.code(), ErrorCode::CalibrationFailed, "{seed}: {why}"),
        }
    }
    assert!(made >= 4, "{made} of 6");
}

#[test]
fn dust_and_text_alone_are_not_calibrated_on() {
    let bench = over(by_hand(), Arc::new(Blank), 60);
    let refused = calibrate(&bench).unwrap_err();
    assert!(
        matches!(refused, ServoError::AxisStands { .. }),
        "{refused}"
    );
    assert!(refused.to_string().contains("on the camera"), "{refused}");
}

/// The view's centre stays when the stage turns, as dust does.
#[test]
fn a_rotation_about_the_views_centre_is_not_mistaken_for_none() {
    for seed in [1, 2] {
        let mut config = by_hand();
        config.mount.eta_mm = [0.0; 2];
        let bench = over(config, sparse(seed, 400.0), 60);
        let made = calibrate(&bench).unwrap();
        let off = sigmas_off(&bench, &made);
        assert!(off < 6.0, "{seed}: {off} sigmas");
    }
}

/// The stage of `by_hand` with play and scatter of x and y, um, and the same of the rotation at a lever of 100 mm.
fn cheap(play_um: f64, scatter_um: f64) -> Config {
    let mut config = by_hand();
    for axis in &mut config.stage.axes {
        let lever = if axis.axis.is_rotation() { 10.0 } else { 1.0 };
        (axis.backlash, axis.repeatability) = (lever * play_um, lever * scatter_um);
    }
    config
}

#[test]
fn stages_with_play_and_scatter_are_calibrated_behind_dust_and_their_play_is_told() {
    for (play_um, scatter_um) in [(2.0, 0.15), (20.0, 0.3), (20.0, 5.0)] {
        let bench = over(cheap(play_um, scatter_um), sparse(1, 400.0), 60);
        let made = calibrate(&bench).unwrap();
        let off = sigmas_off(&bench, &made);
        assert!(off < 5.0, "{play_um} {scatter_um}: {off} sigmas");
        let told = made.backlash.unwrap();
        for (m, sigma_m) in [(told.x_m, told.sigma[0]), (told.y_m, told.sigma[1])] {
            let off_um = (1e6 * m - play_um).abs();
            assert!(
                off_um < 4.0 * 1e6 * sigma_m,
                "{play_um} {scatter_um}: {told:?}"
            );
            assert!(
                1e6 * sigma_m < 0.1 + scatter_um,
                "{play_um} {scatter_um}: {told:?}"
            );
        }
        // What the stage states has its play in it; what it scatters is less.
        let seen_um = made.scatter.unwrap().map(|s| 1e6 * s);
        let true_um = scatter_um / 3f64.sqrt();
        assert!(
            seen_um[0] < 1.6 * true_um + 0.05,
            "{seen_um:?} of {true_um}"
        );
    }
}

#[test]
fn the_stage_comes_home_when_a_calibration_ends_and_when_it_fails() {
    for specimen in [sparse(1, 400.0), Arc::new(Blank)] {
        let bench = over(by_hand(), specimen, 20);
        let before = bench.scope.gate().position().unwrap();
        let made = calibrate(&bench);
        let after = bench.scope.gate().position().unwrap();
        for axis in [Axis::X, Axis::Y, Axis::Rz] {
            let info = bench.scope.gate().info().axis(axis).unwrap();
            let off = (after.si(axis).unwrap() - before.si(axis).unwrap()).abs();
            assert!(off <= info.tolerance(), "{axis:?} {off} after {made:?}");
        }
        assert!(bench.scope.counters().moves > 2);
    }
}

#[test]
fn the_scale_is_seen_behind_dust_and_text() {
    for seed in [1, 2, 3] {
        let bench = over(by_hand(), sparse(seed, 200.0), 80);
        let id = bench.scope.gate().objectives()[0].id.clone();
        let mut identify = Identify::new(id, VisionOptions::default());
        let seen = run(&mut identify, &bench.scope, &mut NoSink).unwrap();
        assert!(seen.as_told, "{seed}: {seen:?}");
        assert!(
            (seen.um_per_px / 0.51 - 1.0).abs() < 0.05,
            "{seed}: {seen:?}"
        );
    }
    let bench = over(by_hand(), Arc::new(Blank), 80);
    let id = bench.scope.gate().objectives()[0].id.clone();
    let mut identify = Identify::new(id, VisionOptions::default());
    let refused = run(&mut identify, &bench.scope, &mut NoSink).unwrap_err();
    assert!(
        matches!(refused, ServoError::PictureStays { .. }),
        "{refused}"
    );
}

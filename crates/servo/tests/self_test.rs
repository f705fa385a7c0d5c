//! The self-test of a kept calibration, against what only the simulator knows.

mod common;

use common::{Bench, Listener, bench, bench_over, one_objective};
use scopeservo_geometry::Mat2;
use scopeservo_scope::{Axis, StagePose};
use scopeservo_servo::{
    Backlash, Broken, CALIBRATION_SCHEMA, Calibration, Changing, Event, NoSink, Procedure,
    Progress, SelfTest, SelfTestReport, SelfTestVerdict, ServoError, Sink, VisionOptions, run,
};
use scopeservo_twin::specimen::{Blank, Sparse, SparseConfig, Specimen};
use scopeservo_twin::{Config, DustConfig, StageConfig, StageFault};
use std::sync::Arc;

/// What a good calibration of the twin would be: the map to 0.03 %, the rotation centre to 10 um, and how arrivals scatter.
fn truth(bench: &Bench) -> Calibration {
    let objective = &bench.scope.gate().objectives()[0].id;
    let t = bench.twin.true_calibration(objective).unwrap();
    let (s, c) = t.phi_deg.to_radians().sin_cos();
    let map = Mat2([[-s, -c], [-c, s]]) * Mat2::diagonal(1.0 / t.kx, 1.0 / t.ky);
    let size_m = map.det().abs().sqrt();
    let sigma = [3e-4 * size_m; 4].into_iter().chain([1e-5; 2]);
    let mut covariance = [[0.0; 6]; 6];
    for (k, sigma) in sigma.enumerate() {
        covariance[k][k] = sigma * sigma;
    }
    let info = bench.scope.gate().info();
    let sd = |axis| info.axis(axis).map_or(0.0, |a| a.standard_deviation());
    let camera = bench.scope.camera().info();
    Calibration {
        schema: CALIBRATION_SCHEMA,
        objective: objective.clone(),
        image_size_px: [camera.width, camera.height],
        stage_from_pixel: map,
        rotation_centre_m: info.axis(Axis::Rz).map(|_| t.eta_mm.map(|v| 1e-3 * v)),
        covariance: Some(covariance),
        backlash: None,
        scatter: Some([sd(Axis::X), sd(Axis::Y), sd(Axis::Rz)]),
    }
}

fn scaled(c: &Calibration, by: f64) -> Calibration {
    Calibration {
        stage_from_pixel: c.stage_from_pixel * by,
        ..c.clone()
    }
}

/// In focus by the truth.
fn focus(bench: &Bench) {
    if let Some(z) = bench.scope.gate().position().unwrap().si(Axis::Z) {
        let z = z - 1e-6 * bench.twin.truth_now().defocus_um;
        let there = StagePose::default().with_si(Axis::Z, z);
        bench.scope.move_to(&there).unwrap();
    }
}

fn begun(bench: &Bench, calibration: Calibration) -> SelfTest {
    let objective = bench.scope.gate().objectives()[0].clone();
    SelfTest::new(objective, calibration, VisionOptions::default())
}

fn tested(
    bench: &Bench,
    calibration: Calibration,
    sink: &mut dyn Sink,
) -> Result<SelfTestReport, ServoError> {
    run(&mut begun(bench, calibration), &bench.scope, sink)
}

fn check(bench: &Bench, calibration: Calibration) -> SelfTestReport {
    tested(bench, calibration, &mut NoSink).unwrap()
}

fn near(report: &SelfTestReport, what: Changing, truth: f64) {
    let change = report.change(what).unwrap();
    assert!(
        (change.by - truth).abs() < 3.0 * change.sigma,
        "{truth}: {change:?}"
    );
}

fn place(bench: &Bench) -> [f64; 3] {
    let at = bench.scope.gate().position().unwrap();
    [Axis::X, Axis::Y, Axis::Rz].map(|axis| at.si(axis).unwrap_or(0.0))
}

fn is_home(bench: &Bench, home: [f64; 3]) -> bool {
    let here = place(bench);
    (0..3).all(|k| (here[k] - home[k]).abs() < 2e-6)
}

#[test]
fn what_changed_of_a_calibration_is_told_with_its_sigma_and_the_stage_comes_home() {
    use SelfTestVerdict::{Drifted, Good, Replace};
    let bench = bench(one_objective());
    focus(&bench);
    let (home, right) = (place(&bench), truth(&bench));
    // Between any two steps the state is a value.
    let mut machine = begun(&bench, right.clone());
    let report = loop {
        let stored = serde_json::to_string(&machine).unwrap();
        machine = serde_json::from_str(&stored).unwrap();
        if let Progress::Done(report) = machine.step(&bench.scope, &mut NoSink).unwrap() {
            break report;
        }
    };
    assert_eq!(report.verdict, Good, "{report:?}");
    assert_eq!(report.changes.len(), 6);
    assert!(report.changes[0].sigma < 1.0 && is_home(&bench, home));
    assert!((report.expected_error_um - right.expected_error_um().unwrap()).abs() < 1e-9);

    let report = check(&bench, scaled(&right, 0.95));
    assert_eq!(report.verdict, Drifted);
    near(&report, Changing::ScalePercent, 100.0 * (1.0 / 0.95 - 1.0));
    assert_eq!(report.sure_changes()[0].what, Changing::ScalePercent);

    assert_eq!(check(&bench, scaled(&right, 0.8)).verdict, Replace);

    let mut off = right.clone();
    off.rotation_centre_m = off.rotation_centre_m.map(|[x, y]| [x - 3e-4, y + 1e-4]);
    let report = check(&bench, off.clone());
    assert_eq!(report.verdict, Drifted);
    near(&report, Changing::CentreXUm, 300.0);
    near(&report, Changing::CentreYUm, -100.0);
    near(&report, Changing::ScalePercent, 0.0);
    // So far off that the view is lost by a degree.
    off.rotation_centre_m = off.rotation_centre_m.map(|[x, y]| [x - 8e-3, y]);
    let report = check(&bench, off.clone());
    assert_eq!(report.verdict, Replace);
    near(&report, Changing::CentreXUm, 8300.0);
    off.rotation_centre_m = Some([-0.3, 0.0]);
    assert_eq!(check(&bench, off).broken, Some(Broken::CentreLost));

    // Both axes the other way; and one of them.
    assert_eq!(check(&bench, scaled(&right, -1.0)).verdict, Replace);
    let mut mirrored = right;
    mirrored.stage_from_pixel = Mat2::diagonal(-1.0, 1.0) * mirrored.stage_from_pixel;
    let report = check(&bench, mirrored);
    assert_eq!(report.verdict, Replace);
    assert_eq!(report.broken, Some(Broken::OtherHand));
    assert!(is_home(&bench, home));
}

#[test]
fn a_camera_that_was_turned_is_told_by_its_angle() {
    for (mirrored, stage) in [
        (false, StageConfig::hexapod()),
        (true, StageConfig::xyz_theta()),
    ] {
        let config = |turned_deg: f64| {
            let mut config = one_objective().with_stage(stage.clone());
            config.mount.mirrored = mirrored;
            config.mount.phi_deg += turned_deg;
            config
        };
        let before = truth(&bench(config(0.0)));
        let bench = bench(config(2.0));
        focus(&bench);
        let report = check(&bench, before);
        assert_eq!(report.verdict, SelfTestVerdict::Drifted);
        // Of a mirrored image it is the direction of x, which turns the other way.
        near(
            &report,
            Changing::AngleDeg,
            if mirrored { -2.0 } else { 2.0 },
        );
        near(&report, Changing::ScalePercent, 0.0);
    }
}

/// A stage that arrives anywhere within 1.5 um, and stands 5 um behind after it has turned round, which a calibration has seen.
fn cheap(config: Config, seed: u64) -> (Bench, Calibration) {
    let mut config = config.with_stage(StageConfig::xy());
    for axis in &mut config.stage.axes {
        (axis.repeatability, axis.backlash, axis.encoder_error) = (1.5, 5.0, 0.0);
    }
    let bench = common::bench_seeded(config, seed);
    let mut known = truth(&bench);
    known.backlash = Some(Backlash {
        x_m: 5e-6,
        y_m: 5e-6,
        rz_rad: 0.0,
        sigma: [2e-7, 2e-7, 0.0],
    });
    known.scatter = Some([1.5e-6 / 3f64.sqrt(), 1.5e-6 / 3f64.sqrt(), 0.0]);
    (bench, known)
}

#[test]
fn play_and_scatter_are_no_drift() {
    let mut sum = 0.0;
    for seed in 0..20 {
        let (bench, known) = cheap(one_objective(), seed);
        let report = check(&bench, known);
        assert_eq!(report.verdict, SelfTestVerdict::Good, "{seed}: {report:?}");
        sum += report.chi_square / 20.0;
    }
    // Four numbers.
    assert!((2.0..6.5).contains(&sum), "{sum}");
    let mut sum = 0.0;
    for seed in 0..10 {
        let bench = common::bench_seeded(one_objective(), seed);
        focus(&bench);
        let report = check(&bench, truth(&bench));
        assert_eq!(report.verdict, SelfTestVerdict::Good, "{seed}: {report:?}");
        sum += report.chi_square / 10.0;
    }
    // Six numbers.
    assert!((2.5..10.0).contains(&sum), "{sum}");
}

fn over(specimen: impl Specimen + 'static, dust: &[DustConfig]) -> Bench {
    let mut config = one_objective();
    config.camera.dust = dust.to_vec();
    let bench = bench_over(config, Arc::new(specimen), Vec::new());
    focus(&bench);
    bench
}

#[test]
fn a_check_over_nothing_is_refused_and_dust_is_no_specimen() {
    let dust = DustConfig {
        specks: 40,
        radius_px: [4.0, 12.0],
        attenuation: [0.3, 0.8],
        steepness: [15, 40],
        ..DustConfig::default()
    };
    let blank = over(Blank, std::slice::from_ref(&dust));
    let home = place(&blank);
    let ended = tested(&blank, truth(&blank), &mut NoSink);
    assert!(
        matches!(
            ended,
            Err(ServoError::CheckStands { .. } | ServoError::CheckUnclear { .. })
        ),
        "{ended:?}"
    );
    assert!(is_home(&blank, home));
    let ended = tested(&over(Blank, &[]), truth(&blank), &mut NoSink);
    assert!(
        matches!(ended, Err(ServoError::CheckUnclear { .. })),
        "{ended:?}"
    );

    let sparse = SparseConfig {
        per_mm2: 400.0,
        contrast: 0.3,
        ..SparseConfig::default()
    };
    let weak = over(Sparse::new(sparse).unwrap(), &[dust]);
    let right = truth(&weak);
    assert_eq!(check(&weak, right.clone()).verdict, SelfTestVerdict::Good);
    let report = check(&weak, scaled(&right, 1.05));
    assert_eq!(report.verdict, SelfTestVerdict::Drifted);
}

#[test]
fn an_axis_that_stands_is_no_fault_of_the_calibration() {
    for stuck in [Axis::X, Axis::Y, Axis::Rz] {
        let bench = bench(one_objective());
        focus(&bench);
        let (axis, right) = (stuck, truth(&bench));
        bench
            .twin
            .fault(StageFault::StuckAxis { axis, stuck: true });
        let ended = tested(&bench, right, &mut NoSink);
        assert!(
            matches!(&ended, Err(ServoError::CheckStands { axis, .. }) if *axis == stuck),
            "{stuck}: {ended:?}"
        );
    }
}

#[test]
fn a_check_that_is_stopped_stays_where_it_is() {
    let bench = bench(one_objective());
    focus(&bench);
    let (home, right) = (place(&bench), truth(&bench));
    let cancel = bench.cancel.clone();
    let mut sink = Listener(|event: &Event| {
        if matches!(event, Event::CalibrationView { index: 1, .. }) {
            cancel.cancel();
        }
    });
    tested(&bench, right, &mut sink).unwrap_err();
    assert!(!is_home(&bench, home));
}

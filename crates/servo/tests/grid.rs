//! The check with a pattern slide, against what only the simulator knows.

mod common;

use common::{Bench, Listener, bench_over, one_objective};
use scopeservo_features::GrayImage;
use scopeservo_geometry::Mat2;
use scopeservo_registration::find_grid;
use scopeservo_scope::{Axis, StagePose};
use scopeservo_servo::{
    Calibration, Event, GridCheck, GridOptions, GridReport, Known, NoSink, Procedure, Progress,
    Quantity, ServoError, Sink, compare_with, run,
};
use scopeservo_twin::specimen::{Lattice, LatticeConfig, Tissue};
use scopeservo_twin::{Config, LatticeKind, SpecimenEvent, StageConfig};
use std::sync::Arc;

const PITCH_UM: f64 = 20.0;

/// Over a grid, in focus by the truth: the focus has tests of its own.
fn over(config: Config, change: impl FnOnce(&mut LatticeConfig)) -> Bench {
    let mut lattice = LatticeConfig::default();
    change(&mut lattice);
    let bench = bench_over(config, Arc::new(Lattice::new(lattice).unwrap()), Vec::new());
    if let Some(z) = bench.scope.gate().position().unwrap().si(Axis::Z) {
        let z = z - 1e-6 * bench.twin.truth_now().defocus_um;
        let there = StagePose::default().with_si(Axis::Z, z);
        bench.scope.move_to(&there).unwrap();
    }
    bench
}

fn begun(bench: &Bench, pitch_um: f64) -> GridCheck {
    let objective = bench.scope.gate().objectives()[0].clone();
    let options = GridOptions {
        pitch_um,
        ..GridOptions::default()
    };
    GridCheck::new(objective, options)
}

fn check(bench: &Bench, pitch_um: f64, sink: &mut dyn Sink) -> Result<GridReport, ServoError> {
    run(&mut begun(bench, pitch_um), &bench.scope, sink)
}

/// What a perfect calibration of the twin would be, with the paper's covariance of the map: 0.01 %.
fn truth(bench: &Bench, like: &GridReport) -> Calibration {
    let t = bench.twin.true_calibration(like.objective()).unwrap();
    let (s, c) = t.phi_deg.to_radians().sin_cos();
    let map = Mat2([[-s, -c], [-c, s]]) * Mat2::diagonal(1.0 / t.kx, 1.0 / t.ky);
    let mut covariance = [[0.0; 6]; 6];
    for (k, row) in covariance.iter_mut().enumerate() {
        row[k] = if k < 4 {
            5e-11f64.powi(2)
        } else {
            1e-5f64.powi(2)
        };
    }
    Calibration {
        stage_from_pixel: map,
        rotation_centre_m: like
            .calibration
            .rotation_centre_m
            .map(|_| t.eta_mm.map(|v| 1e-3 * v)),
        covariance: Some(covariance),
        ..like.calibration.clone()
    }
}

fn near(what: &str, known: Known, truth: f64, most_sigma: f64) {
    let off = (known.value - truth) / known.sigma;
    assert!(
        off.abs() < 3.5 && known.sigma < most_sigma,
        "{what}: {known:?} {truth}"
    );
}

#[test]
fn the_papers_instrument_is_known_on_a_turned_grid_with_a_missing_dot_behind_dust() {
    let bench = over(one_objective(), |c| {
        c.turned_deg = 17.0;
        // In the middle of the first view.
        c.odd_cell = Some([14, 5]);
    });
    let home = bench.scope.gate().position().unwrap();
    let mut machine = begun(&bench, PITCH_UM);
    // Between any two steps the state is a value.
    let report = loop {
        let stored = serde_json::to_string(&machine).unwrap();
        machine = serde_json::from_str(&stored).unwrap();
        if let Progress::Done(report) = machine.step(&bench.scope, &mut NoSink).unwrap() {
            break report;
        }
    };
    let t = bench.twin.true_calibration(report.objective()).unwrap();
    let reading = report.reading.unwrap();
    near("kx", reading.kx_px_per_m, t.kx, 2e-4 * t.kx.abs());
    near("ky", reading.ky_px_per_m, t.ky, 2e-4 * t.ky.abs());
    near("phi", reading.phi_deg, t.phi_deg, 0.005);
    near("skew", report.skew_deg, 0.0, 0.005);
    let [x, y] = report.rotation_centre_um.unwrap();
    near("eta x", x, 1e3 * t.eta_mm[0], 100.0);
    near("eta y", y, 1e3 * t.eta_mm[1], 100.0);
    let stage = report.stage;
    near("stage x", stage.x, 0.0, 5e-4);
    near("stage y", stage.y, 0.0, 5e-4);
    near("rotation", stage.rotation.unwrap(), 0.0, 0.01);
    assert!(
        !report.distortion.seen && report.distortion.sigma < 2e-4,
        "{:?}",
        report.distortion
    );
    assert!(
        report.left_out >= 1 && report.nodes > 100,
        "{}",
        report.nodes
    );
    // It is back, and a right calibration agrees.
    let back = bench.scope.gate().position().unwrap();
    for axis in [Axis::X, Axis::Y] {
        assert!((back.si(axis).unwrap() - home.si(axis).unwrap()).abs() < 1e-6);
    }
    let comparison = compare_with(&report, &truth(&bench, &report));
    assert!(comparison.agrees, "{comparison:?}");
    assert_eq!(comparison.compared.len(), 6);
}

#[test]
fn a_mirrored_distorting_instrument_that_carries_the_specimen_is_known_on_lines() {
    let mut config = one_objective().with_stage(StageConfig::xyz_theta());
    config.mount.mirrored = true;
    config.optics[0].distortion = 0.003;
    let bench = over(config, |c| {
        (c.kind, c.fill, c.turned_deg) = (LatticeKind::Lines, 0.12, 44.9);
    });
    let report = check(&bench, PITCH_UM, &mut NoSink).unwrap();
    assert!(report.mirrored && report.reading.is_none());
    let d = report.distortion;
    assert!(
        d.seen && (d.value - 0.003).abs() < 4.0 * d.sigma && d.sigma < 2e-4,
        "{d:?}"
    );
    let comparison = compare_with(&report, &truth(&bench, &report));
    assert!(comparison.agrees, "{comparison:?}");
    let size = report.um_per_px[0];
    assert!(size.sigma < 2e-4 * size.value, "{size:?}");
    // One of the other hand does not.
    let mut other = truth(&bench, &report);
    other.stage_from_pixel = Mat2(other.stage_from_pixel.0.map(|[a, b]| [-a, b]));
    assert!(!compare_with(&report, &other).agrees);
}

#[test]
fn a_stage_whose_screws_are_off_is_told_and_so_is_the_calibration_that_believed_it() {
    // A grid that is said to be 0.5 % coarser than it is looks like a stage that goes 0.5 % too far.
    let bench = over(one_objective().with_stage(StageConfig::xy()), |_| ());
    let report = check(&bench, 1.005 * PITCH_UM, &mut NoSink).unwrap();
    near("stage x", report.stage.x, 0.005, 5e-4);
    near("stage y", report.stage.y, 0.005, 5e-4);
    assert!(report.rotation_centre_um.is_none() && report.stage.rotation.is_none());
    let comparison = compare_with(&report, &truth(&bench, &report));
    let wrong: Vec<Quantity> = comparison
        .compared
        .iter()
        .filter(|c| !c.agrees)
        .map(|c| c.quantity)
        .collect();
    assert_eq!(wrong, [Quantity::KxPxPerM, Quantity::KyPxPerM]);
    let kx = comparison.compared[0];
    assert!(
        (kx.difference / kx.grid.value - 0.005).abs() < 5e-4,
        "{kx:?}"
    );
}

#[test]
fn what_shows_no_such_grid_is_refused_and_the_stage_comes_home_unless_it_was_stopped() {
    let place = |bench: &Bench| bench.scope.gate().position().unwrap();
    let away_um = |bench: &Bench, home: &StagePose| {
        let now = place(bench);
        let along = |axis| 1e6 * (now.si(axis).unwrap() - home.si(axis).unwrap());
        f64::hypot(along(Axis::X), along(Axis::Y))
    };
    let config = || one_objective().with_stage(StageConfig::xy());
    let tissue = bench_over(config(), Arc::new(Tissue::new(7)), Vec::new());
    let home = place(&tissue);
    let said = check(&tissue, PITCH_UM, &mut NoSink)
        .unwrap_err()
        .to_string();
    assert!(
        said.contains("nothing in the image repeats itself"),
        "{said}"
    );
    assert!(away_um(&tissue, &home) < 1.0);

    let bench = over(config(), |_| ());
    let home = place(&bench);
    let said = check(&bench, 50.0, &mut NoSink).unwrap_err().to_string();
    assert!(said.contains("is the pitch 50 um"), "{said}");
    // One that is near enough for the engraved scale is not for the stage.
    let said = check(&bench, 22.0, &mut NoSink).unwrap_err().to_string();
    assert!(said.contains("Is the pitch 22 um"), "{said}");
    assert!(away_um(&bench, &home) < 1.0);
    // Something slides over the grid in the middle of it.
    let mut sink = Listener(|event: &Event| {
        if matches!(event, Event::CalibrationView { index: 4, .. }) {
            bench.twin.inject(SpecimenEvent::Occlusion {
                centre_um: [0.0; 2],
                size_um: [2e4, 2e4],
                rgb: [90, 90, 90],
            });
        }
    });
    let ended = check(&bench, PITCH_UM, &mut sink);
    assert!(
        matches!(ended, Err(ServoError::GridUnfollowed { followed: 5, .. })),
        "{ended:?}"
    );
    assert!(away_um(&bench, &home) < 1.0);

    bench.twin.inject(SpecimenEvent::Clean);
    let cancel = bench.cancel.clone();
    let mut sink = Listener(|event: &Event| {
        if matches!(event, Event::CalibrationView { index: 5, .. }) {
            cancel.cancel();
        }
    });
    check(&bench, PITCH_UM, &mut sink).unwrap_err();
    assert!(away_um(&bench, &home) > 10.0);
}

/// Scale and direction of image x and y and the angle between them, by one image: errors over standard deviations.
#[test]
fn one_image_knows_the_scale_to_a_fiftieth_of_a_percent_and_how_well_it_does() {
    let mut sum = [0.0; 3];
    let mut count = 0.0f64;
    for (objective, pitch_um) in [(2, 20.0), (0, 100.0)] {
        let mut config = Config::realistic();
        config.optics = vec![config.optics[objective].clone()];
        let bench = over(config, |c| c.pitch_um = pitch_um);
        let nominal = bench.scope.gate().objectives()[0].nominal_um_per_px;
        for k in 0..8 {
            let k = f64::from(k);
            bench
                .twin
                .centre_specimen([37.7 * k, -23.1 * k], 22.5 * k - 90.0);
            let frame = bench.scope.grab().unwrap();
            let [u, v] = bench
                .twin
                .truth(frame.sequence)
                .unwrap()
                .specimen_from_pixel;
            let specimen_from_pixel = Mat2([[u[0], u[1]], [v[0], v[1]]]);
            let image = GrayImage::new(frame.width, frame.height, frame.luminance()).unwrap();
            let grid = find_grid(&image, pitch_um / nominal).unwrap();
            // The grid on the specimen is upright squares of the pitch, turned.
            let numbers = |map: Mat2| {
                let Mat2([[a, b], [c, d]]) = specimen_from_pixel * map * (1.0 / pitch_um);
                [a.hypot(c) - 1.0, b.hypot(d) - 1.0, a * b + c * d]
            };
            let off = numbers(grid.pixel_from_lattice);
            let by = [0, 1, 2, 3].map(|i| {
                let mut moved = grid.pixel_from_lattice;
                moved.0[i / 2][i % 2] += 1e-4;
                let moved = numbers(moved);
                [0, 1, 2].map(|q| (moved[q] - off[q]) / 1e-4)
            });
            for q in 0..3 {
                let all = (0..4).flat_map(|i| (0..4).map(move |j| (i, j)));
                let variance: f64 = all
                    .map(|(i, j)| by[i][q] * grid.covariance[i][j] * by[j][q])
                    .sum();
                assert!(off[q].abs() < 5e-5, "{pitch_um} {k} {off:?}");
                sum[q] += off[q].powi(2) / variance;
            }
            count += 1.0;
        }
    }
    for sum in sum {
        let rms = (sum / count).sqrt();
        assert!((0.6..1.45).contains(&rms), "{rms}");
    }
}

//! Two objectives of the simulated microscope that come in turn, against its truth.

mod common;

use common::{bench_seeded, options};
use scopeservo_scope::{Axis, Instrument};
use scopeservo_servo::{
    Bring, Calibrate, Calibration, FocusOptions, NoSink, ServoError, Switching, SwitchingOptions,
    SwitchingReport, VisionOptions, run,
};
use scopeservo_twin::specimen::Blank;
use scopeservo_twin::{Config, Twin};

fn two_objectives() -> Config {
    let mut config = Config::realistic();
    config.optics.remove(0);
    config
}

/// Calibrates each objective.
fn calibrated(scope: &Instrument) -> [Calibration; 2] {
    let vision = VisionOptions::default();
    [0, 1].map(|k| {
        let objective = scope.gate().objectives()[k].clone();
        let focus = Some(FocusOptions::default());
        let mut bring = Bring::new(objective.id.clone(), focus, vision.clone());
        run(&mut bring, scope, &mut NoSink).unwrap();
        let mut calibrate = Calibrate::new(objective, options().calibrate, vision.clone());
        run(&mut calibrate, scope, &mut NoSink).unwrap()
    })
}

fn switched(scope: &Instrument, times: usize) -> Result<SwitchingReport, ServoError> {
    let options = SwitchingOptions {
        times,
        ..SwitchingOptions::default()
    };
    let mut switching = Switching::new(calibrated(scope), options);
    scope.command_begins();
    run(&mut switching, scope, &mut NoSink)
}

/// Where the second objective truly looks beside the first, um.
fn true_offset_um(twin: &Twin) -> [f64; 2] {
    let eta = ["20x", "40x"].map(|id| {
        let id = scopeservo_scope::ObjectiveId(id.into());
        twin.true_calibration(&id).unwrap().eta_mm
    });
    [0, 1].map(|k| 1e3 * (eta[1][k] - eta[0][k]))
}

#[test]
fn offset_and_repeatability_are_those_of_the_nosepiece_and_the_stage_comes_home() {
    for (seed, half_width_um, dust) in [(5, 0.0, true), (6, 2.0, true), (7, 6.0, false)] {
        let mut config = two_objectives();
        config.nosepiece.repeatability_um = half_width_um;
        // Its retreats would count as well.
        config.stage = config.stage.exact();
        if !dust {
            config.camera.dust.clear();
        }
        let bench = bench_seeded(config, seed);
        let home = bench.scope.gate().position().unwrap();
        let told = switched(&bench.scope, 8).unwrap();
        println!("{half_width_um}: {told:?}");
        let truth = true_offset_um(&bench.twin);
        // A uniform scatter of this half-width.
        let scatter = half_width_um / 3f64.sqrt();
        for k in [0, 1] {
            let (offset, one) = (told.offset_um[k], told.repeatability_um[k]);
            let off = (offset.value - truth[k]).abs();
            assert!(
                off <= 3.0 * offset.sigma,
                "{seed}: {offset:?} for {}",
                truth[k]
            );
            let off = (one.value - scatter).abs();
            assert!(
                off <= 3.0 * one.sigma + 0.05,
                "{seed}: {one:?} for {scatter}"
            );
            assert!(offset.sigma < 0.3 + scatter, "{offset:?}");
        }
        let turn = told.repeatability_deg;
        assert!(turn.value <= 0.01, "{turn:?}");
        assert_eq!(told.arrivals, [8, 8]);
        let now = bench.scope.gate().position().unwrap();
        for axis in [Axis::X, Axis::Y] {
            let off = (now.si(axis).unwrap() - home.si(axis).unwrap()).abs();
            assert!(off < 5e-6, "{axis}: {off}");
        }
    }
}

#[test]
fn the_heights_of_two_objectives_are_told_apart_as_well_as_stated() {
    for seed in [8, 9] {
        let mut config = two_objectives();
        config.nosepiece.parfocal_um = 40.0;
        config.nosepiece.focus_repeatability_um = 1.0;
        let bench = bench_seeded(config, seed);
        let told = switched(&bench.scope, 6).unwrap().focus.unwrap();
        // The stage stands in focus of the first objective: the defocus of the second tells its height.
        let height_um = |index: usize| {
            let id = bench.scope.gate().objectives()[index].id.clone();
            bench.scope.select_objective(&id).unwrap();
            let z_um = bench.scope.gate().position().unwrap().z.unwrap().um();
            // Too close is positive, and so is z.
            z_um - bench.twin.truth_now().defocus_um
        };
        let truth = height_um(1) - height_um(0);
        println!("{told:?} for {truth}");
        // The truth is that of one arrival of each.
        let sigma = told.offset_um.sigma.hypot(2f64.sqrt() / 3f64.sqrt());
        assert!(
            (told.offset_um.value - truth).abs() <= 3.0 * sigma,
            "{told:?} for {truth}"
        );
        assert!(told.offset_um.sigma < 2.0, "{told:?}");
    }
}

#[test]
fn over_blank_glass_nothing_is_claimed() {
    let bench = bench_seeded(two_objectives(), 4);
    let calibrations = calibrated(&bench.scope);
    let home = bench.scope.gate().position().unwrap();
    bench.twin.replace_specimen(std::sync::Arc::new(Blank));
    bench.scope.command_begins();
    let options = SwitchingOptions {
        focus: None,
        ..SwitchingOptions::default()
    };
    let mut switching = Switching::new(calibrations, options);
    let answer = run(&mut switching, &bench.scope, &mut NoSink);
    assert!(
        matches!(answer, Err(ServoError::SwitchingUnclear { .. })),
        "{answer:?}"
    );
    let now = bench.scope.gate().position().unwrap();
    assert!((now.x.unwrap().um() - home.x.unwrap().um()).abs() < 5.0);
}

//! Targets that features do not find: correlation finds them, and claims nothing that a run's own moves do not prove.

mod common;

use common::{Bench, Listener, PLACE_UM, bench, bench_over, one_objective, options};
use scopeservo_servo::{
    Calibrate, Calibration, Event, LocatedBy, NoSink, SaveOptions, SaveTarget, Servo, ServoEnd,
    ServoOptions, ServoTask, Target, VisionOptions, run,
};
use scopeservo_twin::specimen::{Lattice, LatticeConfig, Sparse, SparseConfig, Tissue};
use scopeservo_twin::{DustConfig, Truth};
use std::sync::Arc;

/// So few features of each view that they find nothing.
fn blind(correlation: bool) -> VisionOptions {
    VisionOptions {
        view_features: 3,
        correlation,
        ..VisionOptions::default()
    }
}

/// Made on dense tissue without dust.
fn calibration() -> Calibration {
    let bench = bench(one_objective());
    let objective = bench.scope.gate().objectives()[0].clone();
    let vision = VisionOptions::default();
    let mut calibrate = Calibrate::new(objective, options().calibrate, vision);
    run(&mut calibrate, &bench.scope, &mut NoSink).unwrap()
}

fn go(bench: &Bench, target: &Target, known: &Calibration, vision: &VisionOptions) -> ServoEnd {
    told(bench, target, known, vision).0
}

/// Also by what it was located each time.
fn told(
    bench: &Bench,
    target: &Target,
    known: &Calibration,
    vision: &VisionOptions,
) -> (ServoEnd, Vec<LocatedBy>) {
    let mut all = Vec::new();
    let mut listener = Listener(|event: &Event| {
        if let Event::Iteration { by, .. } = event {
            all.push(*by);
        }
    });
    let options = ServoOptions::default();
    let task = ServoTask {
        target,
        view_calibration: known,
        target_calibration: known,
        vision,
        options: &options,
        law: None,
        hand_overs: &[],
        localizer: None,
    };
    let end = run(&mut Servo::default().on(&task), &bench.scope, &mut listener).unwrap();
    (end, all)
}

/// Whatever it says, it does not say that it arrived where it did not.
fn is_true(bench: &Bench, end: &ServoEnd, aim: &Truth) {
    if let ServoEnd::Converged(_) = end {
        let (um, deg) = bench.error_from(aim);
        assert!(
            um <= 1.0 && deg <= 0.05,
            "false arrival: {um} um, {deg} deg"
        );
    }
}

#[test]
fn what_features_do_not_find_is_found_by_correlation_and_proved_by_the_runs_own_moves() {
    let known = calibration();
    let bench = bench(one_objective());
    bench.save();
    let truth = bench.twin.truth_now();
    // Saved with a step aside: what of it moves with the stage is known, and a run must be followed once.
    let mut save = SaveTarget::new(SaveOptions::default());
    let target = run(&mut save, &bench.scope, &mut NoSink).unwrap();
    for (off, turn) in [([38.0, -24.0], 0.0), ([-60.0, 30.0], 2.0)] {
        bench.twin.remount(PLACE_UM, off, turn, false);
        let lost = go(&bench, &target, &known, &blind(false));
        assert!(!matches!(lost, ServoEnd::Converged(_)), "{lost:?}");
        let (end, by) = told(&bench, &target, &known, &blind(true));
        assert!(matches!(end, ServoEnd::Converged(_)), "{end:?}");
        assert!(by.iter().all(|by| *by == LocatedBy::Correlation), "{by:?}");
        let (um, deg) = bench.error_from(&truth);
        assert!(um <= 1.0 && deg <= 0.02, "{um} um, {deg} deg");
    }
}

/// Saved without a move it may be text: the view must be seen to follow twice, and one move leads there.
#[test]
fn what_nothing_shows_to_move_with_the_stage_is_not_arrived_at() {
    let known = calibration();
    let bench = bench(one_objective());
    let (target, truth) = bench.save();
    for off in [[0.0, 0.0], [38.0, -24.0]] {
        bench.twin.remount(PLACE_UM, off, 0.0, false);
        let end = go(&bench, &target, &known, &blind(true));
        is_true(&bench, &end, &truth);
        if off == [0.0; 2] {
            assert!(!matches!(end, ServoEnd::Converged(_)), "{end:?}");
        }
    }
}

fn dust(soft: bool) -> DustConfig {
    let (attenuation, steepness) = match soft {
        true => ([0.15, 0.15], DustConfig::default().steepness),
        false => ([0.3, 0.8], [15, 40]),
    };
    DustConfig {
        specks: 30,
        radius_px: [4.0, 12.0],
        attenuation,
        steepness,
        ..DustConfig::default()
    }
}

#[test]
fn dust_on_the_camera_is_never_arrived_at() {
    let known = calibration();
    for soft in [true, false] {
        let sparse = SparseConfig {
            per_mm2: 400.0,
            ..SparseConfig::default()
        };
        let specimens: [Arc<dyn scopeservo_twin::specimen::Specimen>; 2] = [
            Arc::new(Sparse::new(sparse).unwrap()),
            Arc::new(Tissue::new(7)),
        ];
        for specimen in specimens {
            let bench = bench_over(one_objective(), specimen, Vec::new());
            bench.twin.clean_window();
            bench.twin.settle_dust(&[dust(soft)], 3).unwrap();
            let (target, truth) = bench.save();
            // Beside the goal, and another field of the slide.
            for off in [[0.0, 0.0], [25.0, 15.0], [900.0, 700.0]] {
                bench.twin.remount(PLACE_UM, off, 0.0, false);
                let end = go(&bench, &target, &known, &blind(true));
                is_true(&bench, &end, &truth);
            }
        }
    }
}

#[test]
fn a_lattice_is_never_arrived_at_a_period_aside() {
    let known = calibration();
    for (pitch_um, disorder) in [(20.0, 0.0), (35.0, 0.01), (12.0, 0.0)] {
        let config = LatticeConfig {
            pitch_um,
            disorder,
            ..LatticeConfig::default()
        };
        let specimen = Arc::new(Lattice::new(config).unwrap());
        let bench = bench_over(one_objective(), specimen, Vec::new());
        let (target, truth) = bench.save();
        for off in [[25.0, 15.0], [-60.0, 40.0]] {
            bench.twin.remount(PLACE_UM, off, 1.0, false);
            let end = go(&bench, &target, &known, &blind(true));
            is_true(&bench, &end, &truth);
        }
    }
}

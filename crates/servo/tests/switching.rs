//! Two objectives of the simulated microscope that come in turn, against its truth.

mod common;

use common::{Bench, PLACE_UM, bench_seeded, options};
use scopeservo_scope::{Axis, GateEvent, Instrument, Length, ObjectiveId, StagePose};
use scopeservo_servo::{
    Bring, Calibrate, Calibration, FocusOptions, NoSink, Outcome, Reposition, RepositionOptions,
    ServoError, ServoOptions, Switching, SwitchingOptions, SwitchingReport, Target, Verdict,
    VisionOptions, run,
};
use scopeservo_twin::specimen::Blank;
use scopeservo_twin::{Config, StageConfig, Twin};
use std::sync::{Arc, Mutex};

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
fn true_offset_um(twin: &Twin, objectives: [&str; 2]) -> [f64; 2] {
    let eta = objectives.map(|id| {
        let id = ObjectiveId(id.into());
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
        let truth = true_offset_um(&bench.twin, ["20x", "40x"]);
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
    bench.twin.replace_specimen(Arc::new(Blank));
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

/// A run to a view of the strongest objective that was saved before, by known calibrations.
fn back(bench: &Bench, known: &[Calibration; 2], switchings: Vec<SwitchingReport>) -> Outcome {
    let vision = VisionOptions::default();
    let id = bench.scope.gate().objectives()[1].id.clone();
    let mut bring = Bring::new(id, Some(FocusOptions::default()), vision.clone());
    run(&mut bring, &bench.scope, &mut NoSink).unwrap();
    let target = Target::save(&bench.scope, &vision, &mut NoSink).unwrap();
    let known = known.iter().map(|c| (c.objective.clone(), c.clone()));
    let mut back = Reposition::new(target, options())
        .with_calibrations(known)
        .with_switchings(switchings);
    run(&mut back, &bench.scope, &mut NoSink).unwrap()
}

#[test]
fn a_target_that_a_switch_takes_out_of_the_field_is_found_where_the_switch_is_known() {
    let mut config = Config::realistic();
    config.optics.remove(1);
    config.nosepiece.parcentric_um = 230.0;
    // Farther apart than the stronger one's field is wide, 326 um.
    let bench = (0..200)
        .map(|seed| bench_seeded(config.clone(), seed))
        .find(|bench| {
            let [x, y] = true_offset_um(&bench.twin, ["10x", "40x"]);
            (350.0..400.0).contains(&x.abs()) && y.abs() < 60.0
        })
        .unwrap();
    let calibrations = calibrated(&bench.scope);
    let three = SwitchingOptions {
        times: 3,
        ..SwitchingOptions::default()
    };
    let mut switching = Switching::new(calibrations.clone(), three);
    let told = run(&mut switching, &bench.scope, &mut NoSink).unwrap();
    // Calibrations that do not know their rotation centres well enough to tell.
    let alone = calibrations.clone().map(|c| Calibration {
        covariance: None,
        ..c
    });
    let unknown = back(&bench, &alone, Vec::new());
    assert_eq!(unknown.verdict, Verdict::NotFound, "{}", unknown.message);
    // By switching, and by the rotation centres.
    for (calibrations, switchings) in [(&alone, vec![told]), (&calibrations, Vec::new())] {
        let known = back(&bench, calibrations, switchings);
        assert_eq!(known.verdict, Verdict::Arrived, "{}", known.message);
    }
}

/// Where the slide lies end for end and stays so, the next objective looks aside the other way round.
#[test]
fn a_reversed_slide_on_a_stage_that_cannot_turn_is_handed_over_to_where_the_next_objective_looks() {
    let mut config = Config::realistic().with_stage(StageConfig::xyz());
    config.optics.remove(1);
    config.nosepiece.parcentric_um = 120.0;
    let bench = (0..200)
        .map(|seed| bench_seeded(config.clone(), seed))
        .find(|bench| {
            let [x, y] = true_offset_um(&bench.twin, ["10x", "40x"]);
            (160.0..185.0).contains(&f64::hypot(x, y))
        })
        .unwrap();
    let calibrations = calibrated(&bench.scope);
    let three = SwitchingOptions {
        times: 3,
        ..SwitchingOptions::default()
    };
    let mut switching = Switching::new(calibrations.clone(), three);
    let told = run(&mut switching, &bench.scope, &mut NoSink).unwrap();
    let target = {
        let id = ObjectiveId("40x".into());
        let focus = Some(FocusOptions::default());
        let mut bring = Bring::new(id, focus, VisionOptions::default());
        run(&mut bring, &bench.scope, &mut NoSink).unwrap();
        Target::save(&bench.scope, &VisionOptions::default(), &mut NoSink).unwrap()
    };
    for turned_deg in [0.0, 180.0, 90.0] {
        let aside = [0, 1].map(|k| PLACE_UM[k] + [38.0, -24.0][k]);
        bench.twin.centre_specimen(aside, turned_deg);
        let known = calibrations
            .iter()
            .map(|c| (c.objective.clone(), c.clone()));
        let options = RepositionOptions {
            servo: ServoOptions {
                within_deg: Some(181.0),
                ..options().servo
            },
            ..options()
        };
        let mut back = Reposition::new(target.clone(), options)
            .with_calibrations(known)
            .with_switchings(vec![told.clone()]);
        let outcome = run(&mut back, &bench.scope, &mut NoSink).unwrap();
        assert_eq!(
            outcome.verdict,
            Verdict::Arrived,
            "{turned_deg}: {}",
            outcome.message
        );
        let legs: Vec<&str> = outcome
            .magnifications
            .iter()
            .map(|m| m.objective.0.as_str())
            .collect();
        assert_eq!(legs, ["10x", "40x"], "{turned_deg}: {}", outcome.message);
    }
}

#[test]
fn in_a_new_session_a_height_that_is_predicted_takes_fewer_frames() {
    let mut all = Vec::new();
    for seed in [12, 13, 14] {
        let mut config = two_objectives();
        config.nosepiece.parfocal_um = 60.0;
        let told = switched(&bench_seeded(config.clone(), seed).scope, 3).unwrap();
        let frames = |predicts: bool| {
            // The same microscope, opened again.
            let bench = bench_seeded(config.clone(), seed);
            if predicts {
                let offset_um = told.focus.as_ref().unwrap().offset_um.value;
                let pair = [&told.from, &told.to];
                let offset = Length::from_um(offset_um);
                bench.scope.parfocal_known(pair, offset);
            }
            let [_, second] = [&told.from, &told.to].map(|id| {
                let focus = Some(FocusOptions::default());
                let mut bring = Bring::new(id.clone(), focus, VisionOptions::default());
                run(&mut bring, &bench.scope, &mut NoSink).unwrap().unwrap()
            });
            let defocus_um = bench.twin.truth_now().defocus_um;
            assert!(defocus_um.abs() < 1.0, "{defocus_um}");
            second.samples
        };
        all.push((frames(true), frames(false)));
    }
    assert!(
        all.iter()
            .all(|(with, without)| with < without && *with <= 10)
    );
}

#[test]
fn a_wrong_prediction_costs_frames_and_no_sweep_passes_its_bounds_for_it() {
    for wrong_um in [150.0, -150.0, 190.0, 1000.0, -1000.0] {
        let mut config = two_objectives();
        config.nosepiece.parfocal_um = 20.0;
        let bench = bench_seeded(config, 12);
        let [first, second] = [0, 1].map(|k| bench.scope.gate().objectives()[k].id.clone());
        let pair = [&first, &second];
        bench.scope.parfocal_known(pair, Length::from_um(wrong_um));
        let options = || FocusOptions::default();
        let bring =
            |id: &ObjectiveId| Bring::new(id.clone(), Some(options()), VisionOptions::default());
        run(&mut bring(&first), &bench.scope, &mut NoSink).unwrap();
        let began_um = bench.scope.gate().position().unwrap().z.unwrap().um();
        let nearest_um = Arc::new(Mutex::new(f64::NEG_INFINITY));
        let ear = nearest_um.clone();
        bench.scope.gate().observe(Some(Arc::new(move |event| {
            if let GateEvent::MoveBegan {
                to: StagePose { z: Some(z), .. },
            } = event
            {
                let mut nearest = ear.lock().unwrap();
                *nearest = nearest.max(z.um());
            }
        })));
        let focused = run(&mut bring(&second), &bench.scope, &mut NoSink).unwrap();
        assert!(focused.is_some());
        let defocus_um = bench.twin.truth_now().defocus_um;
        assert!(defocus_um.abs() < 1.0, "{wrong_um}: {defocus_um}");
        // Larger z is nearer.
        let nearer_um = *nearest_um.lock().unwrap() - began_um;
        assert!(
            nearer_um <= options().nearest_um + 1.0,
            "{wrong_um}: {nearer_um}"
        );
        if wrong_um.abs() > options().half_range_um || wrong_um < 0.0 {
            assert!(nearer_um < 100.0, "{wrong_um}: {nearer_um}");
        }
    }
}

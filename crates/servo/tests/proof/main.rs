//! What is fixed to the camera, what repeats itself and what does not rest is never arrived at.

#[path = "../common/mod.rs"]
mod common;
mod killed;
mod repeats;

use common::{Bench, Listener, PLACE_UM, bench, bench_over, one_objective, options};
use scopeservo_scope::{
    Axis, CancelToken, Clock, Instrument, ObjectiveId, StagePose, VirtualClock,
};
use scopeservo_servo::{
    Calibrate, Calibration, Event, NoSink, Outcome, Procedure, Progress, Reason, Reposition,
    SaveOptions, SaveTarget, ServoEnd, ServoError, Target, Verdict, VisionOptions, run,
};
use scopeservo_twin::specimen::Specimen;
use scopeservo_twin::{
    Blank, Config, DustConfig, Lattice, LatticeConfig, MadeSpecimen, Mark, Sparse, SparseConfig,
    StageConfig, StageFault, TwiceConfig, Twin,
};
use std::sync::Arc;

/// Turning plate without a focus drive: runs of few frames.
fn by_hand() -> Config {
    let mut stage = StageConfig::xyz_theta();
    stage.axes.retain(|a| a.axis != Axis::Z);
    one_objective().with_stage(stage)
}

/// The calibration of [`by_hand`], made on dense tissue without dust.
fn calibration() -> (ObjectiveId, Calibration) {
    let bench = bench(by_hand());
    let objective = bench.scope.gate().objectives()[0].clone();
    let mut calibrate = Calibrate::new(
        objective.clone(),
        options().calibrate,
        VisionOptions::default(),
    );
    let made = run(&mut calibrate, &bench.scope, &mut NoSink).unwrap();
    (objective.id, made)
}

fn hard_dust() -> DustConfig {
    DustConfig {
        specks: 40,
        radius_px: [4.0, 12.0],
        attenuation: [0.3, 0.8],
        steepness: [15, 40],
        ..DustConfig::default()
    }
}

fn soft_shadows() -> DustConfig {
    DustConfig {
        specks: 30,
        radius_px: [4.0, 12.0],
        attenuation: [0.15, 0.15],
        ..DustConfig::default()
    }
}

fn sparse() -> Arc<dyn Specimen> {
    Arc::new(
        Sparse::new(SparseConfig {
            per_mm2: 400.0,
            ..SparseConfig::default()
        })
        .unwrap(),
    )
}

fn lattice(pitch_um: f64, disorder: f64) -> Arc<dyn Specimen> {
    let config = LatticeConfig {
        pitch_um,
        disorder,
        ..LatticeConfig::default()
    };
    Arc::new(Lattice::new(config).unwrap())
}

/// Dust, and what is saved of it.
fn over(specimen: Arc<dyn Specimen>, dust: &[DustConfig]) -> Bench {
    let bench = bench_over(by_hand(), specimen, Vec::new());
    bench.twin.clean_window();
    bench.twin.settle_dust(dust, 3).unwrap();
    bench
}

fn save(bench: &Bench) -> Result<Target, ServoError> {
    run(
        &mut SaveTarget::new(SaveOptions::default()),
        &bench.scope,
        &mut NoSink,
    )
}

/// Saved without a move, so with all that is on the camera.
fn save_still(bench: &Bench) -> Target {
    Target::save(&bench.scope, &VisionOptions::default(), &mut NoSink).unwrap()
}

/// The answer, and how often the stage stepped aside for it.
fn go(bench: &Bench, target: Target) -> (Outcome, usize) {
    let mut asides = 0;
    let mut run_to = Reposition::new(target, options()).with_calibrations([calibration()]);
    let outcome = run(
        &mut run_to,
        &bench.scope,
        &mut Listener(|event: &Event| {
            asides += usize::from(matches!(event, Event::SteppedAside { .. }));
        }),
    )
    .unwrap();
    (outcome, asides)
}

/// Whatever it says, it does not say that it arrived where it did not.
fn is_true(bench: &Bench, outcome: &Outcome, aim: &scopeservo_twin::Truth) {
    let (um, deg) = bench.error_from(aim);
    if outcome.verdict == Verdict::Arrived {
        assert!(
            um <= 1.0 && deg <= 0.05,
            "false arrival: {um} um, {deg} deg: {}",
            outcome.message
        );
    }
}

#[test]
fn sparse_tissue_behind_dust_is_arrived_at_however_the_dust_came() {
    for dust in [hard_dust(), soft_shadows()] {
        for (at_saving, coming_back) in [(true, true), (true, false), (false, true)] {
            let bench = over(sparse(), &[]);
            let lies = |there: bool| {
                bench.twin.clean_window();
                if there {
                    bench
                        .twin
                        .settle_dust(std::slice::from_ref(&dust), 3)
                        .unwrap();
                }
            };
            lies(at_saving);
            let aim = bench.twin.truth_now();
            let target = save(&bench).unwrap();
            bench.twin.remount(PLACE_UM, [38.0, -24.0], 1.0, false);
            lies(coming_back);
            let (outcome, _) = go(&bench, target);
            is_true(&bench, &outcome, &aim);
            assert_eq!(
                outcome.verdict,
                Verdict::Arrived,
                "{at_saving} {coming_back}: {}",
                outcome.message
            );
        }
    }
}

#[test]
fn shadows_on_the_camera_are_found_at_saving_kept_with_the_instrument_and_divided_out() {
    let bench = over(sparse(), &[soft_shadows()]);
    let target = save(&bench).unwrap();
    let shadows = bench.scope.flat_field().expect("30 shadows are there");
    assert!(
        (15..=60).contains(&shadows.shadows()),
        "{}",
        shadows.shadows()
    );
    let deepest = shadows.transmission().iter().fold(1.0f32, |a, b| a.min(*b));
    assert!(
        (0.7..0.95).contains(&deepest),
        "15 % is taken away, seen {deepest}"
    );
    let behind_dust = target.moved.unwrap();
    // The same view through a clean window: hardly anything was lost.
    bench.twin.clean_window();
    let clean = save(&bench).unwrap().moved.unwrap();
    assert!(10 * behind_dust > 8 * clean, "{behind_dust} of {clean}");
}

#[test]
fn where_nothing_moves_no_specimen_is_taken_for_a_shadow() {
    let bench = over(sparse(), &[]);
    for axis in [Axis::X, Axis::Y] {
        bench
            .twin
            .fault(StageFault::StuckAxis { axis, stuck: true });
    }
    let refusal = save(&bench).unwrap_err();
    assert!(
        matches!(refusal, ServoError::NothingMoves { .. }),
        "{refusal}"
    );
    assert_eq!(bench.scope.flat_field(), None);
}

#[test]
fn a_target_saved_with_its_dust_before_anybody_looked_is_found_by_its_tissue() {
    let bench = over(sparse(), &[hard_dust()]);
    let aim = bench.twin.truth_now();
    let target = save_still(&bench);
    bench.twin.remount(PLACE_UM, [38.0, -24.0], 1.0, false);
    let (outcome, _) = go(&bench, target);
    is_true(&bench, &outcome, &aim);
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
}

#[test]
fn blank_glass_with_dust_text_or_a_reticle_is_not_saved() {
    let marks = [
        Mark::Text {
            text: "SAMPLE 7 40X".into(),
            at_px: [20, 20],
            dot_px: 3,
            level: 0.0,
            box_level: None,
        },
        Mark::StagePlace {
            at_px: [20, 440],
            dot_px: 2,
            level: 1.0,
            box_level: Some(0.0),
            packed: false,
        },
        Mark::Reticle {
            centre_px: [320.0, 240.0],
            arm_px: 200.0,
            line_px: 2.0,
            tick_px: 20.0,
            circles_px: vec![60.0],
            attenuation: 0.9,
        },
    ];
    let mut config = by_hand();
    config.camera.marks = marks.to_vec();
    let bench = bench_over(config, Arc::new(Blank), Vec::new());
    bench.twin.settle_dust(&[hard_dust()], 3).unwrap();
    let before = bench.scope.gate().position().unwrap();
    let refusal = save(&bench).unwrap_err();
    assert!(
        matches!(
            refusal,
            ServoError::NothingMoves { .. } | ServoError::PoorTarget { .. }
        ),
        "{refusal}"
    );
    let after = bench.scope.gate().position().unwrap();
    for axis in [Axis::X, Axis::Y] {
        let moved = (after.si(axis).unwrap() - before.si(axis).unwrap()).abs();
        assert!(moved < 1e-6, "the stage is back: {moved}");
    }
}

#[test]
fn when_only_the_camera_agrees_the_run_says_that_nothing_moves() {
    let bench = over(Arc::new(Blank), &[hard_dust()]);
    let target = save_still(&bench);
    let (outcome, _) = go(&bench, target);
    assert_eq!(
        (outcome.verdict, outcome.reason),
        (Verdict::Refused, Reason::NothingMoves),
        "{}",
        outcome.message
    );
    assert_eq!(
        outcome.estimated_error_um, None,
        "of dust nothing is claimed"
    );
}

#[test]
fn an_ordinary_run_makes_no_move_for_the_proof_and_one_that_begins_at_the_goal_steps_aside_once() {
    let bench = over(Arc::new(scopeservo_twin::specimen::Tissue::new(7)), &[]);
    let aim = bench.twin.truth_now();
    let target = save(&bench).unwrap();
    assert!(target.moved.unwrap() > 500);
    let (outcome, asides) = go(&bench, target.clone());
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    assert_eq!(asides, 1);
    bench.twin.remount(PLACE_UM, [38.0, -24.0], 2.0, false);
    let (outcome, asides) = go(&bench, target);
    assert_eq!(
        (outcome.verdict, asides),
        (Verdict::Arrived, 0),
        "{}",
        outcome.message
    );
    assert!(bench.error_from(&aim).0 <= 1.0);
}

/// "X:99.9 Y:20.0" becomes "X:100.1 Y:20.0": all that follows shifts by a letter, as a specimen would.
#[test]
fn text_that_shifts_by_a_letter_as_digits_come_is_not_the_specimen() {
    let line = Mark::StagePlace {
        at_px: [40, 200],
        dot_px: 3,
        level: 0.0,
        box_level: None,
        packed: true,
    };
    let mut tried = 0;
    for (phi_deg, x_um, lambda) in [
        (-90.0, 95.0, 0.7),
        (90.0, 95.0, 0.7),
        (90.0, 95.0, 0.2),
        (90.0, 105.0, 0.2),
        (0.0, 95.0, 0.7),
        (180.0, 98.0, 0.2),
    ] {
        let mut config = by_hand();
        config.mount.phi_deg = phi_deg;
        let known = {
            let bench = bench(config.clone());
            let objective = bench.scope.gate().objectives()[0].clone();
            let id = objective.id.clone();
            let (options, vision) = (options().calibrate, VisionOptions::default());
            let mut calibrate = Calibrate::new(objective, options, vision);
            (id, run(&mut calibrate, &bench.scope, &mut NoSink).unwrap())
        };
        config.camera.dust.clear();
        config.camera.marks = vec![line.clone()];
        let bench = bench_over(config, Arc::new(Blank), Vec::new());
        let stand = |x_um: f64| {
            let to = StagePose::default().with_si(Axis::X, x_um * 1e-6);
            let to = to.with_si(Axis::Y, -2468.3e-6);
            bench.scope.move_to(&to).unwrap();
        };
        stand(x_um);
        let aim = bench.twin.truth_now();
        let target = save_still(&bench);
        for away_um in [0.0, 3.0, -3.0, 8.0, -8.0] {
            bench.twin.remount(PLACE_UM, [38.0, -24.0], 0.0, false);
            stand(x_um + away_um);
            let mut options = options();
            options.servo.lambda = lambda;
            let mut run_to =
                Reposition::new(target.clone(), options).with_calibrations([known.clone()]);
            let outcome = run(&mut run_to, &bench.scope, &mut NoSink).unwrap();
            is_true(&bench, &outcome, &aim);
            tried += 1;
        }
    }
    assert_eq!(tried, 30);
}

#[test]
fn a_stage_with_20_um_of_play_is_no_obstacle() {
    let mut config = by_hand();
    for axis in &mut config.stage.axes {
        if !axis.axis.is_rotation() {
            axis.backlash = 20.0;
        }
    }
    let bench = bench_over(
        config,
        Arc::new(scopeservo_twin::specimen::Tissue::new(7)),
        Vec::new(),
    );
    let target = save(&bench).unwrap();
    assert!(target.moved.unwrap() > 500);
}

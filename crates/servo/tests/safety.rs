//! What must hold when things go wrong or someone wants to stop.

mod common;

use common::{Listener, PLACE_UM, bench, bench_over, one_objective, options};
use scopeservo_geometry::Mat2;
use scopeservo_scope::{Axis, AxisRange, Instrument, Motion, ScopeError};
use scopeservo_servo::{
    Calibrate, CalibrateOptions, Contradiction, Event, Focus, FocusOptions, NoSink, Procedure,
    Progress, Reposition, Servo, ServoEnd, ServoError, ServoOptions, ServoTask, Target,
    VisionOptions, run,
};
use scopeservo_twin::specimen::Blank;
use scopeservo_twin::{Config, StageFault};
use std::sync::Arc;

#[test]
fn a_stop_ends_the_run_with_the_stage_at_rest_wherever_it_comes() {
    // After the first calibration view, and in the second iteration of the servo.
    type Wanted = fn(&Event) -> bool;
    let moments: [Wanted; 2] = [
        |e| matches!(e, Event::CalibrationView { index: 0, .. }),
        |e| matches!(e, Event::Iteration { iteration: 1, .. }),
    ];
    for wanted in moments {
        let bench = bench(one_objective());
        let (target, _) = bench.save();
        bench.twin.remount(PLACE_UM, [38.0, -24.0], 3.0, false);
        let cancel = bench.cancel.clone();
        let mut after = 0;
        let mut sink = Listener(|event: &Event| {
            after += usize::from(cancel.is_cancelled());
            if wanted(event) {
                cancel.cancel();
            }
        });
        let ended = run(
            &mut Reposition::new(target, options()),
            &bench.scope,
            &mut sink,
        );
        assert!(
            matches!(
                ended,
                Err(ServoError::Scope(ScopeError::Interrupted { .. }))
            ),
            "{ended:?}"
        );
        assert_ne!(bench.scope.gate().poll().unwrap(), Motion::Moving);
        assert_eq!(after, 0, "something was done after the stop");
    }
}

#[test]
fn over_blank_glass_focus_says_so_and_goes_back() {
    let bench = bench_over(one_objective(), Arc::new(Blank), Vec::new());
    let before = bench.scope.gate().position().unwrap().z.unwrap().um();
    let objective = bench.scope.gate().objectives()[0].clone();
    let ended = run(
        &mut Focus::new(objective, FocusOptions::default()),
        &bench.scope,
        &mut NoSink,
    );
    assert!(
        matches!(ended, Err(ServoError::NoFocus { .. })),
        "{ended:?}"
    );
    let after = bench.scope.gate().position().unwrap().z.unwrap().um();
    assert!((after - before).abs() < 0.5, "{before} {after}");
}

#[test]
fn a_calibration_with_the_wrong_sign_is_stopped_before_it_runs_away() {
    let bench = bench(one_objective());
    let objective = bench.scope.gate().objectives()[0].clone();
    let vision = VisionOptions::default();
    let (target, truth) = bench.save();
    let mut calibrate = Calibrate::new(objective, CalibrateOptions::default(), vision.clone());
    let good = run(&mut calibrate, &bench.scope, &mut NoSink).unwrap();
    let mut wrong = good.clone();
    wrong.stage_from_pixel = Mat2([[-1.0, 0.0], [0.0, -1.0]]) * good.stage_from_pixel;
    // The camera axes of the reading turn with the sign, so the servo sees a sound image and a stage that runs off.
    bench.twin.remount(PLACE_UM, [20.0, 10.0], 0.0, false);
    let options = ServoOptions::default();
    let task = ServoTask {
        target: &target,
        view_calibration: &wrong,
        target_calibration: &wrong,
        vision: &vision,
        options: &options,
        law: None,
        hand_overs: &[],
        localizer: None,
    };
    let mut servo = Servo::default();
    let end = loop {
        if let Progress::Done(end) = servo.step(&task, &bench.scope, &mut NoSink).unwrap() {
            break end;
        }
    };
    let why = Contradiction::Reversed;
    assert!(
        matches!(end, ServoEnd::Contradicted { why: w, .. } if w == why),
        "{end:?}"
    );
    let (um, _) = bench.error_from(&truth);
    assert!(um < 120.0, "it ran {um} um before it was stopped");
}

#[test]
fn steps_lost_while_calibrating_are_noticed() {
    let bench = bench(one_objective());
    let (target, _) = bench.save();
    let mut sink = Listener(|event: &Event| {
        if matches!(event, Event::CalibrationView { index: 2, .. }) {
            let slip = StageFault::LostSteps {
                axis: Axis::X,
                si: 15e-6,
            };
            bench.twin.fault(slip);
        }
    });
    let mut machine = Reposition::new(target, options());
    let outcome = run(&mut machine, &bench.scope, &mut sink).unwrap();
    assert_eq!(
        outcome.reason,
        scopeservo_servo::Reason::CalibrationFailed,
        "{}",
        outcome.message
    );
}

#[test]
fn a_blank_target_is_refused_before_anything_moves() {
    // Without dust: its shadows are features, too.
    let mut config = Config::noiseless();
    config.optics = config.optics.split_off(2);
    let bench = bench_over(config, Arc::new(Blank), Vec::new());
    let target = Target::save(&bench.scope, &VisionOptions::default(), &mut NoSink).unwrap();
    let mut machine = Reposition::new(target, options());
    let outcome = run(&mut machine, &bench.scope, &mut NoSink).unwrap();
    assert_eq!(outcome.reason, scopeservo_servo::Reason::BlankTarget);
    assert_eq!(bench.scope.counters().moves, 0);
    let again = machine.step(&bench.scope, &mut NoSink).unwrap_err();
    assert!(again.to_string().contains("ended already"), "{again}");
}

#[test]
fn the_iteration_limit_is_an_answer_not_an_arrival() {
    let bench = bench(one_objective());
    let (target, _) = bench.save();
    bench.twin.remount(PLACE_UM, [38.0, -24.0], 3.0, false);
    let mut options = options();
    options.servo.max_iterations = 1;
    let outcome = run(
        &mut Reposition::new(target, options),
        &bench.scope,
        &mut NoSink,
    )
    .unwrap();
    assert_eq!(outcome.reason, scopeservo_servo::Reason::IterationLimit);
    assert!(outcome.estimated_error_um.unwrap() > 0.5);
}

/// Places are judged with the slack of the axes, and goals are not: what has stood there can be sent back there. In a corner of its travel a stage
/// with its rotation far away turns to one side only.
#[test]
fn in_a_corner_of_the_travel_a_view_is_saved_and_an_objective_calibrated() {
    let bench = bench(one_objective());
    bench.save();
    let here = bench.scope.gate().position().unwrap();
    let corner = |signs: [f64; 2], beyond_um: f64| {
        let both = std::iter::zip([Axis::X, Axis::Y], signs);
        let ranges = both.map(|(axis, sign)| {
            let end = here.si(axis).unwrap() - sign * beyond_um * 1e-6;
            let (min, max) = if sign > 0.0 {
                (-8e-3, end)
            } else {
                (end, 8e-3)
            };
            AxisRange { axis, min, max }
        });
        let mut rules = bench.twin.rules();
        rules.limits.ranges = ranges.collect();
        Instrument::new(bench.twin.devices(), rules, bench.cancel.clone()).unwrap()
    };
    let calibrated = |scope: &Instrument, name: &str| {
        let objective = scope.gate().objectives()[0].clone();
        let options = options().calibrate;
        let mut calibrate = Calibrate::new(objective, options, VisionOptions::default());
        let known = run(&mut calibrate, scope, &mut NoSink);
        let known = known.unwrap_or_else(|error| panic!("{name}: {error}"));
        let variance = known.covariance.unwrap();
        let sigma_m = [4, 5].map(|k: usize| variance[k][k].sqrt());
        (known.rotation_centre_m.unwrap(), sigma_m)
    };
    let (free_m, free_sigma_m) = calibrated(&bench.scope, "free");
    for (signs, beyond_um) in [
        ([1.0, 1.0], -50.0),
        ([1.0, 1.0], 0.8),
        ([-1.0, 1.0], 0.3),
        ([1.0, -1.0], 0.0),
        ([-1.0, -1.0], 0.8),
    ] {
        let name = format!("{signs:?} {beyond_um}");
        bench.scope.move_to(&here).unwrap();
        let scope = corner(signs, beyond_um);
        let saved = Target::save(&scope, &VisionOptions::default(), &mut NoSink);
        assert!(saved.is_ok(), "{name}: {saved:?}");
        let (centre_m, sigma_m) = calibrated(&scope, &name);
        for k in 0..2 {
            let (off_m, unsure_m) = (centre_m[k] - free_m[k], sigma_m[k].hypot(free_sigma_m[k]));
            assert!(
                unsure_m < 1e-4 && off_m.abs() < 4.0 * unsure_m,
                "{name}: {off_m} {unsure_m}"
            );
        }
        let there = scope.gate().position().unwrap();
        for axis in [Axis::X, Axis::Y] {
            let off = there.si(axis).unwrap() - here.si(axis).unwrap();
            assert!(off.abs() < 2e-6, "{name}: {axis}: {off}");
        }
    }
}

//! The camera sees what moves do: what contradicts them stops a run, is named, and nothing says that it arrived.

mod common;

use common::{Bench, PLACE_UM, bench_over, one_objective, options};
use scopeservo_geometry::Mat2;
use scopeservo_scope::{Axis, AxisRange, Frame, StagePose};
use scopeservo_servo::{
    Calibrate, Calibration, Contradiction, Event, FrameRole, NoSink, Outcome, Reason, Remark,
    Reposition, ServoEnd, Sink, Stamped, Verdict, VisionOptions, run,
};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{StageConfig, StageFault, Twin};
use std::sync::Arc;

fn turntable() -> Bench {
    let config = one_objective().with_stage(StageConfig::xyz_theta());
    bench_over(config, Arc::new(Tissue::new(7)), Vec::new())
}

/// That of every bench here.
fn calibration() -> Calibration {
    let bench = turntable();
    bench.save();
    let objective = bench.scope.gate().objectives()[0].clone();
    let mut calibrate = Calibrate::new(objective, options().calibrate, VisionOptions::default());
    run(&mut calibrate, &bench.scope, &mut NoSink).unwrap()
}

/// Does something after the first frame of the servo, and counts the places from which it was looked since.
struct Breaks<'a, F: Fn(&Twin)> {
    twin: &'a Twin,
    what: F,
    iterations: usize,
    last: Option<StagePose>,
}

impl<F: Fn(&Twin)> Sink for Breaks<'_, F> {
    fn event(&mut self, stamped: Stamped) {
        if let Event::Iteration { stage, .. } = stamped.event {
            if self.iterations == 0 {
                (self.what)(self.twin);
            }
            // Another look from the same place is no move.
            self.iterations += usize::from(self.last.replace(stage) != Some(stage));
        }
    }
    fn frame(&mut self, _: &Frame, _: FrameRole) {}
}

/// Comes back from 60 um with a calibration, while something breaks; also how far it is off in the end, um and deg, and the iterations.
fn come_back(calibration: &Calibration, what: impl Fn(&Twin)) -> (Outcome, (f64, f64), usize) {
    come_back_turned(calibration, 5.0, what)
}

/// The same with a slide that was turned.
fn come_back_turned(
    calibration: &Calibration,
    turned_deg: f64,
    what: impl Fn(&Twin),
) -> (Outcome, (f64, f64), usize) {
    let bench = turntable();
    let (target, truth) = bench.save();
    bench
        .twin
        .remount(PLACE_UM, [38.0, -45.0], turned_deg, false);
    let known = [(calibration.objective.clone(), calibration.clone())];
    let mut reposition = Reposition::new(target, options()).with_calibrations(known);
    let mut sink = Breaks {
        twin: &bench.twin,
        what,
        iterations: 0,
        last: None,
    };
    let began = bench.scope.gate().position().unwrap();
    let outcome = run(&mut reposition, &bench.scope, &mut sink).unwrap();
    let ends = bench.scope.gate().position().unwrap();
    // Home where all axes obey, else where it was when that was seen.
    if let Some(why) = why(&outcome) {
        let stands = matches!(
            why,
            Contradiction::NothingMoved | Contradiction::AxisStands(_)
        );
        for axis in [Axis::X, Axis::Y, Axis::Rz] {
            let off = ends.si(axis).unwrap() - began.si(axis).unwrap();
            assert!(stands || off.abs() < 1e-6, "{why:?}: {axis} is {off} off");
        }
    }
    (outcome, bench.error_from(&truth), sink.iterations)
}

fn why(outcome: &Outcome) -> Option<Contradiction> {
    match outcome.magnifications.last().map(|m| &m.end) {
        Some(ServoEnd::Contradicted { why, .. }) => Some(*why),
        _ => None,
    }
}

fn changed(calibration: &Calibration, map: impl Fn(Mat2) -> Mat2) -> Calibration {
    Calibration {
        stage_from_pixel: map(calibration.stage_from_pixel),
        ..calibration.clone()
    }
}

#[test]
fn moves_that_the_image_contradicts_stop_the_run_and_are_named() {
    let good = calibration();
    let (outcome, (um, deg), _) = come_back(&good, |_| {});
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    assert!(um < 1.0 && deg < 0.02);
    let swap = Mat2([[0.0, 1.0], [1.0, 0.0]]);
    let wrong: [(&str, Calibration, Contradiction); 3] = [
        (
            "the camera is turned by 180 deg",
            changed(&good, |m| m * -1.0),
            Contradiction::Reversed,
        ),
        (
            "x goes the other way",
            changed(&good, |m| Mat2::diagonal(-1.0, 1.0) * m),
            Contradiction::AxisReversed(Axis::X),
        ),
        (
            "x and y are exchanged",
            changed(&good, |m| swap * m),
            Contradiction::Swapped,
        ),
    ];
    for (name, calibration, expected) in wrong {
        let (outcome, _, iterations) = come_back(&calibration, |_| {});
        assert_ne!(outcome.verdict, Verdict::Arrived, "{name}");
        assert_eq!(why(&outcome), Some(expected), "{name}: {}", outcome.message);
        assert!(iterations <= 4, "{name}: {iterations}");
    }
    let sticks =
        |axis: Axis| move |twin: &Twin| twin.fault(StageFault::StuckAxis { axis, stuck: true });
    for axis in [Axis::X, Axis::Y, Axis::Rz] {
        let (outcome, _, iterations) = come_back(&good, sticks(axis));
        assert_eq!(
            (outcome.verdict, outcome.reason),
            (Verdict::Refused, Reason::Contradicted),
            "{axis}: {}",
            outcome.message
        );
        assert_eq!(
            why(&outcome),
            Some(Contradiction::AxisStands(axis)),
            "{}",
            outcome.message
        );
        assert!(iterations <= 4, "{axis}: {iterations}");
    }
    let all = |twin: &Twin| [Axis::X, Axis::Y, Axis::Rz].map(|axis| sticks(axis)(twin));
    let (outcome, _, _) = come_back(&good, |twin| {
        all(twin);
    });
    // The step aside has said so before a second move would.
    assert_eq!(outcome.reason, Reason::NothingMoves, "{}", outcome.message);
}

/// Where its centre lies 125 mm away, what goes with a turn takes the target out of view when the rotation stands.
#[test]
fn a_rotation_far_from_its_centre_that_stands_is_named_however_near_the_target_lay() {
    let bench = || bench_over(one_objective(), Arc::new(Tissue::new(7)), Vec::new());
    let known = {
        let bench = bench();
        bench.save();
        let objective = bench.scope.gate().objectives()[0].clone();
        let mut calibrate =
            Calibrate::new(objective, options().calibrate, VisionOptions::default());
        run(&mut calibrate, &bench.scope, &mut NoSink).unwrap()
    };
    for (shift_um, turned_deg) in [
        ([1.5, -1.0], 1.2),
        ([3.0, 2.0], -4.0),
        ([38.0, -45.0], 3.0),
        ([-45.0, -20.0], -0.8),
        ([20.0, 45.0], 2.0),
    ] {
        let bench = bench();
        let (target, _) = bench.save();
        bench.twin.remount(PLACE_UM, shift_um, turned_deg, false);
        let axis = Axis::Rz;
        bench
            .twin
            .fault(StageFault::StuckAxis { axis, stuck: true });
        let known = [(known.objective.clone(), known.clone())];
        let mut reposition = Reposition::new(target, options()).with_calibrations(known);
        let outcome = run(&mut reposition, &bench.scope, &mut NoSink).unwrap();
        assert_eq!(
            why(&outcome),
            Some(Contradiction::AxisStands(Axis::Rz)),
            "{shift_um:?} {turned_deg}: {}",
            outcome.message
        );
    }
}

/// The small step that shows what moves do goes the way that is open.
#[test]
fn what_moves_do_is_seen_at_the_end_of_an_axis_as_well() {
    let good = calibration();
    let known = changed(&good, |m| Mat2::diagonal(-1.0, 1.0) * m);
    // x takes the target out of view, and y may not go as far as a small step.
    for (y_um, ends_um) in [
        (3.0, [-500.0, 5.0]),
        (-3.0, [-500.0, 5.0]),
        (3.0, [-5.0, 500.0]),
        (-3.0, [-5.0, 500.0]),
    ] {
        let config = one_objective().with_stage(StageConfig::xyz_theta());
        let specimen = Arc::new(Tissue::new(7));
        let [min, max] = ends_um.map(|um| um * 1e-6);
        let ends = AxisRange {
            axis: Axis::Y,
            min,
            max,
        };
        let bench = bench_over(config, specimen, vec![ends]);
        let (target, _) = bench.save();
        bench.twin.remount(PLACE_UM, [-125.0, y_um], 0.0, false);
        let calibrations = [(known.objective.clone(), known.clone())];
        let mut reposition = Reposition::new(target, options()).with_calibrations(calibrations);
        let outcome = run(&mut reposition, &bench.scope, &mut NoSink).unwrap();
        assert_eq!(
            why(&outcome),
            Some(Contradiction::AxisReversed(Axis::X)),
            "{y_um} {ends_um:?}: {}",
            outcome.message
        );
    }
}

/// A calibration by two steps, or of an earlier version, does not know it.
#[test]
fn play_that_no_calibration_knows_is_not_taken_for_an_axis_that_stands() {
    let mut unaware = calibration();
    unaware.backlash = None;
    for play_um in [5.0, 20.0] {
        let with_play = |twin: &Twin| {
            for axis in [Axis::X, Axis::Y] {
                let si = play_um * 1e-6;
                twin.fault(StageFault::Backlash { axis, si });
            }
        };
        let (outcome, (um, deg), _) = come_back(&unaware, with_play);
        assert_eq!(why(&outcome), None, "{play_um}: {}", outcome.message);
        if outcome.verdict == Verdict::Arrived {
            assert!(um < 1.0 && deg < 0.02, "{play_um}: {um} {deg}");
        }
    }
}

#[test]
fn a_push_by_hand_or_lost_steps_are_made_up_for_and_never_taken_for_arrival() {
    let good = calibration();
    for um in [15.0, 40.0, 70.0] {
        let pushed = |twin: &Twin| {
            twin.fault(StageFault::LostSteps {
                axis: Axis::X,
                si: um * 1e-6,
            })
        };
        let (outcome, (off_um, off_deg), _) = come_back(&good, pushed);
        if outcome.verdict == Verdict::Arrived {
            assert!(off_um < 1.0 && off_deg < 0.02, "{um}: {off_um} {off_deg}");
        }
    }
}

#[test]
fn a_calibration_within_the_papers_convergence_range_arrives() {
    let good = calibration();
    for (scale, turned_deg, off_mm) in [
        (1.06, 0.0, 0.0),
        (0.94, 0.0, 0.0),
        (1.0, 1.9, 0.0),
        (1.0, -1.9, 0.0),
        (1.0, 0.0, 2.1),
        (1.06, 1.9, -2.1),
    ] {
        let mut wrong = changed(&good, |m| {
            Mat2::rotation(f64::to_radians(turned_deg)) * m * scale
        });
        let eta = wrong.rotation_centre_m.unwrap();
        wrong.rotation_centre_m = Some([eta[0] + off_mm * 1e-3, eta[1] - off_mm * 1e-3]);
        let (outcome, (um, deg), iterations) = come_back(&wrong, |_| {});
        let name = format!("{scale} {turned_deg} {off_mm}");
        assert_eq!(
            outcome.verdict,
            Verdict::Arrived,
            "{name}: {}",
            outcome.message
        );
        // This stage comes back to a place within 0.5 um in the root mean square, and twice that may be as near as it comes.
        assert!(um < 1.2 && deg < 0.02, "{name}: {um} {deg}");
        assert!(iterations <= 12, "{name}: {iterations}");
    }
}

/// The camera and the objective are watched as well: each is told by itself, and the stage is back where it began.
#[test]
fn a_frozen_a_late_and_a_binned_camera_and_another_objective_are_told_apart() {
    let good = calibration();
    let (outcome, _, moves) = come_back(&good, |twin| {
        twin.fault(StageFault::FrozenCamera(true));
    });
    assert_eq!(outcome.reason, Reason::NothingMoves, "{}", outcome.message);
    assert!(outcome.message.contains("frozen"), "{}", outcome.message);
    assert!(moves <= 3, "{moves}");
    let (outcome, _, moves) = come_back(&good, |twin| {
        twin.fault(StageFault::StaleFrames(3));
    });
    assert_eq!(
        why(&outcome),
        Some(Contradiction::Late(3)),
        "{}",
        outcome.message
    );
    assert!(moves <= 3, "{moves}");
    let (outcome, _, _) = come_back(&good, |twin| {
        twin.fault(StageFault::Binned(2));
    });
    let Some(Contradiction::Scaled(factor)) = why(&outcome) else {
        panic!("{}", outcome.message);
    };
    assert!((factor - 0.5).abs() < 0.02, "{factor}");
    let elsewhere = changed(&good, |m| Mat2::rotation(f64::to_radians(40.0)) * m);
    // With a slide that is turned as well it might be the rotation centre, and is told as a drift.
    let (outcome, _, _) = come_back_turned(&elsewhere, 0.0, |_| {});
    let turned = match why(&outcome) {
        Some(Contradiction::Turned(rad)) => rad.to_degrees().abs(),
        _ => panic!("{}", outcome.message),
    };
    assert!((turned - 40.0).abs() < 3.0, "{turned}");
}

#[test]
fn a_calibration_that_drifted_is_told_with_what_is_off_and_the_run_goes_on() {
    let good = calibration();
    let drifted = |outcome: &Outcome| {
        assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
        match outcome.remarks.as_slice() {
            [
                Remark::Drifted {
                    scale, turned_deg, ..
                },
            ] => (scale.value, turned_deg.value),
            other => panic!("{other:?}"),
        }
    };
    // Pixels are smaller than this calibration says. A turn would leave open whether it is the rotation centre.
    let smaller = changed(&good, |m| m * 1.06);
    let (outcome, _, _) = come_back_turned(&smaller, 0.0, |_| {});
    let (scale, _) = drifted(&outcome);
    assert!((scale + 0.057).abs() < 0.02, "{scale}");
    assert!(outcome.message.contains("drifted"), "{}", outcome.message);
    let turned = |m| Mat2::rotation(f64::to_radians(4.1)) * m;
    let (outcome, _, _) = come_back_turned(&changed(&good, turned), 0.0, |_| {});
    let (_, deg) = drifted(&outcome);
    assert!((deg.abs() - 4.1).abs() < 1.0, "{deg}");
    let (outcome, _, _) = come_back(&good, |_| {});
    assert_eq!(outcome.remarks, []);
}

/// A camera that freezes once a view has passed would confirm it by the same image, wherever the specimen went meanwhile.
#[test]
fn the_image_that_is_to_be_confirmed_confirms_nothing() {
    let good = calibration();
    for (nth, pushed_um, drifts_um_per_s) in [
        (1, 40.0, 0.0),
        (2, 0.0, 0.0),
        (2, 40.0, 0.0),
        (2, -7.0, 0.0),
        (2, 0.0, 5.0),
    ] {
        let bench = turntable();
        let (target, truth) = bench.save();
        bench.twin.remount(PLACE_UM, [38.0, -45.0], 5.0, false);
        let mut passed = 0;
        let mut sink = common::Listener(|event: &Event| {
            if !matches!(
                event,
                Event::Iteration {
                    converged: true,
                    ..
                }
            ) {
                return;
            }
            passed += 1;
            if passed == nth {
                bench.twin.fault(StageFault::FrozenCamera(true));
                bench.twin.fault(StageFault::LostSteps {
                    axis: Axis::X,
                    si: pushed_um * 1e-6,
                });
                bench.twin.fault(StageFault::Drift {
                    um_per_s: [drifts_um_per_s, 0.0, 0.0],
                });
            }
        });
        let known = [(good.objective.clone(), good.clone())];
        let mut reposition = Reposition::new(target, options()).with_calibrations(known);
        let outcome = run(&mut reposition, &bench.scope, &mut sink).unwrap();
        let off = bench.error_from(&truth);
        let what = format!(
            "{nth} of {passed} {pushed_um} {drifts_um_per_s}: {off:?}, {}",
            outcome.message
        );
        assert_eq!(outcome.verdict, Verdict::Refused, "{what}");
        assert_eq!(outcome.reason, Reason::NothingMoves, "{what}");
        assert!(outcome.message.contains("frozen"), "{what}");
    }
}

//! What a stage cannot do: turn, go far enough, come back as near as somebody asks. It is told with what is missing, and what helps helps.

mod common;

use common::{Bench, PLACE_UM, bench, bench_over, one_objective, options};
use scopeservo_scope::{Axis, AxisRange};
use scopeservo_servo::{
    Law, LimitedBy, NoSink, Outcome, Reason, Reposition, RepositionOptions, ServoOptions, Target,
    Verdict, run,
};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, StageConfig};
use std::sync::Arc;

/// The slide is put back: what is in the middle of the view lies so far from the place that was saved, and it is turned from how it lay then.
fn lay(bench: &Bench, shift_um: [f64; 2], turn_deg: f64) {
    let at = [0, 1].map(|k| PLACE_UM[k] + shift_um[k]);
    bench.twin.centre_specimen(at, turn_deg);
}

/// Where the stage began: in the middle, unturned.
fn home(bench: &Bench) {
    let mut there = bench.scope.gate().position().unwrap();
    for axis in [Axis::X, Axis::Y, Axis::Rz] {
        there = match there.si(axis) {
            Some(_) => there.with_si(axis, 0.0),
            None => there,
        };
    }
    bench.scope.move_to(&there).unwrap();
}

fn come(bench: &Bench, target: &Target, within: [Option<f64>; 2]) -> Outcome {
    come_by(bench, target, within, Law::Direct)
}

fn come_by(bench: &Bench, target: &Target, within: [Option<f64>; 2], law: Law) -> Outcome {
    let options = RepositionOptions {
        servo: ServoOptions {
            law,
            within_um: within[0],
            within_deg: within[1],
            ..options().servo
        },
        ..options()
    };
    let mut run_of = Reposition::new(target.clone(), options);
    run(&mut run_of, &bench.scope, &mut NoSink).unwrap()
}

fn answer(outcome: &Outcome) -> (Verdict, Reason) {
    (outcome.verdict, outcome.reason)
}

const ARRIVED: (Verdict, Reason) = (Verdict::Arrived, Reason::Converged);
const CANNOT_TURN: (Verdict, Reason) = (Verdict::Refused, Reason::CannotTurn);
const CANNOT_REACH: (Verdict, Reason) = (Verdict::Refused, Reason::CannotReach);

#[test]
fn a_stage_that_cannot_turn_arrives_and_tells_the_angle_left_while_the_middle_is_in_view() {
    for stage in [StageConfig::xyz(), StageConfig::xy()] {
        let bench = bench(one_objective().with_stage(stage));
        let (target, truth) = bench.save();
        for (turn, within_deg, expected) in [
            (1.5, None, ARRIVED),
            (-12.0, None, ARRIVED),
            (40.0, None, CANNOT_TURN),
            (40.0, Some(45.0), ARRIVED),
            (1.5, Some(1.0), CANNOT_TURN),
            (180.0, None, ARRIVED),
        ] {
            lay(&bench, [38.0, -24.0], turn);
            let outcome = come(&bench, &target, [None, within_deg]);
            assert_eq!(answer(&outcome), expected, "{turn}: {}", outcome.message);
            // The place is back either way, and the figures are true.
            let (um, deg) = bench.error_from(&truth);
            assert!(um <= 1.0, "{turn}: {um} um");
            let (left, in_view) = (outcome.angle_left_deg.unwrap(), outcome.in_view.unwrap());
            assert!((left - deg).abs() < 0.02, "{turn}: {deg} {left}");
            let seen: f64 = if turn == 40.0 { 0.77 } else { 1.0 };
            assert!((in_view - seen).abs() < 0.15, "{turn}: {in_view}");
            assert!(
                outcome.message.contains(&format!("{:.1}", turn.abs()))
                    && outcome.message.contains('%'),
                "{}",
                outcome.message
            );
        }
    }
}

#[test]
fn a_slide_that_is_turned_farther_than_the_stage_turns_is_told_so_and_nothing_moves() {
    let bench = bench(one_objective());
    let (target, _) = bench.save();
    for turn in [180.0, -90.0, 35.0] {
        lay(&bench, [38.0, -24.0], turn);
        let before = bench.scope.gate().position().unwrap();
        let outcome = come(&bench, &target, [None; 2]);
        assert_eq!(answer(&outcome), CANNOT_REACH, "{}", outcome.message);
        let said = format!(
            "the slide is turned {:.0} deg, this stage turns +-21 deg",
            f64::abs(turn)
        );
        assert!(
            outcome.message.contains(&said) && !outcome.message.contains("widen"),
            "{}",
            outcome.message
        );
        // The calibration on the way came home, and nothing went anywhere for the run.
        let after = bench.scope.gate().position().unwrap();
        for axis in [Axis::X, Axis::Y, Axis::Rz] {
            let moved = after.si(axis).unwrap() - before.si(axis).unwrap();
            assert!(moved.abs() < 2e-6, "{axis}: {moved}");
        }
        let missing = outcome.missing.unwrap();
        assert!((missing.turned_deg.abs() - f64::abs(turn)).abs() < 0.5);
        let by = missing.of(Axis::Rz).unwrap().by.to_degrees().abs();
        assert!((by - (f64::abs(turn) - 21.0)).abs() < 1.0, "{by}");
    }
}

/// The stage with its lever of 125 mm and little room along y.
fn short_of_y(um: f64) -> Bench {
    let ranges = vec![AxisRange {
        axis: Axis::Y,
        min: -um * 1e-6,
        max: um * 1e-6,
    }];
    bench_over(one_objective(), Arc::new(Tissue::new(7)), ranges)
}

#[test]
fn a_lever_that_takes_more_travel_than_there_is_is_named_and_turning_the_slide_back_helps() {
    let bench = short_of_y(2000.0);
    let (target, truth) = bench.save();
    lay(&bench, [38.0, -24.0], 3.0);
    let outcome = come(&bench, &target, [None; 2]);
    assert_eq!(answer(&outcome), CANNOT_REACH, "{}", outcome.message);
    let missing = outcome.missing.unwrap();
    // 3 deg at 125 mm take 6.5 mm.
    let y_mm = 1e3 * missing.of(Axis::Y).unwrap().by.abs();
    assert!((y_mm - 4.5).abs() < 0.1, "{y_mm} mm: {}", outcome.message);
    assert!(missing.of(Axis::X).is_none() && missing.of(Axis::Rz).is_none());
    let back = missing.turn_back_deg.unwrap();
    assert!((2.0..2.3).contains(&back), "{back}");
    let y = bench.scope.gate().position().unwrap().y.unwrap().m();
    assert!(y.abs() <= 2e-3);
    // What it says helps, and a little less does not.
    home(&bench);
    lay(&bench, [38.0, -24.0], 3.0 - back + 0.2);
    assert_eq!(answer(&come(&bench, &target, [None; 2])), CANNOT_REACH);
    lay(&bench, [38.0, -24.0], 3.0 - back - 0.02);
    let outcome = come(&bench, &target, [None; 2]);
    assert_eq!(answer(&outcome), ARRIVED, "{}", outcome.message);
    assert!(bench.error_from(&truth).0 <= 1.0);
}

#[test]
fn an_angle_that_may_be_left_is_left_where_the_stage_cannot_turn_so_far() {
    let bench = short_of_y(2000.0);
    let (target, truth) = bench.save();
    lay(&bench, [38.0, -24.0], 3.0);
    for law in [Law::Direct, Law::Proportional] {
        let outcome = come_by(&bench, &target, [None, Some(5.0)], law);
        assert_eq!(answer(&outcome), ARRIVED, "{}", outcome.message);
        let (um, deg) = bench.error_from(&truth);
        let left = outcome.angle_left_deg.unwrap();
        assert!(um <= 1.0 && (deg - 3.0).abs() < 0.02 && (left - deg).abs() < 0.02);
        home(&bench);
        lay(&bench, [20.0, -24.0], 3.0);
    }
    // What it can turn it turns.
    home(&bench);
    lay(&bench, [38.0, -24.0], 0.5);
    let outcome = come(&bench, &target, [None, Some(5.0)]);
    assert_eq!(answer(&outcome), ARRIVED, "{}", outcome.message);
    assert!(bench.error_from(&truth).1 < 0.02 && outcome.angle_left_deg.is_none());
}

#[test]
fn a_place_past_the_end_of_the_travel_is_refused_and_a_slide_put_farther_on_is_reached() {
    for stage in [StageConfig::hexapod(), StageConfig::xyz_theta()] {
        let ranges = vec![AxisRange {
            axis: Axis::X,
            min: -400e-6,
            max: 400e-6,
        }];
        let bench = bench_over(
            one_objective().with_stage(stage),
            Arc::new(Tissue::new(7)),
            ranges,
        );
        let (target, truth) = bench.save();
        lay(&bench, [10.0, 0.0], 0.0);
        let first = come(&bench, &target, [None; 2]);
        let known = first.magnifications[0].calibration.clone();
        home(&bench);
        // The stage stands near the end, and the place lies past it.
        let here = bench.scope.gate().position().unwrap();
        bench.scope.move_to(&here.with_si(Axis::X, 380e-6)).unwrap();
        let mut past = 0;
        for at in [[60.0, 0.0], [-60.0, 0.0], [0.0, 60.0], [0.0, -60.0]] {
            lay(&bench, at, 0.0);
            let mut run_of = Reposition::new(target.clone(), options())
                .with_calibrations([(known.objective.clone(), known.clone())]);
            let outcome = run(&mut run_of, &bench.scope, &mut NoSink).unwrap();
            let x = bench.scope.gate().position().unwrap().x.unwrap().m();
            assert!(x.abs() <= 401e-6, "{x}");
            if outcome.verdict == Verdict::Arrived {
                assert!(bench.error_from(&truth).0 <= 1.0);
            } else {
                assert_eq!(answer(&outcome), CANNOT_REACH, "{}", outcome.message);
                let by_um = 1e6 * outcome.missing.unwrap().of(Axis::X).unwrap().by;
                assert!((by_um - 40.0).abs() < 3.0, "{by_um}: {}", outcome.message);
                assert!(outcome.message.contains("Put the slide"));
                assert!((x - 380e-6).abs() < 2e-6, "moved to {x}");
                past += 1;
            }
            let back = here.with_si(Axis::X, 380e-6);
            bench.scope.move_to(&back).unwrap();
        }
        assert_eq!(past, 1, "one of four ways leads past the end");
    }
}

#[test]
fn a_turn_that_only_the_other_way_round_is_within_the_travel_is_made_that_way() {
    let bench = bench(one_objective().with_stage(StageConfig::xyz_theta()));
    let (target, truth) = bench.save();
    let here = bench.scope.gate().position().unwrap();
    for deg in [100f64, -100.0] {
        let turned = here.with_si(Axis::Rz, deg.to_radians());
        bench.scope.move_to(&turned).unwrap();
        // Of both senses one leads past 180 deg.
        for turn in [150.0, -150.0] {
            lay(&bench, [38.0, -24.0], turn);
            let outcome = come(&bench, &target, [None; 2]);
            assert_eq!(
                answer(&outcome),
                ARRIVED,
                "{deg} {turn}: {}",
                outcome.message
            );
            let (um, deg) = bench.error_from(&truth);
            assert!(um <= 1.0 && deg <= 0.02, "{um} {deg}");
            bench.scope.move_to(&turned).unwrap();
        }
    }
}

/// A stage that comes back to a few micrometres.
fn coarse() -> Config {
    let mut stage = StageConfig::xyz_theta();
    for axis in &mut stage.axes {
        if matches!(axis.axis, Axis::X | Axis::Y) {
            axis.repeatability = 3.0;
        }
    }
    one_objective().with_stage(stage)
}

#[test]
fn what_a_user_asks_for_is_kept_or_refused_with_what_the_stage_can_do() {
    let bench = bench(coarse());
    let (target, truth) = bench.save();
    let mut short = 0;
    for (within_um, shift) in [(None, 30.0), (Some(8.0), 31.0), (Some(0.05), 32.0)] {
        home(&bench);
        lay(&bench, [shift, -24.0], 2.0);
        let outcome = come(&bench, &target, [within_um, None]);
        let (um, _) = bench.error_from(&truth);
        match within_um {
            None | Some(8.0) => {
                assert_eq!(answer(&outcome), ARRIVED, "{}", outcome.message);
                assert!(um <= within_um.unwrap_or(8.0), "{um}");
            }
            _ => {
                assert_eq!(
                    answer(&outcome),
                    (Verdict::Refused, Reason::OutsideTolerance),
                    "{}",
                    outcome.message
                );
                assert!(
                    outcome.message.contains("0.05 um was asked for")
                        && outcome.message.contains("this stage comes back to within"),
                    "{}",
                    outcome.message
                );
                assert_eq!(outcome.limited_by, Some(LimitedBy::Repeatability));
                short += 1;
            }
        }
    }
    assert_eq!(short, 1);
}

#[test]
fn more_than_a_good_stage_does_by_itself_is_reached_where_it_can() {
    let bench = bench(one_objective());
    let (target, truth) = bench.save();
    lay(&bench, [38.0, -24.0], 2.0);
    let outcome = come(&bench, &target, [Some(0.25), None]);
    assert_eq!(answer(&outcome), ARRIVED, "{}", outcome.message);
    let (um, _) = bench.error_from(&truth);
    assert!(um <= 0.3, "{um}");
    assert!(outcome.estimated_error_um.unwrap() <= 0.25);
}

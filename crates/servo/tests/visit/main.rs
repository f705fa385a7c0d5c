//! A target of a few cells, which the lowest objective cannot tell from what is around it: a higher one looks where it may be.

mod broken;
#[path = "../common/mod.rs"]
mod common;
mod smear;

use common::bench_over;
use scopeservo_scope::{Axis, ObjectiveId};
use scopeservo_servo::{NoSink, Procedure, Progress, Reason, Reposition, Verdict, run};
use smear::{
    SAVED_UM, TwoFaced, back, bring, config, hard, save, smear, smear_of, there_twice, visited,
};
use std::sync::Arc;

#[test]
fn a_few_cells_are_found_where_they_may_be_by_a_look_with_a_higher_objective() {
    let (mut found, mut saved) = (0, 0);
    for seed in 1..=10 {
        if found == 3 {
            break;
        }
        let bench = bench_over(config(), smear(seed), Vec::new());
        let Some((target, truth)) = save(&bench) else {
            continue;
        };
        saved += 1;
        bench.twin.remount(SAVED_UM, [260.0, -170.0], 4.0, false);
        let outcome = run(&mut back(target), &bench.scope, &mut NoSink).unwrap();
        if outcome.verdict == Verdict::Arrived {
            let (um, deg) = bench.error_from(&truth);
            assert!(um <= 1.5 && deg <= 0.05, "{seed}: {um} um, {deg} deg");
            if let Some(most) = visited(&outcome) {
                assert!((1..=12).contains(&most), "{most}");
                assert!(outcome.message.contains("looked where it may be"));
                found += 1;
            }
        }
    }
    assert_eq!(found, 3, "of {saved}");
}

#[test]
fn a_look_goes_on_after_a_kill_between_any_two_steps() {
    let (bench, target, truth) = hard();
    let target = Arc::new(target);
    let mut machine = back((*target).clone());
    let outcome = loop {
        let stored = serde_json::to_string(&machine).unwrap();
        let restored: Reposition = serde_json::from_str(&stored).unwrap();
        machine = restored.with_target(target.clone());
        if let Progress::Done(outcome) = machine.step(&bench.scope, &mut NoSink).unwrap() {
            break outcome;
        }
    };
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    assert!(visited(&outcome).is_some());
    let (um, deg) = bench.error_from(&truth);
    assert!(um <= 1.5 && deg <= 0.05, "{um} um, {deg} deg");
}

#[test]
fn what_is_not_there_when_looked_at_leaves_stage_and_objective_as_the_lowest_saw_it() {
    let mut looked = 0;
    // Something else lies there, and nothing to focus on.
    for (seed, per_mm2) in [(1, 75.0), (5, 75.0), (1, 0.5)] {
        let there = bench_over(config(), smear(seed), Vec::new());
        let Some((target, _)) = save(&there) else {
            continue;
        };
        let specimen = TwoFaced {
            afar: smear(seed),
            near: smear_of(per_mm2, 100 + seed),
        };
        let bench = bench_over(config(), Arc::new(specimen), Vec::new());
        bring(&bench.scope, "10x");
        bench.twin.remount(SAVED_UM, [260.0, -170.0], 4.0, false);
        let began = bench.scope.gate().position().unwrap();
        let outcome = run(&mut back(target), &bench.scope, &mut NoSink).unwrap();
        let said = (outcome.verdict, outcome.reason);
        let told = (Verdict::NotFound, Reason::TargetNotInView);
        assert_eq!(said, told, "{seed}: {}", outcome.message);
        if visited(&outcome).is_none() {
            continue;
        }
        looked += 1;
        assert!(
            outcome.message.contains("not found at 100x"),
            "{}",
            outcome.message
        );
        let ended = bench.scope.gate().position().unwrap();
        for axis in [Axis::X, Axis::Y] {
            let off_um = 1e6 * (ended.si(axis).unwrap() - began.si(axis).unwrap());
            assert!(off_um.abs() <= 5.0, "{seed}: {axis:?} is {off_um} um off");
        }
        let active = bench.scope.gate().current_objective().unwrap();
        assert_eq!(active, Some(ObjectiveId("10x".into())), "{seed}");
    }
    assert!(looked >= 2, "{looked}");
}

#[test]
fn a_few_cells_that_are_there_twice_are_not_taken_for_one() {
    let mut looked = 0;
    for seed in 1..=3 {
        let Some((bench, target)) = there_twice(seed) else {
            continue;
        };
        let outcome = run(&mut back(target), &bench.scope, &mut NoSink).unwrap();
        let said = (outcome.verdict, outcome.reason);
        let told = (Verdict::Ambiguous, Reason::Ambiguous);
        assert_eq!(said, told, "{seed}: {}", outcome.message);
        looked += usize::from(visited(&outcome).is_some());
    }
    assert!(looked >= 2, "{looked}");
}

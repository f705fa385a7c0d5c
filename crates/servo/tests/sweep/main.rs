//! The coarse scan in motion: whatever goes wrong in it, the focus is right or a typed answer says why not, and the stage is not left nearer.

mod bench;
#[path = "../common/mod.rs"]
mod common;
mod lies;

use bench::{Odd, Stamp, bench, focus_from, harsh, is_right};
use scopeservo_scope::{Motion, ScopeError};
use scopeservo_servo::{ErrorCode, ServoError, SweepEnd};
use scopeservo_twin::specimen::{Specimen, Tissue};
use scopeservo_twin::{Blank, StageFault};
use std::sync::Arc;

#[test]
fn a_sweep_finds_where_to_look_on_either_side() {
    for start_um in [-170.0, -60.0, 90.0, 180.0] {
        let bench = bench(harsh(), Arc::new(Tissue::new(7)), Odd::Nothing, Stamp::True);
        let (answer, sweep, began) = focus_from(&bench, start_um, || {});
        is_right(&bench, &answer, &start_um.to_string());
        let sweep = sweep.unwrap();
        assert_eq!(sweep.end, SweepEnd::Found, "{start_um}: {sweep:?}");
        let off = sweep.near_um.unwrap() - (began - start_um);
        assert!(off.abs() < 12.0, "{start_um}: {off} um, {sweep:?}");
        // The far side alone where the focus lies there.
        let nearest = sweep.range_um[1] - began;
        assert_eq!(nearest > 1.0, start_um < 0.0, "{start_um}: {sweep:?}");
    }
}

#[test]
fn what_goes_wrong_in_a_sweep_costs_time_and_no_accuracy() {
    let tissue = || Arc::new(Tissue::new(7));
    for (odd, stamp, end) in [
        (Odd::Stalls(0.6), Stamp::True, SweepEnd::Found),
        (Odd::Silent, Stamp::True, SweepEnd::Unknown),
        (Odd::SaysGoal, Stamp::True, SweepEnd::Unknown),
        (Odd::SaysStart, Stamp::True, SweepEnd::Unknown),
        (Odd::Blocks, Stamp::True, SweepEnd::Unknown),
        (Odd::OneSpeed, Stamp::True, SweepEnd::Refused),
        (Odd::Nothing, Stamp::Off(0.05), SweepEnd::Unknown),
        (Odd::Nothing, Stamp::Off(-0.05), SweepEnd::Unknown),
    ] {
        for start_um in [-110.0, 75.0] {
            let bench = bench(harsh(), tissue(), odd, stamp);
            let (answer, sweep, _) = focus_from(&bench, start_um, || {});
            let what = format!("{odd:?}, {stamp:?}, {start_um} um, {sweep:?}");
            is_right(&bench, &answer, &what);
            assert_eq!(sweep.unwrap().end, end, "{what}");
        }
    }
}

#[test]
fn frames_that_are_lost_or_late_in_a_sweep_cost_time_and_no_accuracy() {
    for fault in [
        StageFault::DropFrames(5),
        StageFault::LateFrames {
            count: 3,
            delay_s: 0.2,
        },
        StageFault::TornFrame,
    ] {
        for start_um in [-110.0, 75.0] {
            let bench = bench(harsh(), Arc::new(Tissue::new(7)), Odd::Nothing, Stamp::True);
            let (answer, sweep, _) = focus_from(&bench, start_um, || bench.twin.fault(fault));
            is_right(
                &bench,
                &answer,
                &format!("{fault:?}, {start_um}, {sweep:?}"),
            );
        }
    }
}

#[test]
fn a_camera_that_is_too_slow_for_a_sweep_has_none() {
    let mut config = harsh();
    config.camera.frames_per_s = 2.0;
    let bench = bench(config, Arc::new(Tissue::new(7)), Odd::Nothing, Stamp::True);
    let (answer, sweep, _) = focus_from(&bench, 75.0, || {});
    is_right(&bench, &answer, "two frames a second");
    let sweep = sweep.unwrap();
    assert_eq!((sweep.end, sweep.frames), (SweepEnd::NoFaster, 0));
}

#[test]
fn what_fails_in_a_sweep_is_told_and_leaves_the_stage_no_nearer() {
    let ended = |over: Arc<dyn Specimen>, odd, start_um: f64, fault: Option<StageFault>| {
        let bench = bench(harsh(), over, odd, Stamp::True);
        let (answer, ..) = focus_from(&bench, start_um, || {
            if let Some(fault) = fault {
                bench.twin.fault(fault);
            }
        });
        let is_nearer = bench.twin.truth_now().defocus_um > start_um + 0.5;
        assert!(!is_nearer, "{odd:?} {fault:?}: {answer:?}");
        answer.expect_err("it must not succeed").code()
    };
    let tissue = || Arc::new(Tissue::new(7));
    for start_um in [-60.0, 0.0, 60.0] {
        assert_eq!(
            ended(Arc::new(Blank), Odd::Nothing, start_um, None),
            ErrorCode::NoFocus
        );
    }
    for start_um in [-110.0, -60.0, 75.0] {
        let silent = Some(StageFault::SilentCamera(true));
        assert_eq!(
            ended(tissue(), Odd::Nothing, start_um, silent),
            ErrorCode::Fault
        );
        let pulled = Some(StageFault::Unplugged(true));
        assert_eq!(
            ended(tissue(), Odd::Nothing, start_um, pulled),
            ErrorCode::Fault
        );
        assert_eq!(
            ended(tissue(), Odd::NeverArrives, start_um, None),
            ErrorCode::Fault
        );
    }
}

#[test]
fn a_stop_in_a_sweep_stops_at_once() {
    for start_um in [-110.0, -60.0, 75.0] {
        let bench = bench(harsh(), Arc::new(Tissue::new(7)), Odd::Nothing, Stamp::True);
        let (answer, ..) = focus_from(&bench, start_um, || bench.cancel.cancel());
        let Err(ServoError::Scope(ScopeError::Interrupted { at: Some(at) })) = answer else {
            panic!("{answer:?}");
        };
        let here = bench.twin.stage().position().unwrap();
        assert_eq!(here.z, at.z, "it stands where it was stopped");
        assert_eq!(bench.twin.stage().poll().unwrap(), Motion::Stopped);
    }
}

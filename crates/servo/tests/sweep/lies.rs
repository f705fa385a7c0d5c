//! Devices that lie about a sweep: old images, wrong clocks and speeds, play, a stage that ends half-way, a plug that is pulled.

use crate::bench::{Bench, Odd, Stamp, bench, focus_from, harsh, is_right};
use scopeservo_scope::Axis;
use scopeservo_servo::{ErrorCode, FocusResult, FocusSweep, ServoError, SweepEnd};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, StageFault};
use std::sync::Arc;

fn over_tissue(config: Config, odd: Odd, stamp: Stamp) -> Bench {
    bench(config, Arc::new(Tissue::new(7)), odd, stamp)
}

/// Where a sweep showed where to look the focus is right; where it did not, as right as the scan at rest that followed, which misses a quarter of the depth
/// of field in one or two of a hundred here. What fails is no nearer than it began.
fn right_or_no_nearer(
    bench: &Bench,
    (answer, sweep): (&Result<FocusResult, ServoError>, Option<FocusSweep>),
    start_um: f64,
    what: &str,
) {
    let off = bench.twin.truth_now().defocus_um;
    let is_found = sweep.is_some_and(|s| s.end == SweepEnd::Found);
    match answer {
        Ok(_) if is_found => is_right(bench, answer, what),
        Ok(_) => assert!(off.abs() < 0.6, "{what}: {off} um, {answer:?}"),
        Err(error) => assert!(off <= start_um + 0.5, "{what}: {off} um after {error}"),
    }
}

#[test]
fn old_images_are_never_a_focus_elsewhere() {
    for frames in [1, 3, 12] {
        for start_um in [-110.0, 15.0, 75.0] {
            let bench = over_tissue(harsh(), Odd::Nothing, Stamp::True);
            bench.twin.fault(StageFault::StaleFrames(frames));
            let (answer, sweep, _) = focus_from(&bench, start_um, || {});
            let what = format!("{frames} frames late, {start_um} um, {sweep:?}");
            right_or_no_nearer(&bench, (&answer, sweep), start_um, &what);
        }
    }
}

#[test]
fn a_clock_that_is_wrong_costs_time_and_no_accuracy() {
    for stamp in [
        Stamp::Jumps(0.02),
        Stamp::Jumps(3.0),
        Stamp::Fast(1.001),
        Stamp::Stuck,
    ] {
        for start_um in [-110.0, 75.0] {
            let bench = over_tissue(harsh(), Odd::Nothing, stamp);
            let (answer, sweep, _) = focus_from(&bench, start_um, || {});
            let what = format!("{stamp:?}, {start_um} um, {sweep:?}");
            right_or_no_nearer(&bench, (&answer, sweep), start_um, &what);
            assert!(answer.is_ok(), "{what}: {answer:?}");
        }
    }
}

#[test]
fn another_speed_than_was_asked_for_costs_time_and_no_accuracy() {
    // Without its own speed a stage goes at its usual one: what a driver does that says it knows speeds and does not.
    for times in [0.05, 2.0, 1e6] {
        for start_um in [-110.0, 75.0] {
            let bench = over_tissue(harsh(), Odd::Times(times), Stamp::True);
            let (answer, sweep, _) = focus_from(&bench, start_um, || {});
            let what = format!("{times} times, {start_um} um, {sweep:?}");
            right_or_no_nearer(&bench, (&answer, sweep), start_um, &what);
            assert!(answer.is_ok(), "{what}: {answer:?}");
        }
    }
}

#[test]
fn play_of_20_um_is_a_focus_or_none() {
    let mut config = harsh();
    for axis in &mut config.stage.axes {
        if axis.axis == Axis::Z {
            axis.backlash = 20.0;
        }
    }
    for start_um in [-110.0, 0.0, 170.0] {
        let bench = over_tissue(config.clone(), Odd::Nothing, Stamp::True);
        let (answer, sweep, _) = focus_from(&bench, start_um, || {});
        let what = format!("{start_um} um, {sweep:?}");
        right_or_no_nearer(&bench, (&answer, sweep), start_um, &what);
    }
}

#[test]
fn a_stage_that_ends_half_way_is_a_fault_and_no_nearer() {
    for says_settled in [false, true] {
        for start_um in [-110.0, -60.0, 75.0] {
            let odd = Odd::EndsHalfWay { says_settled };
            let bench = over_tissue(harsh(), odd, Stamp::True);
            let (answer, sweep, _) = focus_from(&bench, start_um, || {});
            let what = format!("{odd:?}, {start_um} um, {sweep:?}");
            right_or_no_nearer(&bench, (&answer, sweep), start_um, &what);
            let error = answer.expect_err(&what);
            assert_eq!(error.code(), ErrorCode::Fault, "{what}: {error}");
        }
    }
}

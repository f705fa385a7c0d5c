//! What a run tries, once each, before it gives up: told, bounded, and put back.

mod common;

use common::{Bench, PLACE_UM, bench_over, one_objective, options};
use scopeservo_scope::{Axis, Frame, Length, StagePose};
use scopeservo_servo::{
    Attempt, Calibrate, Calibration, Contradiction, Event, FrameRole, NoSink, Outcome, Reason,
    Remark, Reposition, ServoEnd, Sink, Stamped, Target, Verdict, VisionOptions, run,
};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{StageConfig, StageFault, Truth, Twin};
use std::sync::{Arc, OnceLock};

fn turntable() -> Bench {
    let config = one_objective().with_stage(StageConfig::xyz_theta());
    bench_over(config, Arc::new(Tissue::new(7)), Vec::new())
}

/// What every bench here begins with: its calibration, the saved view and where that truly is, and the height that was in focus.
struct Saved {
    calibration: Calibration,
    target: Target,
    truth: Truth,
    z: Option<Length>,
}

fn saved() -> &'static Saved {
    static MADE: OnceLock<Saved> = OnceLock::new();
    MADE.get_or_init(|| {
        let bench = turntable();
        let (target, truth) = bench.save();
        let z = bench.scope.gate().position().unwrap().z;
        let objective = bench.scope.gate().objectives()[0].clone();
        let mut calibrate =
            Calibrate::new(objective, options().calibrate, VisionOptions::default());
        Saved {
            calibration: run(&mut calibrate, &bench.scope, &mut NoSink).unwrap(),
            target,
            truth,
            z,
        }
    })
}

/// Does something at each event.
struct Acts<F: FnMut(&Stamped)>(F);

impl<F: FnMut(&Stamped)> Sink for Acts<F> {
    fn event(&mut self, stamped: Stamped) {
        (self.0)(&stamped);
    }
    fn frame(&mut self, _: &Frame, _: FrameRole) {}
}

/// What a run came to.
struct Ended {
    outcome: Outcome,
    attempts: Vec<Attempt>,
    /// How far the view truly is from the target, um and deg.
    off: (f64, f64),
    iterations: usize,
    seconds: f64,
    bench: Bench,
}

/// Comes back to the saved view with a slide that was put back elsewhere; `before` does something first, and `on` at each event.
fn come_back(
    calibration: &Calibration,
    before: impl Fn(&Bench),
    mut on: impl FnMut(&Twin, &Stamped),
) -> Ended {
    let bench = turntable();
    let saved = saved();
    let in_focus = StagePose {
        z: saved.z,
        ..StagePose::default()
    };
    bench.scope.move_to(&in_focus).unwrap();
    let z = saved.z.unwrap();
    bench.scope.focus_found(&calibration.objective, z);
    bench.twin.remount(PLACE_UM, [38.0, -45.0], 3.0, false);
    before(&bench);
    let known = [(calibration.objective.clone(), calibration.clone())];
    let mut reposition = Reposition::new(saved.target.clone(), options()).with_calibrations(known);
    let (mut iterations, mut told) = (0, Vec::new());
    let began = bench.scope.clock().now().seconds();
    let mut acts = Acts(|stamped: &Stamped| {
        match &stamped.event {
            Event::Iteration { .. } => iterations += 1,
            Event::Remarked {
                remark: Remark::Tried { attempt, .. },
            } => told.push(attempt.clone()),
            _ => {}
        }
        on(&bench.twin, stamped);
    });
    let outcome = run(&mut reposition, &bench.scope, &mut acts).unwrap();
    let attempts: Vec<Attempt> = outcome.remarks.iter().filter_map(tried).collect();
    assert_eq!(attempts, told, "all that is in the answer was told");
    Ended {
        attempts,
        off: bench.error_from(&saved.truth),
        iterations,
        seconds: bench.scope.clock().now().seconds() - began,
        outcome,
        bench,
    }
}

fn tried(remark: &Remark) -> Option<Attempt> {
    match remark {
        Remark::Tried { attempt, .. } => Some(attempt.clone()),
        _ => None,
    }
}

fn is_back(ended: &Ended) {
    let (um, deg) = ended.off;
    assert_eq!(
        ended.outcome.verdict,
        Verdict::Arrived,
        "{}",
        ended.outcome.message
    );
    assert!(
        um < 1.2 && deg < 0.02,
        "{um} {deg}: {}",
        ended.outcome.message
    );
}

#[test]
fn a_view_too_dark_or_too_bright_is_exposed_anew_and_the_camera_put_back() {
    let exposed = |bench: &Bench| bench.scope.camera().exposure().unwrap();
    for times in [0.002, 8.0, 14.0] {
        let was = exposed(&turntable());
        let wrong = was.mul_f64(times);
        let ended = come_back(
            &saved().calibration,
            |bench| {
                bench.scope.camera().set_exposure(wrong).unwrap();
            },
            |_, _| {},
        );
        is_back(&ended);
        // What is measured in the dark scatters, and may be taken for play first.
        let tried = match &ended.attempts[..] {
            [Attempt::OtherSide, rest @ ..] => rest,
            all => all,
        };
        let [Attempt::ExposureAdapted { from_ms, to_ms }] = tried else {
            panic!("{times}: {:?}", ended.attempts);
        };
        let ms = |t: std::time::Duration| 1e3 * t.as_secs_f64();
        assert!((from_ms - ms(wrong)).abs() < 1e-6, "{from_ms}");
        // To within what the eye would call the same light.
        assert!((0.5..2.0).contains(&(to_ms / ms(was))), "{times}: {to_ms}");
        assert_eq!(exposed(&ended.bench), wrong, "as it was found");
    }
}

#[test]
fn a_stop_while_the_exposure_is_adapted_leaves_the_camera_as_it_was() {
    let bench = turntable();
    let saved = saved();
    let in_focus = StagePose {
        z: saved.z,
        ..StagePose::default()
    };
    bench.scope.move_to(&in_focus).unwrap();
    bench
        .scope
        .focus_found(&saved.calibration.objective, saved.z.unwrap());
    bench.twin.remount(PLACE_UM, [38.0, -45.0], 3.0, false);
    let exposed = || bench.scope.camera().exposure().unwrap();
    let dark = exposed().mul_f64(0.002);
    bench.scope.camera().set_exposure(dark).unwrap();
    let known = [(
        saved.calibration.objective.clone(),
        saved.calibration.clone(),
    )];
    let mut reposition = Reposition::new(saved.target.clone(), options()).with_calibrations(known);
    // The second look is exposed longer.
    let (mut looks, mut longest) = (0, dark);
    let mut acts = Acts(|stamped: &Stamped| {
        let role = FrameRole::Identify;
        if matches!(&stamped.event, Event::FrameGrabbed { role: r, .. } if *r == role) {
            (looks, longest) = (looks + 1, longest.max(exposed()));
            if looks == 2 {
                bench.cancel.cancel();
            }
        }
    });
    let ended = run(&mut reposition, &bench.scope, &mut acts);
    assert!(ended.is_err(), "{ended:?}");
    assert!(
        looks == 2 && longest > dark.mul_f64(10.0),
        "{looks} {longest:?}"
    );
    assert_eq!(exposed(), dark);
}

#[test]
fn a_view_that_drifts_and_settles_is_waited_for_and_one_that_does_not_is_refused() {
    let drift = |um_per_s: [f64; 2]| {
        let [x, y] = um_per_s;
        StageFault::Drift {
            um_per_s: [x, y, 0.0],
        }
    };
    for um_per_s in [[1.5, 0.0], [-1.0, 2.0], [0.0, -4.0]] {
        let mut since = None;
        let ended = come_back(
            &saved().calibration,
            |bench| {
                bench.twin.fault(drift(um_per_s));
            },
            |twin, stamped| {
                if let Event::Remarked { .. } = stamped.event {
                    since.get_or_insert(stamped.time_s);
                }
                if since.is_some_and(|since| stamped.time_s > since + 6.0) {
                    twin.fault(drift([0.0; 2]));
                }
            },
        );
        is_back(&ended);
        let [Attempt::DriftWaitedFor { um_per_s: seen }] = ended.attempts[..] else {
            panic!("{um_per_s:?}: {:?}", ended.attempts);
        };
        let truly = um_per_s[0].hypot(um_per_s[1]);
        assert!((seen / truly - 1.0).abs() < 0.3, "{um_per_s:?}: {seen}");
    }
    let ended = come_back(
        &saved().calibration,
        |bench| {
            bench.twin.fault(drift([1.0, 1.5]));
        },
        |_, _| {},
    );
    let message = &ended.outcome.message;
    assert_eq!(ended.outcome.reason, Reason::Drifting, "{message}");
    assert_eq!(ended.attempts.len(), 1, "{:?}", ended.attempts);
    assert!(ended.seconds < 60.0, "{}", ended.seconds);
}

#[test]
fn play_that_no_calibration_knows_is_taken_up_from_below() {
    let unaware = Calibration {
        backlash: None,
        ..saved().calibration.clone()
    };
    for play_um in [8.0, 20.0, 40.0] {
        let ended = come_back(
            &unaware,
            |bench| {
                for axis in [Axis::X, Axis::Y] {
                    let si = play_um * 1e-6;
                    bench.twin.fault(StageFault::Backlash { axis, si });
                }
            },
            |_, _| {},
        );
        is_back(&ended);
        assert!(ended.iterations <= 24, "{play_um}: {}", ended.iterations);
    }
}

#[test]
fn a_view_that_shakes_arrives_where_it_is_on_average_or_is_refused() {
    for um in [0.5, 1.0] {
        let ended = come_back(
            &saved().calibration,
            |bench| {
                bench.twin.fault(StageFault::Vibration { um });
            },
            |_, _| {},
        );
        let message = &ended.outcome.message;
        match ended.outcome.verdict {
            Verdict::Arrived => {
                // How near it comes shakes as well.
                assert!(ended.outcome.limited_by.is_some(), "{um}: {message}");
                let claimed = ended.outcome.estimated_error_um.unwrap();
                assert!(
                    ended.off.0 <= 1.0 + claimed,
                    "{um}: {:?} {claimed} {} {message}",
                    ended.off,
                    ended.iterations
                );
            }
            _ => assert!(
                matches!(
                    ended.outcome.reason,
                    Reason::OutsideTolerance | Reason::IterationLimit | Reason::Drifting
                ),
                "{um}: {message}"
            ),
        }
    }
}

#[test]
fn a_focus_beyond_the_usual_range_is_looked_for_once_more() {
    for lower_um in [260.0, 330.0, 420.0] {
        let ended = come_back(
            &saved().calibration,
            |bench| {
                let at = bench.scope.gate().position().unwrap();
                let side = bench.scope.gate().info().positive_z;
                let z = side.away(at.si(Axis::Z).unwrap(), -lower_um * 1e-6);
                let to = StagePose {
                    z: Some(Length::from_m(z)),
                    ..StagePose::default()
                };
                bench.scope.move_to(&to).unwrap();
            },
            |_, _| {},
        );
        is_back(&ended);
        assert!(
            matches!(ended.attempts[..], [Attempt::FocusWidened { .. }]),
            "{lower_um}: {:?}",
            ended.attempts
        );
    }
}

#[test]
fn images_that_come_late_are_told_whether_the_focus_or_a_move_shows_it() {
    for frames in [1, 3, 5] {
        let ended = come_back(
            &saved().calibration,
            |bench| {
                bench.twin.fault(StageFault::StaleFrames(frames));
                // There are images from before.
                for _ in 0..2 * frames {
                    bench.scope.grab().unwrap();
                }
            },
            |_, _| {},
        );
        let why = match ended.outcome.magnifications.last().map(|m| &m.end) {
            Some(ServoEnd::Contradicted { why, .. }) => Some(*why),
            _ => None,
        };
        let late = ended.outcome.reason == Reason::StaleImages
            || why == Some(Contradiction::Late(frames as u8));
        assert!(late, "{frames}: {}", ended.outcome.message);
    }
}

//! One suite for every stage, camera and nosepiece: simulated, emulated or real.
//!
//! Each check returns a sentence on failure. Run it without a specimen that matters. It moves x and y by up to 2 mm, other
//! axes by up to 20 um or 0.01 rad, both ways, focus only away from the specimen and back, all inside the limits. A check that
//! fails stops the stage and goes back to where it began.

use crate::{
    Axis, AxisInfo, ErrorKind, Instrument, Motion, MotionGate, PositiveZ, ScopeError, StagePose,
};
use std::sync::Arc;
use std::time::Duration;

/// The result of one check.
#[derive(Debug, Clone, PartialEq)]
pub struct Check {
    /// What was checked.
    pub name: &'static str,
    /// `Ok`, or what did not hold.
    pub outcome: Result<(), String>,
}

/// Runs the whole suite on an instrument.
pub fn check_instrument(scope: &Instrument) -> Vec<Check> {
    let mut checks = check_stage(scope);
    checks.extend(check_camera(scope));
    checks.extend(check_together(scope));
    checks.extend(check_nosepiece(scope));
    checks
}

fn run(name: &'static str, check: impl FnOnce() -> Result<(), String>) -> Check {
    Check {
        name,
        outcome: check(),
    }
}

fn said(error: ScopeError) -> String {
    error.to_string()
}

fn ensure(holds: bool, sentence: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(sentence()) }
}

/// Runs a check that moves the stage; whatever comes of it, the stage is stopped and brought back.
fn run_and_return(
    scope: &Instrument,
    name: &'static str,
    check: impl FnOnce() -> Result<(), String>,
) -> Check {
    let home = scope.gate().position();
    let outcome = check();
    let back = || -> Result<(), ScopeError> {
        scope.gate().stop()?;
        // What was told to stop may take a moment to stand.
        scope.stand_still()?;
        scope.move_to(&home?)?;
        Ok(())
    };
    let outcome = match (outcome, back()) {
        (Ok(()), Err(error)) => Err(format!("the stage did not come back: {error}")),
        (outcome, _) => outcome,
    };
    Check { name, outcome }
}

/// x or y: the only axes that a long move is made along.
fn long_axis(stage: &MotionGate) -> Result<Axis, String> {
    [Axis::X, Axis::Y]
        .into_iter()
        .find(|a| stage.info().axis(*a).is_some())
        .ok_or_else(|| "the stage has neither x nor y".to_string())
}

/// Where the stage is on `axis`, and a place at most `cap` away: towards the farther end of the limits, but for focus
/// always away from the specimen.
fn towards_room(stage: &MotionGate, axis: Axis, cap: f64) -> Result<(f64, f64), String> {
    let here = stage
        .position()
        .map_err(said)?
        .si(axis)
        .ok_or_else(|| format!("position() does not report {axis}"))?;
    let range = stage
        .ranges()
        .iter()
        .find(|r| r.axis == axis)
        .ok_or_else(|| format!("{axis} has no limits"))?;
    let upwards = match axis {
        Axis::Z => stage.info().positive_z == PositiveZ::Apart,
        _ => range.max - here >= here - range.min,
    };
    let there = if upwards {
        here + cap.min(range.max - here)
    } else {
        here - cap.min(here - range.min)
    };
    Ok((here, there))
}

/// Where an axis is tried: as far as its trial goes to either side, where there is room, but for focus only away from the specimen.
fn tried_places(stage: &MotionGate, info: &AxisInfo) -> Result<(f64, Vec<f64>), String> {
    let (here, towards) = towards_room(stage, info.axis, trial(info.axis))?;
    let range = stage.ranges().iter().find(|r| r.axis == info.axis);
    let range = range.ok_or_else(|| format!("{} has no limits", info.axis))?;
    let other = (2.0 * here - towards).clamp(range.min, range.max);
    let both = match info.axis {
        Axis::Z => vec![towards],
        _ => vec![towards, other],
    };
    // What is nearer than this is the same place.
    let tells = |there: &f64| (there - here).abs() > 2.0 * info.tolerance();
    Ok((here, both.into_iter().filter(tells).collect()))
}

/// The trial move of an axis: 300 um in x and y, else 20 um or 0.01 rad.
fn trial(axis: Axis) -> f64 {
    match axis {
        Axis::X | Axis::Y => 300e-6,
        Axis::Z => 20e-6,
        Axis::Rx | Axis::Ry | Axis::Rz => 0.01,
    }
}

/// Whether no other axis went along with one that was moved.
fn alone(
    stage: &MotionGate,
    moved: Axis,
    before: &StagePose,
    after: &StagePose,
) -> Result<(), String> {
    for other in stage.info().axes.iter().filter(|i| i.axis != moved) {
        let axis = other.axis;
        let [from, to] = [before, after].map(|at| at.si(axis).unwrap_or(f64::NAN));
        ensure((to - from).abs() <= other.tolerance(), || {
            format!(
                "{moved} was moved, and {axis} went along from {:.2} to {:.2} {}",
                axis.to_display(from),
                axis.to_display(to),
                axis.display_unit()
            )
        })?;
    }
    Ok(())
}

/// A stage that goes on is seen after this time.
const STAYS: Duration = Duration::from_secs(1);

/// No picture is on its way for longer.
const LATEST: Duration = Duration::from_secs(3);

/// The longest move, of x or y: long enough to be stopped on the way.
const LONG_M: f64 = 2e-3;

/// Stage checks: read-back, limits, missing axes, numbers that are none, stop, refusal while moving, many threads.
pub fn check_stage(scope: &Instrument) -> Vec<Check> {
    let stage = scope.gate();
    vec![
        run_and_return(
            scope,
            "every axis moves to either side, reads back, and takes no other along",
            || {
                for info in &stage.info().axes {
                    let before = stage.position().map_err(said)?;
                    let (here, places) = tried_places(stage, info)?;
                    ensure(!places.is_empty(), || {
                        format!("{} has no room to be tried in", info.axis)
                    })?;
                    for place in places.into_iter().chain([here]) {
                        let to = StagePose::default().with_si(info.axis, place);
                        // Where it arrives is judged by the gate.
                        let at = scope.move_to(&to).map_err(said)?;
                        alone(stage, info.axis, &before, &at)?;
                    }
                }
                Ok(())
            },
        ),
        run_and_return(scope, "the stage stays where it arrived", || {
            let axis = long_axis(stage)?;
            let (_, there) = towards_room(stage, axis, trial(axis))?;
            let to = StagePose::default().with_si(axis, there);
            let arrived = scope.move_to(&to).map_err(said)?;
            scope.clock().sleep(STAYS);
            let later = stage.position().map_err(said)?;
            for info in &stage.info().axes {
                let moved = later.si(info.axis).zip(arrived.si(info.axis));
                let moved = moved.map_or(f64::NAN, |(a, b)| (a - b).abs());
                ensure(moved <= info.tolerance(), || {
                    format!(
                        "it said that it had settled, and {} went on by {:.2} {} in {} s",
                        info.axis,
                        info.axis.to_display(moved),
                        info.axis.display_unit(),
                        STAYS.as_secs_f64()
                    )
                })?;
            }
            Ok(())
        }),
        run("limits are refused and nothing moves", || {
            let before = stage.position().map_err(said)?;
            for range in stage.ranges().to_vec() {
                let span = (range.max - range.min).max(1e-6);
                for outside in [range.min - 0.01 * span, range.max + 0.01 * span] {
                    let to = StagePose::default().with_si(range.axis, outside);
                    let answer = stage.start_move(&to);
                    ensure(
                        matches!(answer, Err(ScopeError::OutsideLimits { .. })),
                        || format!("{} past its limit answered {answer:?}", range.axis),
                    )?;
                }
            }
            ensure(stage.position().map_err(said)? == before, || {
                "the stage moved".into()
            })
        }),
        run("missing axes and numbers that are none are refused", || {
            for axis in Axis::ALL {
                let to = StagePose::default().with_si(axis, f64::NAN);
                ensure(stage.start_move(&to).is_err(), || {
                    format!("{axis} accepted NaN")
                })?;
                if stage.info().axis(axis).is_none() {
                    let to = StagePose::default().with_si(axis, 0.0);
                    ensure(
                        stage.start_move(&to) == Err(ScopeError::NoSuchAxis { axis }),
                        || format!("{axis} is missing, yet a move was not refused"),
                    )?;
                }
            }
            Ok(())
        }),
        run_and_return(scope, "stop works from another thread while moving", || {
            let axis = long_axis(stage)?;
            let (_, there) = towards_room(stage, axis, LONG_M)?;
            stage
                .start_move(&StagePose::default().with_si(axis, there))
                .map_err(said)?;
            scope.clock().sleep(Duration::from_millis(20));
            let moving = stage.poll().map_err(said)?;
            std::thread::scope(|s| s.spawn(|| stage.stop()).join())
                .map_err(|_| "stop panicked".to_string())?
                .map_err(said)?;
            scope.clock().sleep(Duration::from_millis(50));
            let after = stage.poll().map_err(said)?;
            ensure(moving == Motion::Moving, || {
                format!("20 ms after the start of a long move it was {moving:?}")
            })?;
            ensure(after != Motion::Moving, || {
                "it still moves after stop".into()
            })?;
            let at = stage.position().map_err(said)?.si(axis);
            scope.clock().sleep(Duration::from_millis(200));
            let later = stage.position().map_err(said)?.si(axis);
            ensure(at == later, || format!("it crept from {at:?} to {later:?}"))?;
            ensure(at != Some(there), || {
                "it reached its goal despite stop".into()
            })
        }),
        run_and_return(scope, "a second move while moving is refused", || {
            let axis = long_axis(stage)?;
            let (here, there) = towards_room(stage, axis, LONG_M)?;
            let to = |place: f64| StagePose::default().with_si(axis, place);
            stage.start_move(&to(there)).map_err(said)?;
            let second = stage.start_move(&to(here));
            ensure(matches!(second, Err(ScopeError::Busy { .. })), || {
                format!("it answered {second:?}")
            })
        }),
        run("eight threads may ask at once", || {
            std::thread::scope(|s| {
                let asked: Vec<_> = (0..8)
                    .map(|_| {
                        s.spawn(|| -> Result<(), ScopeError> {
                            for _ in 0..50 {
                                stage.position()?;
                                stage.poll()?;
                            }
                            Ok(())
                        })
                    })
                    .collect();
                for thread in asked {
                    thread
                        .join()
                        .map_err(|_| "a thread panicked".to_string())?
                        .map_err(said)?;
                }
                Ok(())
            })
        }),
    ]
}

/// Camera checks: those of [`check_frames`], and that the exposure is honoured. Nothing moves.
pub fn check_camera(scope: &Instrument) -> Vec<Check> {
    let mut checks = check_frames(scope);
    checks.push(check_exposure(scope));
    checks
}

/// Frame shape and time stamps. Nothing moves and nothing is set.
pub fn check_frames(scope: &Instrument) -> Vec<Check> {
    let camera = scope.camera();
    vec![
        run("frames have the size they claim", || {
            let frame = scope.grab().map_err(said)?;
            let info = camera.info();
            let samples = match &frame.samples {
                crate::Samples::U8(s) => s.len(),
                crate::Samples::U16(s) => s.len(),
            };
            ensure(
                frame.width == info.width
                    && frame.height == info.height
                    && samples == info.width * info.height * info.channels.count(),
                || format!("{}x{} with {samples} samples", frame.width, frame.height),
            )
        }),
        run("a frame begins after it was asked for", || {
            let mut last = None;
            for _ in 0..3 {
                let asked = scope.clock().now();
                let frame = scope.grab().map_err(said)?;
                ensure(frame.exposure_start >= asked, || {
                    format!(
                        "exposed {} s before it was asked for",
                        asked.since(frame.exposure_start).as_secs_f64()
                    )
                })?;
                ensure(last < Some(frame.sequence), || {
                    "sequence numbers do not rise".into()
                })?;
                last = Some(frame.sequence);
            }
            Ok(())
        }),
    ]
}

/// The exposure is set for a moment, and set back whatever comes of it.
fn check_exposure(scope: &Instrument) -> Check {
    let camera = scope.camera();
    run(
        "exposure is honoured, and refused outside its range",
        || {
            let info = camera.info();
            let before = camera.exposure().map_err(said)?;
            let half = (before / 2).max(info.min_exposure);
            let tried = (|| -> Result<_, String> {
                let set = camera.set_exposure(half).map_err(said)?;
                let frame = scope.grab().map_err(said)?;
                let refused = camera.set_exposure(info.max_exposure * 2);
                Ok((set, frame.exposure, refused))
            })();
            camera.set_exposure(before).map_err(said)?;
            let (set, seen, refused) = tried?;
            ensure(seen == set, || {
                format!("set {set:?}, the frame says {seen:?}")
            })?;
            ensure(refused.is_err(), || "twice the longest was accepted".into())
        },
    )
}

/// Checks of stage and camera together: freshness after a move, grabbing during motion. Needs a specimen with structure.
pub fn check_together(scope: &Instrument) -> Vec<Check> {
    vec![
        run_and_return(scope, "a grab after a move shows the new place", || {
            let axis = long_axis(scope.gate())?;
            let (here, there) = towards_room(scope.gate(), axis, trial(axis))?;
            let to = |place: f64| StagePose::default().with_si(axis, place);
            let first = scope.grab().map_err(said)?;
            let same = scope.grab().map_err(said)?;
            scope.move_to(&to(there)).map_err(said)?;
            let moved = scope.grab().map_err(said)?;
            scope.move_to(&to(here)).map_err(said)?;
            let back = scope.grab().map_err(said)?;
            let (still, away) = (
                difference(&first, &same).max(difference(&first, &back)),
                difference(&first, &moved),
            );
            ensure(away > 1.5 * still, || {
                format!(
                    "pictures differ by {away:.4} after the move and by {still:.4} without it: is a specimen in, in focus?"
                )
            })
        }),
        run_and_return(
            scope,
            "a grab after a move shows where it ended, not the way",
            || {
                let axis = long_axis(scope.gate())?;
                let (_, there) = towards_room(scope.gate(), axis, trial(axis))?;
                let to = StagePose::default().with_si(axis, there);
                let before = scope.grab().map_err(said)?;
                scope.move_to(&to).map_err(said)?;
                let moved = scope.grab().map_err(said)?;
                // Whatever is on its way has come by then.
                scope.clock().sleep(LATEST);
                let later = scope.grab().map_err(said)?;
                let again = scope.grab().map_err(said)?;
                let (early, still) = (difference(&moved, &later), difference(&later, &again));
                let away = difference(&before, &later);
                ensure(away > 1.5 * still, || {
                    format!(
                        "there is too little to see ({away:.4} after the move, {still:.4} without it) to tell whether pictures are fresh: \
                     put in a specimen that does not matter, in focus"
                    )
                })?;
                ensure(early <= 2.0 * still + 1e-3, || {
                    format!(
                        "the picture after a move differs by {early:.4} from one {} s later, where two in a row differ by {still:.4}: \
                     pictures are older than the camera's driver takes them for, or the stage goes on after it said that it stands",
                        LATEST.as_secs_f64()
                    )
                })
            },
        ),
        run_and_return(scope, "frames can be grabbed during motion", || {
            let axis = long_axis(scope.gate())?;
            let (_, there) = towards_room(scope.gate(), axis, LONG_M)?;
            scope
                .gate()
                .start_move(&StagePose::default().with_si(axis, there))
                .map_err(said)?;
            scope.camera().grab().map(|_| ()).map_err(said)
        }),
    ]
}

/// Mean absolute difference of two frames' luminance.
fn difference(a: &crate::Frame, b: &crate::Frame) -> f64 {
    let (a, b) = (a.luminance(), b.luminance());
    let sum: f64 = a
        .iter()
        .zip(&b)
        .map(|(x, y)| f64::from((x - y).abs()))
        .sum();
    sum / a.len().max(1) as f64
}

/// A device that is gone says so within this time.
const GONE_WITHIN: Duration = Duration::from_secs(10);

/// The plug is pulled while the stage moves, and put back: every device says in time that it is gone, a new connection finds the
/// stage standing, or says that it moves until it stands, and drives it. `pull` ends the connection to the devices of `scope`;
/// `put_back` opens them anew. Needs x or y. Also returns the instrument that was opened anew.
pub fn check_replug(
    scope: Arc<Instrument>,
    pull: impl FnOnce(),
    put_back: impl FnOnce() -> Result<Arc<Instrument>, String>,
) -> (Vec<Check>, Option<Arc<Instrument>>) {
    let gone = run("unplugged on the way, every device says so in time", || {
        let gate = scope.gate();
        let axis = long_axis(gate)?;
        let (here, there) = towards_room(gate, axis, LONG_M)?;
        let to = |place: f64| StagePose::default().with_si(axis, place);
        gate.start_move(&to(there)).map_err(said)?;
        scope.clock().sleep(Duration::from_millis(20));
        pull();
        let says = |what: &str, call: &dyn Fn() -> Result<(), ScopeError>| {
            let asked = scope.clock().now();
            let answer = call();
            let took = scope.clock().now().since(asked);
            let fault = answer.as_ref().is_err_and(|e| e.kind() == ErrorKind::Fault);
            ensure(fault && took <= GONE_WITHIN, || {
                format!(
                    "{what} answered {answer:?} after {:.1} s",
                    took.as_secs_f64()
                )
            })
        };
        says("position", &|| gate.position().map(drop))?;
        says("poll", &|| gate.poll().map(drop))?;
        says("a move", &|| gate.start_move(&to(here)))?;
        if !gate.objectives().is_empty() {
            says("the nosepiece", &|| gate.poll_nosepiece().map(drop))?;
        }
        if scope.camera().info().width > 0 {
            says("the camera", &|| scope.camera().grab().map(drop))?;
        }
        Ok(())
    });
    drop(scope);
    let mut opened = None;
    let back = run("plugged in again, it stands and moves when told to", || {
        let scope = opened.insert(put_back()?);
        let gate = scope.gate();
        let asked = scope.clock().now();
        while gate.poll().map_err(said)? == Motion::Moving {
            scope.check_cancel().map_err(said)?;
            scope.clock().sleep(Duration::from_millis(10));
            let took = scope.clock().now().since(asked);
            ensure(took <= Duration::from_secs(60), || {
                "it says that it moves, a minute later still".into()
            })?;
        }
        let axis = long_axis(gate)?;
        let at = gate.position().map_err(said)?.si(axis);
        scope.clock().sleep(Duration::from_millis(200));
        let later = gate.position().map_err(said)?.si(axis);
        ensure(at == later, || {
            format!("it says that it stands, and went from {at:?} to {later:?}")
        })?;
        let (here, there) = towards_room(gate, axis, trial(axis))?;
        for place in [there, here] {
            let to = StagePose::default().with_si(axis, place);
            scope.move_to(&to).map_err(said)?;
        }
        Ok(())
    });
    (vec![gone, back], opened)
}

/// Nosepiece checks: every objective can be reached, unknown ones are refused.
pub fn check_nosepiece(scope: &Instrument) -> Vec<Check> {
    let gate = scope.gate();
    vec![
        run("every objective can be selected", || {
            let before = gate.current_objective().map_err(said)?;
            let home = gate.position().map_err(said)?;
            for objective in gate.objectives().to_vec() {
                scope.select_objective(&objective.id).map_err(said)?;
            }
            // Back to the height only with the objective that was there.
            if let Some(id) = before {
                scope.select_objective(&id).map_err(said)?;
                if gate.info().axis(Axis::Z).is_some() {
                    scope.move_to(&home).map_err(said)?;
                }
            }
            Ok(())
        }),
        run("an unknown objective is refused", || {
            let unknown = crate::ObjectiveId("no such objective".into());
            ensure(gate.start_change(&unknown).is_err(), || {
                "it was accepted".into()
            })
        }),
        run("magnifications and nominal scales are positive", || {
            for o in gate.objectives() {
                ensure(
                    o.magnification > 0.0
                        && o.nominal_um_per_px > 0.0
                        && o.numerical_aperture > 0.0,
                    || format!("{} states {o:?}", o.id),
                )?;
            }
            Ok(())
        }),
    ]
}

//! Checks of a stage, alone and asked by many.

use super::check::{Check, ensure, run, run_and_return, said};
use super::trial::{LONG_M, long_axis, towards_room, trial, tried_places};
use crate::{Axis, ErrorKind, Instrument, Motion, MotionGate, ScopeError, StagePose};
use std::time::Duration;

/// A stage that goes on is seen after this time.
const STAYS: Duration = Duration::from_secs(1);

/// A move that is asked to be slow should take so long, s.
const IN_S: f64 = 0.5;

/// Stage checks: read-back, limits, missing axes, numbers that are none, stop, refusal while moving, speeds, many threads.
pub fn check_stage(scope: &Instrument) -> Vec<Check> {
    let stage = scope.gate();
    vec![
        run_and_return(
            scope,
            "every axis moves to either side, reads back, and takes no other along",
            || every_axis(scope),
        ),
        run_and_return(scope, "the stage stays where it arrived", || stays(scope)),
        run("limits are refused and nothing moves", || limits(stage)),
        run("missing axes and numbers that are none are refused", || {
            no_goals(stage)
        }),
        run_and_return(scope, "stop works from another thread while moving", || {
            stop(scope)
        }),
        run_and_return(scope, "a second move while moving is refused", || {
            second_move(stage)
        }),
        check_speed(scope),
        run("eight threads may ask at once", || many_threads(stage)),
    ]
}

/// Whether a stage that knows speeds keeps one.
pub fn check_speed(scope: &Instrument) -> Check {
    let name = "a move is no faster than it was asked to be, where speeds are known";
    run_and_return(scope, name, || keeps_its_speed(scope))
}

fn every_axis(scope: &Instrument) -> Result<(), String> {
    let stage = scope.gate();
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

fn stays(scope: &Instrument) -> Result<(), String> {
    let stage = scope.gate();
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
}

fn limits(stage: &MotionGate) -> Result<(), String> {
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
}

fn no_goals(stage: &MotionGate) -> Result<(), String> {
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
}

fn stop(scope: &Instrument) -> Result<(), String> {
    let stage = scope.gate();
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
}

fn second_move(stage: &MotionGate) -> Result<(), String> {
    let axis = long_axis(stage)?;
    let (here, there) = towards_room(stage, axis, LONG_M)?;
    let to = |place: f64| StagePose::default().with_si(axis, place);
    stage.start_move(&to(there)).map_err(said)?;
    let second = stage.start_move(&to(here));
    ensure(matches!(second, Err(ScopeError::Busy { .. })), || {
        format!("it answered {second:?}")
    })
}

/// A short move that is asked to take half a second does not take much less; a stage that refuses has one speed.
fn keeps_its_speed(scope: &Instrument) -> Result<(), String> {
    let stage = scope.gate();
    let z = stage.info().axis(Axis::Z).map(|z| z.axis);
    let Some(axis) = z.or(long_axis(stage).ok()).filter(|_| stage.knows_speeds()) else {
        return Ok(());
    };
    let (here, there) = towards_room(stage, axis, trial(axis))?;
    let m_per_s = (there - here).abs() / IN_S;
    let to = StagePose::default().with_si(axis, there);
    let began = scope.clock().now().seconds();
    let ended = scope.move_looking(&to, m_per_s, || Ok::<(), ScopeError>(()));
    let took = scope.clock().now().seconds() - began;
    match ended {
        Err(error) if error.kind() == ErrorKind::Refused => Ok(()),
        Err(error) => Err(said(error)),
        Ok(_) => ensure(took >= 0.8 * IN_S, || {
            format!(
                "{axis} was asked to go {:.0} um at {:.0} um/s and took {took:.2} s: it does not keep the speed that it says it knows",
                (there - here).abs() * 1e6,
                m_per_s * 1e6
            )
        }),
    }
}

fn many_threads(stage: &MotionGate) -> Result<(), String> {
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
}

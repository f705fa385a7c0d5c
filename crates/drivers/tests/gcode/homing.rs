//! Homing: asked for, stopped, given up.

use crate::board::{plain, start};
use crate::common::{detail, pose, wait};
use scopeservo_scope::{Axis, Motion, ScopeError, Stage};
use std::time::{Duration, Instant};

#[test]
fn a_stage_that_needs_homing_says_so_and_homes_only_when_told() {
    let (emulator, stage) = start(|b| b.homes_first = true, |s| s.needs_homing = true);
    let stage = stage.unwrap();
    assert!(!stage.is_homed().unwrap());
    for refused in [
        stage.start_move(&pose(Axis::X, 1e-3)),
        stage.position().map(drop),
    ] {
        assert_eq!(refused, Err(ScopeError::NotHomed { device: "stage" }));
    }
    assert!(!emulator.heard().iter().any(|l| l.starts_with("G28")));
    stage.start_homing().unwrap();
    assert_eq!(stage.poll().unwrap(), Motion::Moving);
    assert!(!stage.was_homed().unwrap());
    for busy in [
        stage.start_move(&pose(Axis::X, 1e-3)),
        stage.position().map(|_| ()),
        stage.start_homing(),
    ] {
        assert_eq!(busy, Err(ScopeError::Busy { device: "stage" }));
    }
    assert_eq!(wait(&stage), Motion::Settled);
    assert!(stage.was_homed().unwrap() && stage.is_homed().unwrap());
    assert_eq!(emulator.heard().last().unwrap(), "G28 X Y Z");
    stage.start_move(&pose(Axis::X, 1e-3)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
}

#[test]
fn homing_can_be_stopped() {
    let (_emulator, stage) = start(|b| b.homing_ms = 5000, |_| {});
    let stage = stage.unwrap();
    stage.start_homing().unwrap();
    assert_eq!(stage.poll().unwrap(), Motion::Moving);
    // It would be homed if the stop had waited for that.
    stage.stop().unwrap();
    assert_eq!(stage.poll().unwrap(), Motion::Stopped);
    assert!(!stage.was_homed().unwrap());
    stage.start_move(&pose(Axis::X, 1e-3)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
}

#[test]
fn homing_that_never_ends_is_given_up() {
    let (_emulator, stage) = start(|b| b.homing_ms = 60_000, |s| s.homing_timeout_ms = 200);
    let stage = stage.unwrap();
    stage.start_homing().unwrap();
    let start = Instant::now();
    let error = loop {
        match stage.poll() {
            Ok(motion) => assert_eq!(motion, Motion::Moving),
            Err(error) => break error,
        }
        assert!(start.elapsed() < Duration::from_secs(60));
    };
    assert!(matches!(error, ScopeError::Timeout { .. }), "{error:?}");
}

#[test]
fn a_command_to_home_that_arrives_damaged_is_told_and_can_be_repeated() {
    let (_emulator, stage) = plain();
    _emulator.damage_lines(1);
    stage.start_homing().unwrap();
    let start = Instant::now();
    let why = loop {
        match stage.poll() {
            Ok(_) => assert!(start.elapsed() < Duration::from_secs(60)),
            Err(error) => break detail(error),
        }
    };
    assert!(why.contains("damaged"), "{why}");
    stage.start_homing().unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
    assert!(stage.was_homed().unwrap() && stage.is_homed().unwrap());
}

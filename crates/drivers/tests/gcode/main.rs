//! The G-code driver against the emulated board, over TCP.

mod board;
#[path = "../common/mod.rs"]
mod common;
mod homing;
mod line;

use board::{connect, plain, settings, start};
use common::{Bench, detail, is_device, link_faults, pose, wait};
use scopeservo_drivers::emulator::Fault;
use scopeservo_drivers::emulator::gcode::{Board, EmulatedBoard, GcodeEmulator};
use scopeservo_drivers::gcode::GcodeStage;
use scopeservo_scope::{Axis, Motion, ScopeError, Stage};
use std::thread;
use std::time::{Duration, Instant};

fn bench() -> Bench<Board, GcodeStage> {
    let (emulator, stage) = plain();
    Bench {
        emulator,
        stage,
        truth: |e| e.truth().map(|mm| mm * 1e-3).into(),
        far: 40e-3,
    }
}

#[test]
fn axes_move_and_read_back_in_steps() {
    for checksums in [true, false] {
        let (emulator, stage) = start(|_| {}, |s| s.checksums = checksums);
        let stage = stage.unwrap();
        assert!(stage.info().name.contains("Marlin"));
        let to = pose(Axis::X, 1e-3)
            .with_si(Axis::Y, -0.5e-3)
            .with_si(Axis::Z, 0.25e-3);
        stage.start_move(&to).unwrap();
        assert_eq!(stage.poll().unwrap(), Motion::Moving);
        assert_eq!(wait(&stage), Motion::Settled);
        let at = stage.position().unwrap();
        for axis in [Axis::X, Axis::Y, Axis::Z] {
            let off = (at.si(axis).unwrap() - to.si(axis).unwrap()).abs();
            assert!(off <= 2.5e-6 + 1e-12, "{axis}: {off}");
        }
        assert_eq!(at.si(Axis::Rz), None);
        assert_eq!(emulator.truth(), [1.0, -0.5, 0.25]);
    }
}

#[test]
fn a_slow_move_goes_at_its_own_feed_and_never_above_the_usual_one() {
    let (emulator, stage) = plain();
    // 10 mm/s is the usual speed.
    for (um, m_per_s, feed) in [
        (20.0, 1e-3, "F60.00"),
        (40.0, 2.5e-4, "F15.00"),
        (60.0, 0.5, "F600.00"),
    ] {
        let to = pose(Axis::Z, um * 1e-6);
        stage.start_move_at(&to, m_per_s).unwrap();
        assert_eq!(wait(&stage), Motion::Settled);
        let heard = emulator.heard();
        let go = heard.iter().rfind(|line| line.contains("G1 ")).unwrap();
        assert!(go.contains(feed), "{go}");
        assert_eq!(emulator.truth()[2], um * 1e-3);
    }
    for m_per_s in [0.0, -1e-3, f64::NAN, f64::INFINITY] {
        let sent = emulator.heard().len();
        assert!(stage.start_move_at(&pose(Axis::Z, 0.0), m_per_s).is_err());
        assert_eq!(emulator.heard().len(), sent);
    }
}

#[test]
fn positions_are_those_of_the_steppers_also_during_motion() {
    let (emulator, stage) = plain();
    stage.start_move(&pose(Axis::X, 20e-3)).unwrap();
    thread::sleep(Duration::from_millis(50));
    let before = emulator.truth()[0];
    let at = 1e3 * stage.position().unwrap().si(Axis::X).unwrap();
    let after = emulator.truth()[0];
    let step = 1.0 / 400.0;
    assert!(
        before - step <= at && at <= after + step,
        "{before} {at} {after}"
    );
    stage.stop().unwrap();
}

#[test]
fn connecting_moves_nothing() {
    let (emulator, stage) = plain();
    let heard = emulator.heard();
    assert_eq!(heard, ["M110 N0", "M115", "M410", "G21", "G90", "M114"]);
    drop(stage);
}

#[test]
fn limits_and_missing_axes_are_refused_and_nothing_is_sent() {
    let (emulator, stage) = plain();
    let before = emulator.heard().len();
    for axis in [Axis::X, Axis::Y, Axis::Z] {
        for outside in [-0.0501, 0.0501] {
            assert!(matches!(
                stage.start_move(&pose(axis, outside)),
                Err(ScopeError::OutsideLimits { .. })
            ));
        }
        assert_eq!(
            stage.start_move(&pose(axis, f64::INFINITY)),
            Err(ScopeError::NotFinite { axis })
        );
    }
    assert_eq!(
        stage.start_move(&pose(Axis::Rz, 0.0)),
        Err(ScopeError::NoSuchAxis { axis: Axis::Rz })
    );
    assert_eq!(emulator.heard().len(), before);
}

#[test]
fn a_move_that_the_board_would_clip_is_stopped_and_told() {
    let (emulator, stage) = start(|b| b.limits_mm[0] = (-5.0, 5.0), |_| {});
    let stage = stage.unwrap();
    let why = detail(stage.start_move(&pose(Axis::X, 20e-3)).unwrap_err());
    assert!(why.contains("shortened"), "{why}");
    assert!(emulator.truth()[0] < 4.0);
    assert_eq!(stage.poll().unwrap(), Motion::Stopped);
}

#[test]
fn a_second_move_is_refused_while_one_runs() {
    let (_emulator, stage) = plain();
    stage.start_move(&pose(Axis::X, 10e-3)).unwrap();
    assert_eq!(
        stage.start_move(&pose(Axis::X, 0.0)),
        Err(ScopeError::Busy { device: "stage" })
    );
    stage.stop().unwrap();
    assert_eq!(stage.poll().unwrap(), Motion::Stopped);
    stage.start_move(&pose(Axis::X, 0.0)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
}

#[test]
fn stops_from_many_threads_do_not_mix_up_the_answers() {
    let (_emulator, stage) = plain();
    stage.start_move(&pose(Axis::X, 40e-3)).unwrap();
    thread::scope(|s| {
        for i in 0..8 {
            let stage = &stage;
            s.spawn(move || {
                for _ in 0..15 {
                    let at = stage.position().unwrap().si(Axis::X).unwrap();
                    assert!((0.0..40e-3).contains(&at));
                    if i % 2 == 0 {
                        stage.stop().unwrap();
                    }
                }
            });
        }
    });
    assert_eq!(stage.poll().unwrap(), Motion::Stopped);
}

#[test]
fn a_board_that_refuses_a_move_is_heard() {
    let (emulator, stage) = start(|b| b.homes_first = true, |_| {});
    let stage = stage.unwrap();
    assert_eq!(
        stage.start_move(&pose(Axis::X, 1e-3)),
        Err(ScopeError::NotHomed { device: "stage" })
    );
    assert_eq!(stage.poll().unwrap(), Motion::Settled);
    assert_eq!(emulator.truth(), [0.0; 3]);
}

#[test]
fn a_board_that_starts_anew_has_lost_its_place() {
    let (emulator, stage) = plain();
    emulator.say("start");
    thread::sleep(Duration::from_millis(20));
    let why = detail(stage.position().unwrap_err());
    assert!(why.contains("started anew"), "{why}");
    assert!(detail(stage.poll().unwrap_err()).contains("closed because"));
}

#[test]
fn a_fault_of_the_board_is_told_in_its_words() {
    let (emulator, stage) = plain();
    emulator.say("Error:Printer halted. kill() called!");
    thread::sleep(Duration::from_millis(20));
    let why = detail(stage.position().unwrap_err());
    assert!(why.contains("Printer halted"), "{why}");
}

#[test]
fn an_obstacle_ends_the_move() {
    let (emulator, stage) = plain();
    stage.start_move(&pose(Axis::X, 20e-3)).unwrap();
    emulator.block();
    assert_eq!(wait(&stage), Motion::Stopped);
}

#[test]
fn a_stop_that_is_ignored_is_told() {
    let (emulator, stage) = plain();
    stage.start_move(&pose(Axis::X, 40e-3)).unwrap();
    emulator.ignore_stops();
    let why = detail(stage.stop().unwrap_err());
    assert!(why.contains("emergency"), "{why}");
}

#[test]
fn a_board_that_cannot_stop_at_any_time_is_not_driven_unless_allowed() {
    let (_emulator, stage) = start(|b| b.emergency_parser = false, |_| {});
    let why = detail(stage.err().unwrap());
    assert!(why.contains("EMERGENCY_PARSER"), "{why}");

    let (_emulator, stage) = start(
        |b| b.emergency_parser = false,
        |s| s.allow_queued_stop = true,
    );
    let stage = stage.unwrap();
    stage.start_move(&pose(Axis::X, 20e-3)).unwrap();
    stage.stop().unwrap();
    assert_eq!(stage.poll().unwrap(), Motion::Stopped);

    let (_emulator, stage) = start(|b| b.knows_stop = false, |_| {});
    let why = detail(stage.err().unwrap());
    assert!(why.contains("M410"), "{why}");
}

#[test]
fn firmware_that_answers_only_after_the_move_is_waited_for() {
    let (_emulator, stage) = start(|b| b.position_waits = true, |_| {});
    let stage = stage.unwrap();
    // Longer than the time-out of one answer: the signs of being busy count.
    stage.start_move(&pose(Axis::X, 6e-3)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
}

#[test]
fn settings_that_do_not_fit_the_board_are_told() {
    let (emulator, stage) = start(|b| b.steps_per_mm = [80.0; 3], |_| {});
    // At zero they agree, whatever they are.
    let stage = stage.unwrap();
    stage.start_move(&pose(Axis::X, 2e-3)).unwrap();
    assert_eq!(wait(&stage), Motion::Stopped);
    drop(stage);
    let error = connect(&emulator, &settings()).err().unwrap();
    assert!(
        matches!(&error, ScopeError::BadSetting { what } if what.contains("steps_per_mm")),
        "{error:?}"
    );
}

#[test]
fn a_board_that_starts_when_the_port_is_opened_is_waited_for() {
    let emulator = GcodeEmulator::serve(EmulatedBoard::new()).unwrap();
    let mut settings = settings();
    settings.boot_ms = 3000;
    thread::scope(|s| {
        s.spawn(|| {
            thread::sleep(Duration::from_millis(200));
            for line in ["start", "echo:Marlin 2.1", "echo: Free Memory: 3596"] {
                emulator.say(line);
                thread::sleep(Duration::from_millis(20));
            }
        });
        let start = Instant::now();
        let stage = connect(&emulator, &settings).unwrap();
        assert!(start.elapsed() > Duration::from_millis(200));
        assert_eq!(stage.poll().unwrap(), Motion::Settled);
    });
}

link_faults! {
    own: GcodeStage::start_homing,
    silence: |e| matches!(e, ScopeError::Timeout { .. }),
    slow_bytes_ms: 20,
    longest_line: 1024,
    endless: (|_| true, ""),
    after_stops: |stage: &GcodeStage| {
        stage.start_move(&pose(Axis::X, 0.0)).unwrap();
        assert_eq!(wait(stage), Motion::Settled);
    },
}

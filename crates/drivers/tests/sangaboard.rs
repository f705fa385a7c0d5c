//! The Sangaboard driver against the emulated board, over TCP.

mod common;

use common::{Bench, detail, is_device, link_faults, pose, tcp, wait};
use scopeservo_drivers::emulator::Fault;
use scopeservo_drivers::emulator::sangaboard::{EmulatedSanga, Sanga, SangaEmulator};
use scopeservo_drivers::sangaboard::{SangaAxis, SangaSettings, SangaStage};
use scopeservo_scope::{Axis, Kinematics, Motion, PositiveZ, ScopeError, Stage};
use std::thread;
use std::time::{Duration, Instant};

fn settings() -> SangaSettings {
    let axis = |um_per_step| SangaAxis {
        um_per_step,
        min_um: -2000.0,
        max_um: 2000.0,
        repeatability_um: 0.2,
        arrival_tolerance_um: None,
    };
    SangaSettings {
        kinematics: Kinematics::SpecimenXyOnTop,
        positive_z: PositiveZ::Closer,
        x: Some(axis(0.1)),
        y: Some(axis(-0.1)),
        z: Some(axis(0.05)),
        boot_ms: 0,
        reply_timeout_ms: 300,
        stop_timeout_ms: 200,
    }
}

fn connect(emulator: &SangaEmulator, settings: &SangaSettings) -> Result<SangaStage, ScopeError> {
    SangaStage::connect(tcp(&emulator.address()), settings)
}

fn start_with(
    change: impl FnOnce(&mut EmulatedSanga),
) -> (SangaEmulator, Result<SangaStage, ScopeError>) {
    let mut board = EmulatedSanga::new();
    change(&mut board);
    let emulator = SangaEmulator::serve(board).unwrap();
    let stage = connect(&emulator, &settings());
    (emulator, stage)
}

fn start() -> (SangaEmulator, SangaStage) {
    let (emulator, stage) = start_with(|_| {});
    (emulator, stage.unwrap())
}

fn bench() -> Bench<Sanga, SangaStage> {
    let (emulator, stage) = start();
    Bench {
        emulator,
        stage,
        truth: |e| e.truth().map(|steps| f64::from(steps) * 1e-7).into(),
        far: 2e-3,
    }
}

#[test]
fn axes_go_to_absolute_places_from_wherever_they_are() {
    let (emulator, stage) = start_with(|b| b.at_steps = [70, -30, 500]);
    let stage = stage.unwrap();
    let at = stage.position().unwrap();
    assert!((at.si(Axis::X).unwrap() - 7e-6).abs() < 1e-12);
    assert!(
        (at.si(Axis::Y).unwrap() - 3e-6).abs() < 1e-12,
        "turned round"
    );
    stage
        .start_move(&pose(Axis::X, 20e-6).with_si(Axis::Y, 30e-6))
        .unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
    assert_eq!(emulator.truth(), [200, -300, 500]);
    stage.start_move(&pose(Axis::Z, -10e-6)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
    assert_eq!(emulator.truth(), [200, -300, -200]);
    let at = stage.position().unwrap();
    assert!((at.si(Axis::Z).unwrap() + 10e-6).abs() < 1e-12);
    assert_eq!(at.si(Axis::Rz), None);
}

#[test]
fn connecting_moves_nothing() {
    let (emulator, stage) = start();
    let heard = emulator.heard();
    let want = [
        "version",
        "blocking_moves?",
        "stop",
        "blocking_moves false",
        "p?",
    ];
    assert_eq!(heard, want);
    assert_eq!(emulator.truth(), [0; 3]);
    drop(stage);
    // The board has kept the setting; it is not written again.
    let _again = connect(&emulator, &settings()).unwrap();
    let heard = emulator.heard();
    let written = heard.iter().filter(|l| *l == "blocking_moves false");
    assert_eq!(written.count(), 1);
}

#[test]
fn firmware_that_cannot_stop_is_refused() {
    let (_emulator, stage) = start_with(|b| b.knows_stop = false);
    let why = detail(stage.err().unwrap());
    assert!(why.contains("not even a stop"), "{why}");
}

#[test]
fn limits_and_missing_axes_are_refused_and_nothing_is_sent() {
    let emulator = SangaEmulator::serve(EmulatedSanga::new()).unwrap();
    let mut settings = settings();
    settings.y = None;
    let stage = connect(&emulator, &settings).unwrap();
    let before = emulator.heard().len();
    for outside in [-2001e-6, 2001e-6] {
        assert!(matches!(
            stage.start_move(&pose(Axis::X, outside)),
            Err(ScopeError::OutsideLimits { .. })
        ));
    }
    for axis in [Axis::Y, Axis::Rx, Axis::Rz] {
        assert_eq!(
            stage.start_move(&pose(axis, 0.0)),
            Err(ScopeError::NoSuchAxis { axis })
        );
    }
    assert_eq!(
        stage.start_move(&pose(Axis::Z, f64::NAN)),
        Err(ScopeError::NotFinite { axis: Axis::Z })
    );
    assert_eq!(emulator.heard().len(), before);
    assert_eq!(stage.position().unwrap().si(Axis::Y), None);
}

#[test]
fn a_second_move_is_refused_while_one_runs() {
    let (_emulator, stage) = start();
    stage.start_move(&pose(Axis::X, 1000e-6)).unwrap();
    let busy = Err(ScopeError::Busy { device: "stage" });
    assert_eq!(stage.start_move(&pose(Axis::X, 0.0)), busy);
    assert_eq!(stage.release(), busy);
    stage.stop().unwrap();
    assert_eq!(stage.poll().unwrap(), Motion::Stopped);
    stage.release().unwrap();
    stage.start_move(&pose(Axis::X, 0.0)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
}

#[test]
fn stops_from_many_threads_do_not_mix_up_the_answers() {
    let (_emulator, stage) = start();
    stage.start_move(&pose(Axis::X, 2000e-6)).unwrap();
    thread::scope(|s| {
        for i in 0..8 {
            let stage = &stage;
            s.spawn(move || {
                for _ in 0..30 {
                    let at = stage.position().unwrap().si(Axis::X).unwrap();
                    assert!((0.0..2e-3).contains(&at));
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
fn a_move_that_ends_early_is_not_taken_for_an_arrival() {
    let (emulator, stage) = start();
    stage.start_move(&pose(Axis::X, 1000e-6)).unwrap();
    emulator.block();
    assert_eq!(wait(&stage), Motion::Stopped);
}

#[test]
fn a_stop_that_is_ignored_is_told() {
    let (emulator, stage) = start();
    stage.start_move(&pose(Axis::X, 2000e-6)).unwrap();
    emulator.ignore_stops();
    let why = detail(stage.stop().unwrap_err());
    assert!(why.contains("emergency"), "{why}");
}

#[test]
fn a_board_that_starts_when_the_port_is_opened_is_waited_for() {
    let mut board = EmulatedSanga::new();
    board.greets_after_ms = Some(200);
    let emulator = SangaEmulator::serve(board).unwrap();
    let mut settings = settings();
    settings.boot_ms = 30_000;
    let start = Instant::now();
    let stage = connect(&emulator, &settings).unwrap();
    let took = start.elapsed();
    // Not before, and not only when its start was given up.
    assert!(took > Duration::from_millis(150) && took < Duration::from_millis(settings.boot_ms));
    stage.start_move(&pose(Axis::X, 1e-6)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
}

link_faults! {
    own: SangaStage::release,
    silence: |e| matches!(e, ScopeError::Timeout { .. }),
    slow_bytes_ms: 100,
    longest_line: 256,
    endless: (is_device, "an answer could not be"),
    after_stops: |stage: &SangaStage| {
        stage.start_move(&pose(Axis::X, 0.0)).unwrap();
        assert_eq!(wait(stage), Motion::Settled);
    },
}

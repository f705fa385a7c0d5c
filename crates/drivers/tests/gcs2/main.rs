//! The GCS 2 driver against the emulated controller, over TCP.

#[path = "../common/mod.rs"]
mod common;
mod controller;
mod stops;
mod units;

use common::{Bench, detail, is_device, link_faults, pose, refusal, wait};
use controller::{connect, hexapod, hexapod_with, settings};
use scopeservo_drivers::emulator::Fault;
use scopeservo_drivers::emulator::gcs2::{Controller, EmulatedAxis, EmulatedStage, Gcs2Emulator};
use scopeservo_drivers::gcs2::{Gcs2Stage, LinearAxis};
use scopeservo_scope::{Axis, Length, Motion, ScopeError, Stage, StagePose};
use std::thread;
use std::time::Duration;

fn bench() -> Bench<Controller, Gcs2Stage> {
    let (emulator, stage) = hexapod();
    Bench {
        emulator,
        stage,
        truth: |e| e.truth().iter().map(|mm| mm * 1e-3).collect(),
        far: 20e-3,
    }
}

#[test]
fn every_axis_of_a_hexapod_moves_and_reads_back() {
    let (emulator, stage) = hexapod();
    assert!(stage.info().name.contains("C-887"));
    assert_eq!(stage.info().axes.len(), 6);
    for (i, axis) in Axis::ALL.into_iter().enumerate() {
        let to = if axis.is_rotation() { 0.01 } else { 300e-6 };
        stage.start_move(&pose(axis, to)).unwrap();
        assert_eq!(wait(&stage), Motion::Settled);
        let at = stage.position().unwrap();
        assert!((at.si(axis).unwrap() - to).abs() < 2e-8, "{axis} {at:?}");
        // The truth counts in mm and deg.
        let truth = emulator.truth()[i];
        let want = if axis.is_rotation() {
            to.to_degrees()
        } else {
            to * 1e3
        };
        assert!((truth - want).abs() < 2e-6, "{axis}: {truth} for {want}");
    }
}

#[test]
fn all_axes_move_together() {
    let (_emulator, stage) = hexapod();
    let to = Axis::ALL.into_iter().fold(StagePose::default(), |p, a| {
        p.with_si(a, if a.is_rotation() { 0.005 } else { -200e-6 })
    });
    stage.start_move(&to).unwrap();
    assert_eq!(stage.poll().unwrap(), Motion::Moving);
    assert_eq!(wait(&stage), Motion::Settled);
    let at = stage.position().unwrap();
    for axis in Axis::ALL {
        assert!((at.si(axis).unwrap() - to.si(axis).unwrap()).abs() < 2e-8);
    }
}

#[test]
fn axes_of_their_own_are_driven_by_their_names() {
    let axis = |name: &str| EmulatedAxis {
        name: name.into(),
        low: 0.0,
        high: 50.0,
        unit: b"mm".to_vec(),
    };
    let emulator = Gcs2Emulator::serve(EmulatedStage {
        axes: vec![axis("1"), axis("2")],
        coupled: false,
        velocity: 10.0,
        referenced: true,
        reference_ms: 50,
        unknown: Vec::new(),
    })
    .unwrap();
    let linear = |axis, name: &str| LinearAxis {
        axis,
        name: name.into(),
        repeatability_um: 0.2,
        arrival_tolerance_um: 1.0,
    };
    let mut settings = settings();
    settings.rotary.clear();
    settings.coupled = false;
    // Their order in the settings is ours, not the controller's.
    settings.linear = vec![linear(Axis::X, "2"), linear(Axis::Y, "1")];
    let stage = connect(&emulator, &settings).unwrap();
    stage
        .start_move(&pose(Axis::X, 0.5e-3).with_si(Axis::Y, 0.25e-3))
        .unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
    let truth = emulator.truth();
    assert!((truth[0] - 0.25).abs() < 1e-9 && (truth[1] - 0.5).abs() < 1e-9);
    assert_eq!(
        stage.start_move(&pose(Axis::Z, 0.0)),
        Err(ScopeError::NoSuchAxis { axis: Axis::Z })
    );
    stage.set_velocity_si(Axis::X, 5e-3).unwrap();
    assert!((stage.velocity_si(Axis::X).unwrap() - 5e-3).abs() < 1e-12);
    assert!((stage.velocity_si(Axis::Y).unwrap() - 10e-3).abs() < 1e-12);
    let why = refusal(stage.set_velocity_si(Axis::X, 1.0).unwrap_err());
    assert!(why.contains("velocity is out of limits"), "{why}");
}

#[test]
fn connecting_moves_nothing_and_sets_nothing() {
    let (emulator, stage) = hexapod_with(|s| s.referenced = false);
    let heard = emulator.heard();
    assert!(heard.len() >= 5, "{heard:?}");
    for line in &heard {
        assert!(line.contains('?'), "{heard:?}");
    }
    drop(stage);
    thread::sleep(Duration::from_millis(20));
    assert_eq!(emulator.heard(), heard);
}

#[test]
fn an_axis_that_the_controller_lacks_is_told() {
    let emulator = Gcs2Emulator::serve(EmulatedStage::hexapod()).unwrap();
    let mut settings = settings();
    settings.linear[0].name = "A".into();
    let error = connect(&emulator, &settings).err().unwrap();
    assert!(
        matches!(&error, ScopeError::BadSetting { what } if what.contains("no axis A")),
        "{error:?}"
    );
}

#[test]
fn limits_are_refused_and_nothing_is_sent() {
    let (emulator, stage) = hexapod();
    let before = emulator.heard().len();
    for axis in Axis::ALL {
        let range = *stage.info().axis(axis).unwrap();
        for outside in [1.001 * range.min, 1.001 * range.max] {
            let answer = stage.start_move(&pose(axis, outside));
            assert!(
                matches!(answer, Err(ScopeError::OutsideLimits { .. })),
                "{answer:?}"
            );
        }
        assert_eq!(
            stage.start_move(&pose(axis, f64::NAN)),
            Err(ScopeError::NotFinite { axis })
        );
    }
    assert_eq!(emulator.heard().len(), before);
    // The end itself is allowed.
    let end = stage.info().axis(Axis::X).unwrap().max;
    stage.start_move(&pose(Axis::X, end)).unwrap();
    stage.stop().unwrap();
}

#[test]
fn a_coupled_pose_out_of_reach_is_refused_before_it_is_sent() {
    let (emulator, stage) = hexapod();
    let to = pose(Axis::X, 20e-3).with_si(Axis::Y, 20e-3);
    let why = refusal(stage.start_move(&to).unwrap_err());
    assert!(why.contains("cannot be reached"), "{why}");
    assert!(!emulator.heard().iter().any(|l| l.starts_with("MOV")));
    assert_eq!(emulator.truth(), [0.0; 6]);
    // Each alone is possible.
    stage.start_move(&pose(Axis::X, 20e-3)).unwrap();
    stage.stop().unwrap();
}

#[test]
fn a_pose_that_the_controller_itself_refuses_is_told_in_words() {
    let emulator = Gcs2Emulator::serve(EmulatedStage::hexapod()).unwrap();
    let mut settings = settings();
    settings.coupled = false;
    let stage = connect(&emulator, &settings).unwrap();
    let to = pose(Axis::X, 20e-3).with_si(Axis::Y, 20e-3);
    let why = refusal(stage.start_move(&to).unwrap_err());
    assert!(why.contains("error 7") && why.contains("limits"), "{why}");
    assert_eq!(stage.poll().unwrap(), Motion::Settled);
    assert_eq!(emulator.truth(), [0.0; 6]);
}

#[test]
fn other_error_numbers_are_told_with_the_number() {
    let (emulator, stage) = hexapod();
    // What the controller cannot read is a fault, what it will not do a refusal.
    type Words = fn(ScopeError) -> String;
    let each: [(i32, Words); 4] = [(1, detail), (8, refusal), (17, refusal), (815, detail)];
    for (number, words) in each {
        emulator.set_error(number);
        let why = words(stage.set_platform_velocity_um_per_s(1000.0).unwrap_err());
        assert!(why.contains(&format!("error {number}:")), "{why}");
        // Reading it has cleared it.
        stage.set_platform_velocity_um_per_s(1000.0).unwrap();
    }
    emulator.set_error(5);
    assert_eq!(
        stage.set_platform_velocity_um_per_s(1000.0),
        Err(ScopeError::NotHomed { device: "stage" })
    );
}

#[test]
fn a_second_move_is_refused_while_one_runs() {
    let (_emulator, stage) = hexapod();
    stage.start_move(&pose(Axis::X, 10e-3)).unwrap();
    for to in [0.0, 10e-3] {
        assert_eq!(
            stage.start_move(&pose(Axis::X, to)),
            Err(ScopeError::Busy { device: "stage" })
        );
    }
    assert_eq!(
        stage.start_homing(),
        Err(ScopeError::Busy { device: "stage" })
    );
    stage.stop().unwrap();
    assert_eq!(stage.poll().unwrap(), Motion::Stopped);
    stage.start_move(&pose(Axis::X, 0.0)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
}

#[test]
fn a_stage_that_is_not_homed_says_so_and_moves_only_when_told_to_home() {
    let (emulator, stage) = hexapod_with(|s| s.referenced = false);
    assert!(!stage.is_homed().unwrap());
    for refused in [
        stage.start_move(&pose(Axis::X, 1e-3)),
        stage.position().map(drop),
    ] {
        assert_eq!(refused, Err(ScopeError::NotHomed { device: "stage" }));
    }
    let moves = |l: &String| l.starts_with("FRF ") || l.starts_with("MOV");
    assert!(!emulator.heard().iter().any(moves));
    stage.start_homing().unwrap();
    assert_eq!(stage.poll().unwrap(), Motion::Moving);
    assert!(!stage.is_homed().unwrap());
    for busy in [
        stage.start_move(&pose(Axis::X, 1e-3)),
        stage.position().map(|_| ()),
        stage.start_homing(),
    ] {
        assert_eq!(busy, Err(ScopeError::Busy { device: "stage" }));
    }
    assert_eq!(wait(&stage), Motion::Settled);
    assert!(stage.is_homed().unwrap());
    stage.start_move(&pose(Axis::X, 1e-3)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
}

#[test]
fn a_reference_move_can_be_stopped() {
    let (_emulator, stage) = hexapod_with(|s| {
        s.referenced = false;
        s.reference_ms = 5000;
    });
    stage.start_homing().unwrap();
    // It would be homed if the stop had waited for that.
    stage.stop().unwrap();
    assert_eq!(stage.poll().unwrap(), Motion::Stopped);
    assert!(!stage.is_homed().unwrap());
}

#[test]
fn pivot_and_velocity_are_set_and_read_back() {
    let (_emulator, stage) = hexapod();
    let point = [0.0, -1500.0, 20_000.0].map(Length::from_um);
    stage.set_pivot(point).unwrap();
    for (a, b) in stage.pivot().unwrap().into_iter().zip(point) {
        assert!((a.um() - b.um()).abs() < 1e-3);
    }
    stage.set_platform_velocity_um_per_s(2500.0).unwrap();
    assert!((stage.platform_velocity_um_per_s().unwrap() - 2500.0).abs() < 1e-6);
    for wrong in [0.0, -1.0, f64::NAN] {
        assert!(matches!(
            stage.set_platform_velocity_um_per_s(wrong),
            Err(ScopeError::BadSetting { .. })
        ));
    }
    stage.start_move(&pose(Axis::Rz, 0.01)).unwrap();
    wait(&stage);
    let why = refusal(stage.set_pivot(point).unwrap_err());
    assert!(why.contains("rotations are zero"), "{why}");
}

#[test]
fn eight_threads_may_ask_at_once() {
    let (_emulator, stage) = hexapod();
    stage.start_move(&pose(Axis::X, 5e-3)).unwrap();
    thread::scope(|s| {
        for _ in 0..8 {
            s.spawn(|| {
                for _ in 0..30 {
                    let at = stage.position().unwrap();
                    assert!((0.0..=5e-3).contains(&at.si(Axis::X).unwrap()));
                    stage.poll().unwrap();
                }
            });
        }
    });
    stage.stop().unwrap();
}

link_faults! {
    own: Gcs2Stage::start_homing,
    silence: |e| matches!(e, ScopeError::Timeout { device: "stage", seconds } if *seconds == 0.3),
    slow_bytes_ms: 20,
    longest_line: 1024,
    endless: (is_device, "more than 64 lines"),
    after_stops: |stage: &Gcs2Stage| stage.set_platform_velocity_um_per_s(1000.0).unwrap(),
}

#[test]
fn an_answer_that_comes_after_its_end_closes_the_link() {
    let (emulator, stage) = hexapod();
    emulator.set_fault(Fault::Garbage);
    assert!(stage.stop().is_err());
    emulator.set_fault(Fault::None);
    // It would answer again, but nobody knows to what.
    assert!(detail(stage.poll().unwrap_err()).contains("closed because"));
    // A new connection works.
    let again = connect(&emulator, &settings()).unwrap();
    assert_eq!(again.poll().unwrap(), Motion::Settled);
}

#[test]
fn something_else_on_the_port_is_told() {
    let emulator = Gcs2Emulator::serve(EmulatedStage::hexapod()).unwrap();
    emulator.set_fault(Fault::EndlessLines);
    assert!(is_device(&connect(&emulator, &settings()).err().unwrap()));
}

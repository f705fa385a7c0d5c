//! Moves at a speed of their own: what is said for them, and that the usual speed is back whatever becomes of them.

mod common;

use common::{detail, pose, refusal, tcp, wait};
use scopeservo_drivers::emulator::Fault;
use scopeservo_drivers::emulator::gcs2::{EmulatedAxis, EmulatedStage, Gcs2Emulator};
use scopeservo_drivers::emulator::sangaboard::{EmulatedSanga, SangaEmulator};
use scopeservo_drivers::gcs2::{Gcs2Settings, Gcs2Stage};
use scopeservo_drivers::sangaboard::{SangaAxis, SangaSettings, SangaStage};
use scopeservo_scope::{Axis, Kinematics, Motion, PositiveZ, ScopeError, Stage};
use std::thread;
use std::time::Duration;

/// What was said since `from` that sets something, and the stops.
fn commands(heard: &[String], from: usize) -> Vec<String> {
    let sets = |line: &&String| !line.contains('?') && !line.is_empty();
    heard[from..].iter().filter(sets).cloned().collect()
}

fn gcs2_settings() -> Gcs2Settings {
    let mut settings =
        Gcs2Settings::hexapod(Kinematics::MovesMicroscope, PositiveZ::Closer, 0.1, 0.0001);
    settings.reply_timeout_ms = 300;
    settings.stop_timeout_ms = 200;
    settings
}

fn hexapod(change: impl FnOnce(&mut EmulatedStage)) -> (Gcs2Emulator, Gcs2Stage) {
    let mut stage = EmulatedStage::hexapod();
    change(&mut stage);
    let emulator = Gcs2Emulator::serve(stage).unwrap();
    let stage = Gcs2Stage::connect(tcp(&emulator.address()), &gcs2_settings()).unwrap();
    (emulator, stage)
}

/// A focus drive of 400 um, 10 mm/s, whose controller counts it in something, and axis x beside it.
fn drive(unit: &[u8], per_um: f64, unknown: &[&'static str]) -> (Gcs2Emulator, Gcs2Stage) {
    let axis = |name: &str| EmulatedAxis {
        name: name.into(),
        low: 0.0,
        high: 400.0 * per_um,
        unit: unit.to_vec(),
    };
    let emulator = Gcs2Emulator::serve(EmulatedStage {
        axes: vec![axis("1"), axis("2")],
        coupled: false,
        // The emulator knows velocities up to 20 in any unit.
        velocity: 10.0,
        referenced: true,
        reference_ms: 50,
        unknown: unknown.to_vec(),
    })
    .unwrap();
    let mut settings = gcs2_settings();
    settings.coupled = false;
    settings.rotary.clear();
    settings.linear.retain(|a| a.axis != Axis::Y);
    for axis in &mut settings.linear {
        axis.name = ["2", "1"][usize::from(axis.axis == Axis::Z)].into();
    }
    let stage = Gcs2Stage::connect(tcp(&emulator.address()), &settings).unwrap();
    (emulator, stage)
}

#[test]
fn an_axis_is_told_its_velocity_in_its_unit_and_gets_the_usual_one_back() {
    for (unit, per_um, m_per_s, set, go, back) in [
        (
            &b"MM"[..],
            1e-3,
            8.6e-4,
            "VEL 1 0.860000",
            "MOV 1 0.020000",
            "VEL 1 10.000000",
        ),
        (
            b"um",
            1.0,
            5e-6,
            "VEL 1 5.000000",
            "MOV 1 2.000000",
            "VEL 1 10.000000",
        ),
        (
            b"\xb5m",
            1.0,
            2.5e-6,
            "VEL 1 2.500000",
            "MOV 1 1.000000",
            "VEL 1 10.000000",
        ),
        (
            b"nm",
            1e3,
            5e-9,
            "VEL 1 5.000000",
            "MOV 1 0.100000",
            "VEL 1 10.000000",
        ),
    ] {
        let (emulator, stage) = drive(unit, per_um, &[]);
        assert!(stage.knows_speeds());
        let from = emulator.heard().len();
        let goal: f64 = go.rsplit(' ').next().unwrap().parse().unwrap();
        let to = pose(Axis::Z, goal / per_um * 1e-6);
        stage.start_move_at(&to, m_per_s).unwrap();
        assert_eq!(wait(&stage), Motion::Settled);
        assert_eq!(commands(&emulator.heard(), from), [set, go, back]);
        // The next move says nothing about speeds, nor does one that asks for more than the usual one.
        let from = emulator.heard().len();
        stage.start_move(&pose(Axis::Z, 0.0)).unwrap();
        assert_eq!(wait(&stage), Motion::Settled);
        stage.start_move_at(&to, 1.0).unwrap();
        assert_eq!(wait(&stage), Motion::Settled);
        let said = commands(&emulator.heard(), from);
        assert!(said.iter().all(|line| line.starts_with("MOV")), "{said:?}");
    }
}

#[test]
fn a_platform_has_one_velocity() {
    let (emulator, stage) = hexapod(|_| {});
    let from = emulator.heard().len();
    stage.start_move_at(&pose(Axis::Z, 20e-6), 1e-4).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
    let said = commands(&emulator.heard(), from);
    assert_eq!(said, ["VLS 0.100000", "MOV Z 0.020000", "VLS 5.000000"]);
    assert!((stage.platform_velocity_um_per_s().unwrap() - 5000.0).abs() < 1e-9);
}

#[test]
fn a_slow_move_that_is_stopped_halted_or_left_has_its_usual_velocity_back() {
    let slow = || {
        let (emulator, stage) = hexapod(|_| {});
        let from = emulator.heard().len();
        stage.start_move_at(&pose(Axis::Z, 2e-3), 1e-4).unwrap();
        assert_eq!(stage.poll().unwrap(), Motion::Moving);
        (emulator, stage, from)
    };
    let begun = ["VLS 0.100000", "MOV Z 2.000000"];
    let ended = |emulator: &Gcs2Emulator, from: usize, more: &[&str], what: &str| {
        thread::sleep(Duration::from_millis(50));
        let said = commands(&emulator.heard(), from);
        assert_eq!(said, [&begun[..], more].concat(), "{what}");
        assert!(!emulator.moves(), "{what}");
        assert!(emulator.truth()[2] < 1.0, "{what}");
    };
    let (emulator, stage, from) = slow();
    stage.stop().unwrap();
    assert_eq!(stage.poll().unwrap(), Motion::Stopped);
    ended(&emulator, from, &["#24", "VLS 5.000000"], "stop");

    let (emulator, stage, from) = slow();
    stage.halt().unwrap();
    assert_eq!(wait(&stage), Motion::Stopped);
    ended(
        &emulator,
        from,
        &["HLT X Y Z U V W", "VLS 5.000000"],
        "halt",
    );

    let (emulator, stage, from) = slow();
    drop(stage);
    ended(
        &emulator,
        from,
        &["#24", "VLS 5.000000"],
        "the driver's end",
    );

    let (emulator, stage, from) = slow();
    emulator.stop_by_hand();
    assert_eq!(wait(&stage), Motion::Stopped);
    ended(&emulator, from, &["VLS 5.000000"], "somebody else");

    // What nobody can understand any more is told to stop, and not left slow.
    for fault in [Fault::Silence, Fault::Garbage, Fault::Half] {
        let (emulator, stage, from) = slow();
        emulator.set_fault(fault);
        assert!(stage.poll().is_err());
        ended(
            &emulator,
            from,
            &["#24", "VLS 5.000000"],
            &format!("{fault:?}"),
        );
    }
}

#[test]
fn a_speed_that_a_controller_does_not_take_is_a_refusal_and_nothing_moves() {
    let refused = |emulator: &Gcs2Emulator, stage: &Gcs2Stage, to, m_per_s| {
        let from = emulator.heard().len();
        let why = refusal(stage.start_move_at(&to, m_per_s).unwrap_err());
        let said = commands(&emulator.heard(), from);
        assert!(!said.iter().any(|line| line.starts_with("MOV")), "{said:?}");
        assert_eq!(stage.poll().unwrap(), Motion::Settled);
        // The connection is sound.
        stage.start_move(&pose(Axis::Z, 1e-6)).unwrap();
        assert_eq!(wait(stage), Motion::Settled);
        why
    };
    let (emulator, stage) = drive(b"MM", 1e-3, &["VEL?"]);
    let why = refused(&emulator, &stage, pose(Axis::Z, 20e-6), 1e-4);
    assert!(why.contains("VEL?"), "{why}");
    let (emulator, stage) = drive(b"MM", 1e-3, &["VEL"]);
    let why = refused(&emulator, &stage, pose(Axis::Z, 20e-6), 1e-4);
    assert!(why.contains("does not know the command"), "{why}");
    let (emulator, stage) = hexapod(|s| s.unknown = vec!["VLS?"]);
    refused(&emulator, &stage, pose(Axis::Z, 20e-6), 1e-4);
    let (emulator, stage) = hexapod(|_| {});
    for to in [
        pose(Axis::Rz, 0.01),
        pose(Axis::Z, 1e-5).with_si(Axis::X, 1e-5),
    ] {
        let why = refused(&emulator, &stage, to, 1e-4);
        assert!(why.contains("one axis"), "{why}");
    }
    refused(&emulator, &stage, pose(Axis::Z, 20e-6), 1e-10);
    for m_per_s in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let asked = stage.start_move_at(&pose(Axis::Z, 0.0), m_per_s);
        assert!(matches!(asked, Err(ScopeError::BadSetting { .. })));
    }
}

#[test]
fn a_velocity_of_two_is_no_error() {
    let (emulator, stage) = hexapod(|s| s.velocity = 2.0);
    stage.start_move_at(&pose(Axis::Z, 20e-6), 1e-4).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
    assert!(emulator.heard().contains(&"VLS 2.000000".to_string()));
}

fn sanga(change: impl FnOnce(&mut EmulatedSanga)) -> (SangaEmulator, SangaStage) {
    let mut board = EmulatedSanga::new();
    change(&mut board);
    let emulator = SangaEmulator::serve(board).unwrap();
    let axis = |um_per_step| SangaAxis {
        um_per_step,
        min_um: -2000.0,
        max_um: 2000.0,
        repeatability_um: 0.2,
        arrival_tolerance_um: None,
    };
    let settings = SangaSettings {
        kinematics: Kinematics::SpecimenXyOnTop,
        positive_z: PositiveZ::Closer,
        x: Some(axis(0.1)),
        y: Some(axis(-0.1)),
        z: Some(axis(-0.05)),
        boot_ms: 0,
        reply_timeout_ms: 300,
        stop_timeout_ms: 200,
    };
    let stage = SangaStage::connect(tcp(&emulator.address()), &settings).unwrap();
    (emulator, stage)
}

#[test]
fn a_board_keeps_the_usual_step_time_while_it_makes_a_slow_move() {
    // 0.05 um in 250 us are 200 um/s.
    for (um_per_s, set) in [
        (100.0, Some("dt 500")),
        (30.0, Some("dt 1667")),
        (199.9, Some("dt 251")),
        (200.0, None),
        (860.0, None),
    ] {
        let (emulator, stage) = sanga(|_| {});
        let from = emulator.heard().len();
        stage
            .start_move_at(&pose(Axis::Z, 2e-6), um_per_s * 1e-6)
            .unwrap();
        let said = commands(&emulator.heard(), from);
        let want: Vec<&str> = match set {
            Some(set) => vec![set, "mr 0 0 -40", "dt 250"],
            None => vec!["mr 0 0 -40"],
        };
        assert_eq!(said, want, "{um_per_s} um/s");
        assert_eq!(wait(&stage), Motion::Settled);
        assert_eq!(emulator.truth(), [0, 0, -40]);
    }
    // It goes as slowly as it was asked to, though it has the usual time back.
    let (emulator, stage) = sanga(|_| {});
    stage.start_move_at(&pose(Axis::Z, 50e-6), 10e-6).unwrap();
    thread::sleep(Duration::from_millis(300));
    assert!(emulator.moves() && emulator.truth()[2].abs() < 500);
    stage.stop().unwrap();
    assert!(emulator.heard().contains(&"dt 250".to_string()));
    // A board to which the time applies at once is faster than asked, and stands where it should.
    let (emulator, stage) = sanga(|b| b.changes_under_way = true);
    stage.start_move_at(&pose(Axis::Z, 10e-6), 20e-6).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
    assert_eq!(emulator.truth(), [0, 0, -200]);
}

#[test]
fn a_board_that_knows_no_step_time_refuses_and_nothing_moves() {
    let (emulator, stage) = sanga(|b| b.knows_step_time = false);
    let why = refusal(stage.start_move_at(&pose(Axis::Z, 2e-6), 1e-5).unwrap_err());
    assert!(why.contains("dt?"), "{why}");
    let (slow, both) = (
        pose(Axis::Z, 2e-6),
        pose(Axis::Z, 2e-6).with_si(Axis::X, 2e-6),
    );
    let (other, stage_of_other) = sanga(|_| {});
    refusal(stage_of_other.start_move_at(&both, 1e-5).unwrap_err());
    refusal(stage_of_other.start_move_at(&slow, 1e-9).unwrap_err());
    assert!(stage_of_other.start_move_at(&slow, f64::NAN).is_err());
    for (emulator, stage) in [(emulator, stage), (other, stage_of_other)] {
        assert!(
            !emulator
                .heard()
                .iter()
                .any(|l| l.starts_with("mr") || l.starts_with("dt "))
        );
        stage.start_move(&pose(Axis::Z, 2e-6)).unwrap();
        assert_eq!(wait(&stage), Motion::Settled);
    }
}

#[test]
fn a_board_that_falls_silent_as_it_is_slowed_down_is_told_to_stop_and_its_usual_time() {
    for fault in [Fault::Silence, Fault::Garbage] {
        let (emulator, stage) = sanga(|_| {});
        emulator.set_fault(fault);
        assert!(stage.start_move_at(&pose(Axis::Z, 2e-6), 1e-5).is_err());
        thread::sleep(Duration::from_millis(50));
        let why = detail(stage.position().unwrap_err());
        assert!(why.contains("closed because"), "{why}");
        assert!(!emulator.moves());
    }
}

//! The G-code driver against the emulated board, over TCP.

mod common;

use common::{Bench, detail, is_device, link_faults, pose, tcp, wait};
use scopeservo_drivers::emulator::Fault;
use scopeservo_drivers::emulator::gcode::{Board, EmulatedBoard, GcodeEmulator};
use scopeservo_drivers::gcode::{GcodeAxis, GcodeSettings, GcodeStage};
use scopeservo_scope::{Axis, Kinematics, Motion, PositiveZ, ScopeError, Stage};
use std::thread;
use std::time::{Duration, Instant};

fn settings() -> GcodeSettings {
    let axis = |(axis, letter)| GcodeAxis {
        axis,
        letter,
        min_um: -50_000.0,
        max_um: 50_000.0,
        steps_per_mm: 400.0,
        repeatability_um: 2.5,
        arrival_tolerance_um: None,
    };
    GcodeSettings {
        kinematics: Some(Kinematics::SpecimenXyOnTop),
        positive_z: Some(PositiveZ::Apart),
        nosepiece: None,
        axes: [(Axis::X, 'X'), (Axis::Y, 'Y'), (Axis::Z, 'Z')]
            .map(axis)
            .into(),
        speed_um_per_s: 10_000.0,
        needs_homing: false,
        allow_queued_stop: false,
        checksums: true,
        boot_ms: 0,
        reply_timeout_ms: 300,
        busy_timeout_ms: 5000,
        homing_timeout_ms: 2000,
        stop_timeout_ms: 300,
        stall_timeout_ms: 200,
    }
}

fn connect(emulator: &GcodeEmulator, settings: &GcodeSettings) -> Result<GcodeStage, ScopeError> {
    GcodeStage::connect(tcp(&emulator.address()), settings)
}

fn start(
    board: impl FnOnce(&mut EmulatedBoard),
    change: impl FnOnce(&mut GcodeSettings),
) -> (GcodeEmulator, Result<GcodeStage, ScopeError>) {
    let (mut emulated, mut settings) = (EmulatedBoard::new(), settings());
    board(&mut emulated);
    change(&mut settings);
    let emulator = GcodeEmulator::serve(emulated).unwrap();
    let stage = connect(&emulator, &settings);
    (emulator, stage)
}

fn plain() -> (GcodeEmulator, GcodeStage) {
    let (emulator, stage) = start(|_| {}, |_| {});
    (emulator, stage.unwrap())
}

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
fn damaged_lines_are_sent_again_and_obeyed_once() {
    let (emulator, stage) = plain();
    emulator.damage_lines(2);
    stage.start_move(&pose(Axis::X, 1e-3)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
    let moves = emulator.heard();
    let moves = moves.iter().filter(|l| l.starts_with("G1"));
    assert_eq!(moves.count(), 1);
    assert_eq!(emulator.truth()[0], 1.0);
    // A line that is damaged every time is given up.
    emulator.damage_lines(u32::MAX);
    let why = detail(stage.start_move(&pose(Axis::X, 0.0)).unwrap_err());
    assert!(why.contains("damaged"), "{why}");
    assert_eq!(emulator.truth()[0], 1.0);
}

#[test]
fn a_first_line_that_arrives_damaged_is_sent_again_to_a_board_that_has_counted_before() {
    let (emulator, stage) = plain();
    stage.start_move(&pose(Axis::X, 1e-3)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
    drop(stage);
    emulator.damage_lines(2);
    let stage = connect(&emulator, &settings()).unwrap();
    stage.start_move(&pose(Axis::X, 0.0)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
    assert_eq!(emulator.truth()[0], 0.0);
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

#[test]
fn what_a_board_says_of_its_own_accord_is_passed_over() {
    let (emulator, stage) = plain();
    emulator.say(" T:21.00 /0.00 @:0");
    emulator.say("echo:SD init fail");
    stage.start_move(&pose(Axis::X, 1e-3)).unwrap();
    emulator.say("//action:notification");
    assert_eq!(wait(&stage), Motion::Settled);
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

/// What becomes of a board's line on its way.
type Words = fn(&str) -> Vec<u8>;

/// What a board that says its lines as `words` does comes to: the error, or nothing where it is driven to a place and back.
fn with_words(words: Words) -> Result<(), String> {
    let emulator = GcodeEmulator::serve(EmulatedBoard::new()).unwrap();
    let mut settings = settings();
    settings.boot_ms = 400;
    emulator.say_as(words);
    emulator.say("start");
    let stage = connect(&emulator, &settings).map_err(|e| e.to_string())?;
    stage.start_move(&pose(Axis::X, 1e-3)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
    let at = stage.position().unwrap().si(Axis::X).unwrap();
    assert!((at - 1e-3).abs() < 1e-9, "{at}");
    assert_eq!(emulator.truth()[0], 1.0);
    Ok(())
}

fn line(text: &str) -> Vec<u8> {
    format!("{text}\n").into_bytes()
}

#[test]
fn noise_on_the_line_is_passed_over() {
    let kinds: [Words; 8] = [
        |l| [b"\0", &line(l)[..]].concat(),
        |l| [l.as_bytes(), b"\0\n"].concat(),
        |l| [l.as_bytes(), b"\r\r\n"].concat(),
        |l| [b"\xff\xfe\0", &line(l)[..]].concat(),
        |l| [b"\0\0\n", &line(l)[..]].concat(),
        |l| [b"\xc2\xb5 is no ASCII\n", &line(l)[..]].concat(),
        |l| [b" T:21.00 /0.00 B:20.00 /0.00 @:0\nwait\n", &line(l)[..]].concat(),
        |l| [b"echo:busy: processing\n", &line(l)[..]].concat(),
    ];
    for (k, words) in kinds.into_iter().enumerate() {
        assert_eq!(with_words(words), Ok(()), "{k}");
    }
}

#[test]
fn positions_of_other_firmware_are_read() {
    /// Where they stand on a line, and their steps.
    fn parts(l: &str) -> Option<(&str, Vec<&str>)> {
        let (planned, steps) = l.split_once(" Count ")?;
        let steps = steps.split(' ').map(|s| &s[2..]).collect();
        Some((planned, steps))
    }
    let kinds: [Words; 4] = [
        |l| match parts(l) {
            Some((planned, n)) => line(&format!(
                "{} Count X:{} Y:{} Z:{}\n Count X:{} Y:{} Z:{}",
                planned.replace(' ', ""),
                n[0],
                n[1],
                n[2],
                n[0],
                n[1],
                n[2]
            )),
            None => line(l),
        },
        |l| match parts(l) {
            Some((planned, n)) => line(&format!(
                "{planned} E0:0.0 Count {} Machine 0.000 0.000 0.000 Bed comp 0.000",
                n.join(" ")
            )),
            None => line(l),
        },
        |l| match parts(l) {
            Some((planned, n)) => line(&format!(
                "{planned} Count: X: {} Y: {} Z: {}",
                n[0], n[1], n[2]
            )),
            None => line(l),
        },
        |l| match l.starts_with("FIRMWARE_NAME") {
            true => line("PROTOCOL_VERSION:1.0 FIRMWARE_NAME:Marlin of somebody"),
            false => line(l),
        },
    ];
    for (k, words) in kinds.into_iter().enumerate() {
        assert_eq!(with_words(words), Ok(()), "{k}");
    }
    // In the line of the "ok", after which no other comes.
    let emulator = GcodeEmulator::serve(EmulatedBoard::new()).unwrap();
    let mut said = false;
    emulator.say_as(move |l| match (l.contains(" Count "), l == "ok" && said) {
        (true, _) => {
            said = true;
            line(&format!("ok {l}"))
        }
        (false, true) => {
            said = false;
            Vec::new()
        }
        (false, false) => line(l),
    });
    let stage = connect(&emulator, &settings()).unwrap();
    stage.start_move(&pose(Axis::X, 1e-3)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
    stage.stop().unwrap();
    let at = stage.position().unwrap().si(Axis::X).unwrap();
    assert!((at - 1e-3).abs() < 1e-9, "{at}");
}

#[test]
fn a_line_that_is_refused_is_shown() {
    let kinds: [(Words, &str); 6] = [
        // Klipper, Repetier.
        (
            |l| line(l.split(" Count ").next().unwrap()),
            "'X:0.00 Y:0.00 Z:0.00 E:0.00'",
        ),
        // Smoothie.
        (
            |l| match l.split_once(" Count ") {
                Some(_) => line("ok C: X:0.0000 Y:0.0000 Z:0.0000"),
                None => line(l),
            },
            "'ok C: X:0.0000 Y:0.0000 Z:0.0000'",
        ),
        // Motors that are not those of axes.
        (
            |l| line(&l.replace("Count X:0 Y:0", "Count A:0 B:0")),
            "Count A:0 B:0 Z:0'",
        ),
        // Damaged every time.
        (
            |l| match l.split_once(" Count ") {
                Some(_) => b"X:0.00 Y:\xff.00 Count X:0\n".to_vec(),
                None => line(l),
            },
            r"'X:0.00 Y:\xff.00 Count X:0'",
        ),
        // grbl, which ends no answer with "ok" when it does not know a command.
        (|_| line("error:20"), "'error:20'"),
        // Something else altogether.
        (|_| b"\xf0\x9f\x92 login:\n".to_vec(), "login:'"),
    ];
    for (words, shown) in kinds {
        let said = with_words(words).unwrap_err();
        assert!(said.contains(shown), "{shown}: {said}");
    }
}

#[test]
fn an_answer_that_arrives_damaged_is_asked_for_again() {
    let emulator = GcodeEmulator::serve(EmulatedBoard::new()).unwrap();
    let mut count = 0;
    emulator.say_as(move |l| {
        count += usize::from(l.contains(" Count "));
        match l.contains(" Count ") && count % 3 != 0 {
            true => l
                .bytes()
                .map(|b| if b == b'.' { 0xf9 } else { b })
                .chain(*b"\n")
                .collect(),
            false => line(l),
        }
    });
    let stage = connect(&emulator, &settings()).unwrap();
    stage.start_move(&pose(Axis::X, 1e-3)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
    assert_eq!(emulator.truth()[0], 1.0);
}

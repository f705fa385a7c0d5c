//! What comes over the line: damage, noise, and the forms of other firmware.

use crate::board::{connect, plain, settings};
use crate::common::{detail, pose, wait};
use scopeservo_drivers::emulator::gcode::{EmulatedBoard, GcodeEmulator};
use scopeservo_scope::{Axis, Motion, Stage};

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
fn what_a_board_says_of_its_own_accord_is_passed_over() {
    let (emulator, stage) = plain();
    emulator.say(" T:21.00 /0.00 @:0");
    emulator.say("echo:SD init fail");
    stage.start_move(&pose(Axis::X, 1e-3)).unwrap();
    emulator.say("//action:notification");
    assert_eq!(wait(&stage), Motion::Settled);
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

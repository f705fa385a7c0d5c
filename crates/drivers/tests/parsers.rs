//! Whatever comes: no parser panics, none makes a value of what is none, and no driver waits longer than it may.

mod common;

use common::{Random, tcp};
use scopeservo_drivers::link::{LineReader, LinkError, Transport, ascii};
use scopeservo_drivers::{gcode, gcs2, sangaboard};
use scopeservo_scope::{Axis, Kinematics, PositiveZ, ScopeError};
use std::collections::VecDeque;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

/// What lines are made of, on all three kinds of wire.
const PARTS: [&str; 62] = [
    "ok",
    "ok ",
    "start",
    "echo:",
    "busy:",
    "Error:",
    "checksum",
    "Resend:",
    "rs ",
    "Cap:",
    ":",
    "::",
    "X",
    "Y",
    "Z",
    "U",
    "E",
    "X:",
    "Y:",
    "Count",
    " Count ",
    "=",
    "X=",
    "Y=",
    "==",
    "0",
    "1",
    "-",
    "+",
    ".",
    "e",
    "e9",
    "1e400",
    "nan",
    "inf",
    "NaN",
    "-0",
    "0x",
    "3F",
    "ffffffffffffffffff",
    "9223372036854775808",
    "2147483648",
    "-2147483649",
    "true",
    "false",
    "done",
    "done.",
    "Move aborted",
    "blocking_moves ",
    "Sangaboard",
    "FIRMWARE_NAME:",
    "Unknown command",
    "Home ",
    " First",
    " ",
    "  ",
    "\t",
    "\r",
    "Ä",
    "\u{1F52C}",
    "\u{0}",
    "12.5",
];

/// Lines as they should be.
const SOUND: [&str; 18] = [
    "X=1.25",
    "Y=-0.5",
    "1",
    "0",
    "3F",
    "10",
    "5.0",
    "ok N5 P15",
    "X:1.00 Y:-2.00 E:0.00 Count X:80 Y:-160",
    "Error:checksum mismatch, Last Line: 4",
    "Resend: 5",
    "Cap:EMERGENCY_PARSER:1",
    "120 -350 0",
    "blocking_moves true",
    "Sangaboard Firmware v1.0",
    "Move aborted",
    "true",
    "done.",
];

/// A sound line or parts in a row, with some places changed.
fn line(random: &mut Random) -> String {
    let mut bytes = if random.below(2) == 0 {
        random.of(&SOUND).as_bytes().to_vec()
    } else {
        let parts = (0..random.below(8)).map(|_| random.of(&PARTS));
        parts.collect::<String>().into_bytes()
    };
    for _ in 0..random.below(3) {
        let at = random.below(bytes.len() + 1);
        match random.below(3) {
            0 => bytes.insert(at, random.next() as u8),
            1 => drop(bytes.splice(at..at, random.of(&PARTS).bytes())),
            _ => bytes.truncate(at),
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[test]
fn gcs2_makes_values_only_of_what_is_one() {
    use gcs2::codec::*;
    let names: Vec<AxisName> = ["X", "Y"]
        .iter()
        .map(|n| AxisName::new(n).unwrap())
        .collect();
    let mut random = Random(1);
    let mut read = 0;
    for _ in 0..200_000 {
        let lines: Vec<String> = (0..random.below(4)).map(|_| line(&mut random)).collect();
        if let Ok(values) = decode_values("POS?", &names, &lines) {
            assert!(
                values.len() == 2 && values.iter().all(|v| v.is_finite()),
                "{lines:?}"
            );
            assert_eq!(lines.len(), 2);
            read += 1;
        }
        if let Ok(value) = decode_number("VLS?", &lines) {
            assert!(value.is_finite(), "{lines:?}");
            read += 1;
        }
        if let Ok(axes) = decode_axes(&lines) {
            assert!(axes.iter().all(|a| AxisName::new(a.as_str()).is_ok()));
        }
        if decode_moving(&lines) == Ok(false) {
            assert!(lines[0].contains('0'), "{lines:?}");
        }
        if decode_reachable(&lines) == Ok(true) {
            assert!(lines.iter().all(|l| l.contains('1')), "{lines:?}");
        }
        if let Ok(true) = decode_flags("FRF?", &names, &lines).map(|f| f.iter().all(|f| *f)) {
            assert!(lines.iter().all(|l| l.contains('1')), "{lines:?}");
        }
        if let Ok(number) = decode_error(&lines) {
            assert!(error_in_words(number).contains(&number.to_string()));
        }
        let bytes: Vec<u8> = (0..random.below(3)).map(|_| random.next() as u8).collect();
        assert_eq!(
            decode_ready(&bytes).is_ok(),
            bytes == [176] || bytes == [177]
        );
        for line in &lines {
            let (kept, more) = line_and_more(line);
            assert_eq!(kept.len() + usize::from(more), line.len());
        }
    }
    assert!(read > 1000, "only {read} were values");
}

#[test]
fn gcode_makes_positions_only_of_what_is_one() {
    use gcode::codec::*;
    let mut random = Random(2);
    let mut read = 0;
    for round in 0..400_000 {
        let mut text = line(&mut random);
        if round % 2 == 0 {
            text = format!(
                "X:{} Count {text}",
                random.of(&["1.00", "-2", "nan", "inf", "1e999"])
            );
        }
        match decode(&text) {
            Line::Position(report) => {
                assert!(
                    report.planned_mm.iter().all(|(_, v)| v.is_finite()),
                    "{text:?}"
                );
                read += usize::from(!report.steps.is_empty());
            }
            Line::Ok(_) => assert!(text.trim().starts_with("ok")),
            _ => {}
        }
    }
    assert!(read > 1000, "only {read} were positions");
}

#[test]
fn the_sangaboards_codec_makes_positions_only_of_what_is_one() {
    use sangaboard::codec::*;
    let mut random = Random(3);
    let mut read = 0;
    for _ in 0..400_000 {
        let text = line(&mut random);
        if let Ok(steps) = decode_position(&text) {
            assert!(steps.iter().all(|s| s.abs() <= MAX_STEPS + 1), "{text:?}");
            assert_eq!(text.split_ascii_whitespace().count(), 3);
            read += 1;
        }
        if let Ok(name) = decode_version(&text) {
            assert!(!name.is_empty());
        }
        let done = decode_done(Command::Release, &text).is_ok();
        assert!(!done || text.contains("done"));
        let stopped = decode_stopped(&text).is_ok();
        assert!(!stopped || text.to_ascii_lowercase().contains("abort"));
        assert!(decode_moving(&text).is_err() || text.contains("true") || text.contains("false"));
        assert!(decode_blocking(&text).is_none() || text.contains("blocking_moves"));
    }
    assert!(read > 1000, "only {read} were positions");
}

/// Bytes from memory, in pieces of the sizes given.
struct Memory(Mutex<VecDeque<Vec<u8>>>);

impl Transport for Memory {
    fn read(&self, into: &mut [u8], _: Instant) -> Result<usize, LinkError> {
        let piece = self
            .0
            .lock()
            .unwrap()
            .pop_front()
            .ok_or(LinkError::Closed)?;
        into[..piece.len()].copy_from_slice(&piece);
        Ok(piece.len())
    }
    fn write(&self, _: &[u8]) -> Result<(), LinkError> {
        Ok(())
    }
    fn close(&self) {}
}

#[test]
fn lines_are_those_of_the_bytes_however_they_come() {
    let mut random = Random(4);
    let deadline = Instant::now() + Duration::from_secs(600);
    for _ in 0..3000 {
        let mut bytes = Vec::new();
        for _ in 0..random.below(300) {
            let common = b"\n\rab 1";
            bytes.push(match random.below(3) {
                0 => random.next() as u8,
                _ => random.of(common),
            });
        }
        let (mut pieces, mut rest) = (VecDeque::new(), &bytes[..]);
        while !rest.is_empty() {
            let n = 1 + random.below(rest.len().min(40));
            pieces.push_back(rest[..n].to_vec());
            rest = &rest[n..];
        }
        let memory = Memory(Mutex::new(pieces));
        let mut reader = LineReader::new(30);
        // By the definition: split at LF, drop one CR, at most 30 bytes; what has no LF is no line.
        let mut want: Vec<&[u8]> = bytes.split(|b| *b == b'\n').collect();
        let last = want.pop().unwrap();
        let mut want = want.into_iter().map(|l| l.strip_suffix(b"\r").unwrap_or(l));
        loop {
            let (got, want) = (reader.bytes(&memory, deadline), want.next());
            match (got, want) {
                (Ok(got), Some(want)) => {
                    assert_eq!(got, want);
                    let text = want
                        .iter()
                        .all(|b| *b == b'\t' || (b' '..=b'~').contains(b));
                    assert_eq!(ascii(got).is_ok(), text);
                }
                (Err(LinkError::LineTooLong { limit: 30 }), Some(want)) => {
                    assert!(want.len() > 30);
                    break;
                }
                (Err(LinkError::LineTooLong { limit: 30 }), None) => {
                    assert!(last.len() > 30);
                    break;
                }
                (Err(LinkError::Closed), None) => {
                    assert!(last.len() <= 31);
                    break;
                }
                other => panic!("{other:?} of {}", bytes.escape_ascii()),
            }
        }
    }
}

/// A peer that answers everything with lines of parts. Returns what connecting said and how long that took.
fn against_noise<T>(
    seed: u64,
    connect: impl FnOnce(Box<dyn Transport>) -> Result<T, ScopeError>,
) -> (Result<(), ScopeError>, Duration) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let peer = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut random = Random(seed);
        let mut heard = [0; 64];
        while stream.read(&mut heard).is_ok_and(|n| n > 0) {
            let mut says = format!(
                "{}\n",
                random.of(&["ok", "1", "X=1 \nY=1", "Sangaboard", ""])
            );
            for _ in 0..random.below(3) {
                says.push_str(&line(&mut random));
                says.push('\n');
            }
            if stream.write_all(says.as_bytes()).is_err() {
                return;
            }
        }
    });
    let tcp = tcp(&address);
    let start = Instant::now();
    let answer = connect(tcp).map(|_| ());
    let took = start.elapsed();
    peer.join().unwrap();
    (answer, took)
}

#[test]
fn drivers_refuse_noise_in_time() {
    let mut hexapod =
        gcs2::Gcs2Settings::hexapod(Kinematics::MovesMicroscope, PositiveZ::Closer, 0.1, 0.001);
    hexapod.reply_timeout_ms = 30;
    let board = gcode::GcodeSettings {
        kinematics: Some(Kinematics::SpecimenXyOnTop),
        positive_z: Some(PositiveZ::Apart),
        nosepiece: None,
        axes: vec![gcode::GcodeAxis {
            axis: Axis::X,
            letter: 'X',
            min_um: 0.0,
            max_um: 1000.0,
            steps_per_mm: 400.0,
            repeatability_um: 5.0,
            arrival_tolerance_um: None,
        }],
        speed_um_per_s: 1000.0,
        needs_homing: false,
        allow_queued_stop: true,
        checksums: true,
        boot_ms: 0,
        reply_timeout_ms: 30,
        busy_timeout_ms: 100,
        homing_timeout_ms: 100,
        stop_timeout_ms: 30,
        stall_timeout_ms: 30,
    };
    let sanga = sangaboard::SangaSettings {
        kinematics: Kinematics::SpecimenXyOnTop,
        positive_z: PositiveZ::Apart,
        x: Some(sangaboard::SangaAxis {
            um_per_step: 0.1,
            min_um: 0.0,
            max_um: 1000.0,
            repeatability_um: 0.1,
            arrival_tolerance_um: None,
        }),
        y: None,
        z: None,
        boot_ms: 0,
        reply_timeout_ms: 30,
        stop_timeout_ms: 30,
    };
    for seed in 0..40 {
        let answers = [
            against_noise(seed, |t| gcs2::Gcs2Stage::connect(t, &hexapod)),
            against_noise(seed, |t| gcode::GcodeStage::connect(t, &board)),
            against_noise(seed, |t| sangaboard::SangaStage::connect(t, &sanga)),
        ];
        for (at, (answer, took)) in answers.into_iter().enumerate() {
            assert!(
                answer.is_err(),
                "driver {at} took noise for a stage, seed {seed}"
            );
            assert!(
                took < Duration::from_secs(3),
                "driver {at}: {took:?}, seed {seed}"
            );
        }
    }
}

//! Commands to bytes and lines to meanings. No input, no output, no state.
//!
//! Every command line is answered by a line that begins with "ok", after what it reports. A line may carry a number and a
//! checksum; the board then asks for it again when it came damaged. Between answers it may say other things at any time.

use thiserror::Error;

/// Stops the steppers where they are. Never numbered, so that it can go out at any time.
pub const QUICK_STOP: &[u8] = b"M410\n";
/// Longer lines than this come from no board.
pub const MAX_LINE_BYTES: usize = 1024;

/// A value that cannot be sent.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum CodecError {
    /// A number that is not finite, or too large for any stage.
    #[error("{0} cannot be sent as a number")]
    BadNumber(f64),
    /// A letter that names no axis.
    #[error("{0:?} cannot be the letter of an axis")]
    BadLetter(char),
}

/// One command.
#[derive(Debug, Clone, PartialEq)]
pub enum Command<'a> {
    /// Starts the line numbers anew; sent with number 0.
    StartNumbers,
    /// What the firmware is and can do.
    Firmware,
    /// Numbers are millimetres from now on.
    Millimetres,
    /// Positions are absolute from now on.
    Absolute,
    /// Moves axes to places in a straight line.
    Move {
        /// Axis letters and places, mm.
        to_mm: &'a [(char, f64)],
        /// Speed along the line, mm/min.
        feed_mm_per_min: f64,
    },
    /// Where the move under way will end and where the steppers are.
    Position,
    /// Answered when all moves have ended.
    Finish,
    /// Reference moves of axes. THE STAGE MOVES. Answered when they have ended.
    Home(&'a [char]),
    /// The reference move of one axis, without lifting others before (R0). Answered when it has ended.
    HomeInPlace(char),
}

impl Command<'_> {
    /// The bytes to send, with a line number and a checksum if there is a number.
    ///
    /// # Errors
    /// [`CodecError`].
    pub fn encode(&self, number: Option<u32>) -> Result<Vec<u8>, CodecError> {
        let text = self.text()?;
        Ok(match number {
            None => format!("{text}\n"),
            Some(number) => {
                let line = format!("N{number} {text}");
                let sum = line.bytes().fold(0, |sum, byte| sum ^ byte);
                format!("{line}*{sum}\n")
            }
        }
        .into_bytes())
    }

    fn text(&self) -> Result<String, CodecError> {
        Ok(match self {
            Self::StartNumbers => "M110 N0".into(),
            Self::Firmware => "M115".into(),
            Self::Millimetres => "G21".into(),
            Self::Absolute => "G90".into(),
            Self::Move {
                to_mm,
                feed_mm_per_min,
            } => {
                let mut text = "G1".to_string();
                for (letter, value) in *to_mm {
                    text.push_str(&format!(" {}{:.4}", axis(*letter)?, number(*value)?));
                }
                text.push_str(&format!(" F{:.2}", number(*feed_mm_per_min)?));
                text
            }
            Self::Position => "M114".into(),
            Self::Finish => "M400".into(),
            Self::HomeInPlace(letter) => format!("G28 {} R0", axis(*letter)?),
            // Without a letter all axes would move.
            Self::Home([]) => return Err(CodecError::BadLetter(' ')),
            Self::Home(letters) => {
                let mut text = "G28".to_string();
                for letter in *letters {
                    text.push_str(&format!(" {}", axis(*letter)?));
                }
                text
            }
        })
    }
}

/// A letter that may name an axis: no G, M, N, T or F, which mean something else in a move.
pub(crate) fn axis(letter: char) -> Result<char, CodecError> {
    if letter.is_ascii_uppercase() && !"GMNTFSPO".contains(letter) {
        Ok(letter)
    } else {
        Err(CodecError::BadLetter(letter))
    }
}

fn number(value: f64) -> Result<f64, CodecError> {
    if value.is_finite() && value.abs() < 1e6 {
        Ok(value)
    } else {
        Err(CodecError::BadNumber(value))
    }
}

/// The answer to [`Command::Position`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Report {
    /// Axis letters and where the last move sent ends, mm.
    pub planned_mm: Vec<(char, f64)>,
    /// Axis letters and where the steppers are, steps; empty where the board does not say it, or not in steps of axes.
    pub steps: Vec<(char, i64)>,
    /// The line, to be shown.
    pub said: String,
}

impl Report {
    /// Where the steppers of an axis are, if the report says it.
    pub fn steps_of(&self, letter: char) -> Option<i64> {
        self.steps.iter().find(|s| s.0 == letter).map(|s| s.1)
    }
    /// Where the last move of an axis ends, mm, if the report says it.
    pub fn planned_mm_of(&self, letter: char) -> Option<f64> {
        self.planned_mm.iter().find(|s| s.0 == letter).map(|s| s.1)
    }
}

/// What a line from the board means.
#[derive(Debug, Clone, PartialEq)]
pub enum Line {
    /// A command is done, or, a move, taken; some boards say in the same line where it is.
    Ok(Option<Report>),
    /// A command takes its time.
    Busy,
    /// The board has just started.
    Start,
    /// Line `n` came damaged and is wanted again.
    Resend(u32),
    /// The line before came damaged; [`Line::Resend`] follows.
    Damaged(String),
    /// A fault.
    Error(String),
    /// Where it is.
    Position(Report),
    /// It does not know, or does not do, what was sent.
    Refused(String),
    /// What it can do: name and whether.
    Capability(String, bool),
    /// The firmware's name.
    Firmware(String),
    /// Anything else, to be passed over.
    Other(String),
}

/// Lines of boards that have just started: Marlin's, and what others say who are met by mistake.
fn is_start(line: &str) -> bool {
    matches!(line, "start" | "Smoothie")
        || line.starts_with("Grbl ")
        || line.ends_with("is up and running.")
}

/// What follows "ok", if a line begins with that. What follows at once may be noise, but no more of the word.
fn after_ok(line: &str) -> Option<&str> {
    let rest = line.strip_prefix("ok")?;
    (rest.is_empty() || rest.starts_with([' ', '\t', '\\'])).then(|| rest.trim())
}

/// Says what a line means. Every line means something.
pub fn decode(line: &str) -> Line {
    let line = line.trim();
    if let Some(rest) = after_ok(line) {
        return Line::Ok(report(rest));
    }
    if is_start(line) {
        return Line::Start;
    }
    if let Some(rest) = line.strip_prefix("Error:") {
        let rest = rest.trim();
        let lower = rest.to_ascii_lowercase();
        let damaged = lower.contains("checksum") || lower.contains("line number");
        return if damaged {
            Line::Damaged(rest.into())
        } else {
            Line::Error(rest.into())
        };
    }
    for prefix in ["Resend:", "rs "] {
        if let Some(number) = line.strip_prefix(prefix) {
            let number = number.trim();
            return match number.strip_prefix('N').unwrap_or(number).parse() {
                Ok(number) => Line::Resend(number),
                Err(_) => Line::Other(line.into()),
            };
        }
    }
    if let Some((name, value)) = line
        .strip_prefix("Cap:")
        .and_then(|rest| rest.split_once(':'))
    {
        return Line::Capability(name.into(), value.trim() == "1");
    }
    if let Some((_, rest)) = line.split_once("FIRMWARE_NAME:") {
        let ends = [" SOURCE_CODE_URL", " PROTOCOL_VERSION"];
        let end = ends.iter().filter_map(|e| rest.find(e)).min();
        let name = &rest[..end.unwrap_or(rest.len())];
        return Line::Firmware(name.trim().into());
    }
    let echo = line.strip_prefix("echo:").unwrap_or(line).trim();
    if echo.starts_with("busy:") {
        return Line::Busy;
    }
    if echo.starts_with("Unknown command") || echo.starts_with("error:") || wants_homing(echo) {
        return Line::Refused(echo.into());
    }
    match report(line) {
        Some(report) => Line::Position(report),
        None => Line::Other(line.into()),
    }
}

/// "X:1.00 Y:2.00 Z:0.00 E:0.00 Count X:80 Y:160 Z:0", with or without spaces between, and "Count 80 160 0", which is X, Y and Z. Where the
/// steppers are counted otherwise, or not at all, the report says nothing of them.
fn report(line: &str) -> Option<Report> {
    let (planned, count) = match line.split_once("Count") {
        Some((planned, count)) => (planned, Some(count)),
        None => (line, None),
    };
    let number = |(letter, text): (char, &str)| {
        let value: f64 = text.parse().ok()?;
        value.is_finite().then_some((letter, value))
    };
    let planned_mm: Vec<_> = pairs(planned)?
        .into_iter()
        .map(number)
        .collect::<Option<_>>()?;
    let is_place = count.is_some() || planned_mm.iter().any(|(letter, _)| *letter == 'X');
    (is_place && !planned_mm.is_empty()).then(|| Report {
        planned_mm,
        steps: count.and_then(steps).unwrap_or_default(),
        said: line.into(),
    })
}

/// What follows "Count". Numbers with decimals are no steps.
fn steps(count: &str) -> Option<Vec<(char, i64)>> {
    let count = count.strip_prefix(':').unwrap_or(count).trim();
    if count.starts_with(|c: char| c.is_ascii_uppercase()) {
        let step = |(letter, text): (char, &str)| Some((letter, text.parse().ok()?));
        return pairs(count)?.into_iter().map(step).collect();
    }
    // RepRapFirmware goes on in words.
    let end = count.find(|c: char| c.is_ascii_alphabetic());
    let (numbers, rest) = count.split_at(end.unwrap_or(count.len()));
    let all: Vec<i64> = numbers
        .split_ascii_whitespace()
        .map(|n| n.parse().ok())
        .collect::<Option<_>>()?;
    let named = |all: [i64; 3]| "XYZ".chars().zip(all).collect();
    let ends = rest.is_empty() || rest.starts_with("Machine");
    all.try_into().ok().filter(|_| ends).map(named)
}

/// Letters and what is said of each. Those with a digit behind them, of several extruders, are left out.
fn pairs(text: &str) -> Option<Vec<(char, &str)>> {
    let mut pairs: Vec<(char, &str)> = Vec::new();
    let mut rest = text.trim();
    while !rest.is_empty() {
        let letter = rest.chars().next().filter(char::is_ascii_uppercase)?;
        let name = &rest[1..];
        let after = name.trim_start_matches(|c: char| c.is_ascii_digit());
        let is_axis = after.len() == name.len();
        rest = after.strip_prefix(':')?.trim_start();
        let in_number = |c: char| c.is_ascii_digit() || "+-.".contains(c);
        let end = rest.find(|c| !in_number(c)).unwrap_or(rest.len());
        let (number, behind) = rest.split_at(end);
        if number.is_empty() || (is_axis && pairs.iter().any(|p| p.0 == letter)) {
            return None;
        }
        if is_axis {
            pairs.push((letter, number));
        }
        rest = behind.trim_start();
    }
    Some(pairs)
}

/// Whether a refusal says that the board does not know where it is.
pub fn wants_homing(refusal: &str) -> bool {
    refusal.starts_with("Home ") && refusal.ends_with(" First")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent(command: &Command<'_>, number: Option<u32>) -> String {
        String::from_utf8(command.encode(number).unwrap()).unwrap()
    }

    #[test]
    fn commands_are_written_as_the_board_reads_them() {
        let to_mm = &[('X', 1.25), ('Z', -0.5)][..];
        let go = Command::Move {
            to_mm,
            feed_mm_per_min: 600.0,
        };
        for (command, text) in [
            (Command::Firmware, "M115\n"),
            (Command::Millimetres, "G21\n"),
            (Command::Absolute, "G90\n"),
            (go, "G1 X1.2500 Z-0.5000 F600.00\n"),
            (Command::Position, "M114\n"),
            (Command::Finish, "M400\n"),
            (Command::Home(&['X', 'Y']), "G28 X Y\n"),
        ] {
            assert_eq!(sent(&command, None), text);
        }
    }

    /// The sums are those of a transcript of a printer's host.
    #[test]
    fn checksums_are_those_that_boards_accept() {
        assert_eq!(sent(&Command::StartNumbers, Some(0)), "N0 M110 N0*125\n");
        assert_eq!(sent(&Command::Position, Some(50)), "N50 M114*18\n");
        assert_eq!(sent(&Command::Finish, Some(57)), "N57 M400*21\n");
        assert_eq!(sent(&Command::Position, Some(58)), "N58 M114*26\n");
    }

    #[test]
    fn what_would_break_a_line_is_not_sent() {
        for value in [f64::NAN, f64::INFINITY, 1e6] {
            let to_mm = &[('X', value)][..];
            let go = Command::Move {
                to_mm,
                feed_mm_per_min: 1.0,
            };
            assert!(go.encode(None).is_err());
        }
        for letter in ['x', 'F', 'N', '*', '\n', 'Ä'] {
            assert!(Command::Home(&[letter]).encode(None).is_err(), "{letter:?}");
        }
    }

    #[test]
    fn a_boards_lines_are_understood() {
        let other = |s: &str| Line::Other(s.into());
        for (line, meaning) in [
            ("ok", Line::Ok(None)),
            ("ok N49 P15 B3", Line::Ok(None)),
            (r"ok\xff", Line::Ok(None)),
            ("ok T:21.0 /0.0 B:20.0 /0.0 @:0", Line::Ok(None)),
            ("ok T:21.0 B:20.0", Line::Ok(None)),
            ("okay", other("okay")),
            ("start", Line::Start),
            ("Smoothie", Line::Start),
            ("Grbl 1.1h ['$' for help]", Line::Start),
            ("RepRapFirmware for Duet 2 is up and running.", Line::Start),
            ("error:20", Line::Refused("error:20".into())),
            ("wait", other("wait")),
            (
                "//action:notification ready",
                other("//action:notification ready"),
            ),
            (r"T:21 \xb0C", other(r"T:21 \xb0C")),
            ("rs N7", Line::Resend(7)),
            (
                "FIRMWARE_VERSION:v0.12 FIRMWARE_NAME:Klipper",
                Line::Firmware("Klipper".into()),
            ),
            (
                "FIRMWARE_NAME: RepRapFirmware for Duet 2 FIRMWARE_VERSION: 3.4",
                Line::Firmware("RepRapFirmware for Duet 2 FIRMWARE_VERSION: 3.4".into()),
            ),
            ("echo:busy: processing", Line::Busy),
            ("busy: processing", Line::Busy),
            ("Resend: 7", Line::Resend(7)),
            ("Resend:7", Line::Resend(7)),
            ("Resend: x", other("Resend: x")),
            (
                "Error:checksum mismatch, Last Line: 6",
                Line::Damaged("checksum mismatch, Last Line: 6".into()),
            ),
            (
                "Error:Line Number is not Last Line Number+1, Last Line: 6",
                Line::Damaged("Line Number is not Last Line Number+1, Last Line: 6".into()),
            ),
            (
                "Error:Printer halted. kill() called!",
                Line::Error("Printer halted. kill() called!".into()),
            ),
            (
                "echo:Unknown command: \"M999\"",
                Line::Refused("Unknown command: \"M999\"".into()),
            ),
            (
                "echo:Home XYZ First",
                Line::Refused("Home XYZ First".into()),
            ),
            (
                "Cap:EMERGENCY_PARSER:1",
                Line::Capability("EMERGENCY_PARSER".into(), true),
            ),
            (
                "FIRMWARE_NAME:Marlin 2.1.2 (Aug  1 2023) SOURCE_CODE_URL:github.com PROTOCOL_VERSION:1.0",
                Line::Firmware("Marlin 2.1.2 (Aug  1 2023)".into()),
            ),
            (
                " T:21.00 /0.00 B:20.00 /0.00 @:0",
                other("T:21.00 /0.00 B:20.00 /0.00 @:0"),
            ),
            ("", other("")),
        ] {
            assert_eq!(decode(line), meaning, "{line:?}");
        }
    }

    #[test]
    fn positions_are_read_from_the_steppers_and_from_the_plan() {
        for line in [
            // Marlin, with and without spaces, and what is behind an "ok".
            "X:205.00 Y:-5.00 Z:0.50 E:0.00 Count X:9127 Y:-400 Z:103",
            "X:205.00 Y:-5.00 Z:0.50 E:0.00 Count X: 9127 Y: -400 Z: 103",
            "X:205.00Y:-5.00Z:0.50E:0.00 Count X:9127Y:-400Z:103",
            "X: 205.00 Y: -5.00 Z: 0.50 E: 0.00 Count: X: 9127 Y: -400 Z: 103",
            "ok X:205.00 Y:-5.00 Z:0.50 E:0.00 Count X:9127 Y:-400 Z:103",
            // RepRapFirmware.
            "X:205.000 Y:-5.000 Z:0.500 E:0.000 E0:0.0 Count 9127 -400 103 Machine 205.000 -5.000 0.500 Bed comp 0.000",
            "X:205.000 Y:-5.000 Z:0.500 E0:0.0 E1:0.0 Count 9127 -400 103",
        ] {
            let (Line::Position(report) | Line::Ok(Some(report))) = decode(line) else {
                panic!("{line}");
            };
            assert_eq!(report.planned_mm_of('X'), Some(205.0), "{line}");
            assert_eq!(report.steps_of('X'), Some(9127), "{line}");
            assert_eq!(report.steps_of('Y'), Some(-400), "{line}");
            assert_eq!(report.steps_of('Z'), Some(103), "{line}");
            assert_eq!(report.steps_of('E'), None, "{line}");
            assert!(line.ends_with(&report.said));
        }
    }

    #[test]
    fn steps_in_another_form_are_not_guessed() {
        for line in [
            // Millimetres: Prusa's firmware and old Marlin.
            "X:205.00 Y:5.00 Z:0.00 E:0.00 Count X: 205.00 Y:5.00 Z:0.00 E:0.00",
            "X:205.00 Y:5.00 Count X:91.27 Y:400",
            // None: Klipper, Repetier.
            "X:205.000 Y:5.000 Z:0.000 E:0.000",
            "ok X:205.00 Y:5.00 Z:0.00",
            "X:205.00",
            "X:1 Count ",
            // Damaged, or of more axes than these have letters for.
            r"X:1 Count X:1\xff",
            "X:1 Count 1 2",
            "X:1 Count 1 2 3 4",
            "X:1 Count 1 2 3 4.5 Machine",
            "X:1 Count X:1 X:2",
        ] {
            let (Line::Position(report) | Line::Ok(Some(report))) = decode(line) else {
                panic!("{line}");
            };
            assert_eq!(report.steps, [], "{line}");
        }
        // Motors that are not those of axes (CoreXY), and Virtual Marlin's.
        for line in [
            "X:1.00 Y:2.00 Z:0.00 E:0.00 Count A:1200 B:-400 Z:0",
            "X:1.0 Y:2.0 Z:0.0 E:0.0 Count: A:100 B:200 C:0",
        ] {
            let Line::Position(report) = decode(line) else {
                panic!("{line}");
            };
            assert_eq!(report.steps_of('X'), None, "{line}");
        }
        for line in [
            "X:205.00 X:5.00 Count X:91",
            "X:nan Count X:1",
            "X:1e3 Count X:1",
            r"X:20\xff.00 Y:0.00 Count X:1 Y:0",
            "X=1 Count X=1",
            " Count X:1 Y:2",
            "<Idle|MPos:0.000,0.000,0.000|FS:0,0>",
        ] {
            assert!(matches!(decode(line), Line::Other(_)), "{line}");
        }
        // As Smoothie says it, where nothing tells of steppers.
        assert_eq!(decode("ok C: X:1.0000 Y:0.0000 Z:0.0000"), Line::Ok(None));
    }
}

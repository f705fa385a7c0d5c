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
    /// Axis letters and where the steppers are, steps.
    pub steps: Vec<(char, i64)>,
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
    /// A command is done, or, a move, taken.
    Ok,
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

/// Says what a line means. Every line means something.
pub fn decode(line: &str) -> Line {
    let line = line.trim();
    if line == "ok" || line.starts_with("ok ") {
        return Line::Ok;
    }
    if line == "start" {
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
            return match number.trim().parse() {
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
    if let Some(rest) = line.strip_prefix("FIRMWARE_NAME:") {
        let name = rest.split(" SOURCE_CODE_URL").next().unwrap_or(rest);
        return Line::Firmware(name.trim().into());
    }
    let echo = line.strip_prefix("echo:").unwrap_or(line).trim();
    if echo.starts_with("busy:") {
        return Line::Busy;
    }
    if echo.starts_with("Unknown command") || wants_homing(echo) {
        return Line::Refused(echo.into());
    }
    match report(line) {
        Some(report) => Line::Position(report),
        None => Line::Other(line.into()),
    }
}

/// "X:1.00 Y:2.00 Z:0.00 E:0.00 Count X:80 Y:160 Z:0", spaces after the colons allowed.
fn report(line: &str) -> Option<Report> {
    let (planned, steps) = line.split_once(" Count ")?;
    let planned_mm = pairs(planned)?;
    let steps: Vec<(char, i64)> = pairs(steps)?;
    let finite = planned_mm.iter().all(|(_, v): &(char, f64)| v.is_finite());
    (finite && !planned_mm.is_empty() && !steps.is_empty()).then_some(Report { planned_mm, steps })
}

fn pairs<T: std::str::FromStr>(text: &str) -> Option<Vec<(char, T)>> {
    let mut pairs: Vec<(char, T)> = Vec::new();
    let mut rest = text.trim();
    while !rest.is_empty() {
        let letter = rest.chars().next().filter(char::is_ascii_uppercase)?;
        rest = rest[1..].strip_prefix(':')?.trim_start();
        let end = rest.find(' ').unwrap_or(rest.len());
        if pairs.iter().any(|p| p.0 == letter) {
            return None;
        }
        pairs.push((letter, rest[..end].parse().ok()?));
        rest = rest[end..].trim_start();
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
            ("ok", Line::Ok),
            ("ok N49 P15 B3", Line::Ok),
            ("okay", other("okay")),
            ("start", Line::Start),
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
            "X:205.00 Y:-5.00 Z:0.50 E:0.00 Count X:9127 Y:-400 Z:103",
            "X:205.00 Y:-5.00 Z:0.50 E:0.00 Count X: 9127 Y: -400 Z: 103",
        ] {
            let Line::Position(report) = decode(line) else {
                panic!("{line}");
            };
            assert_eq!(report.planned_mm_of('X'), Some(205.0));
            assert_eq!(report.steps_of('X'), Some(9127));
            assert_eq!(report.steps_of('Y'), Some(-400));
            assert_eq!(report.steps_of('E'), None);
        }
    }

    #[test]
    fn positions_in_another_form_are_not_guessed() {
        for line in [
            "X:205.00 Y:5.00 Count X:91.27 Y:400",
            "X:205.00 X:5.00 Count X:91",
            "X:205.00",
            "X:nan Count X:1",
            "X:1 Count ",
            "X=1 Count X=1",
        ] {
            assert!(matches!(decode(line), Line::Other(_)), "{line}");
        }
    }
}

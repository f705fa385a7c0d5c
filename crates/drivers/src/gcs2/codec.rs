//! Commands to bytes and answers to values. No input, no output, no state.
//!
//! A command is a line that ends in LF, or one byte alone. An answer of several lines has a space before the LF of every
//! line but the last. A command that sets something has no answer; [`Command::Error`] asks afterwards how it went.

use std::fmt;
use thiserror::Error;

/// The byte that stops all axes. The controller then reports error 10.
pub const STOP_ALL: u8 = 24;
/// Longer lines than this come from no controller.
pub const MAX_LINE_BYTES: usize = 1024;
/// More lines than this are in no answer to the commands here.
pub const MAX_LINES: usize = 64;

/// An answer that makes no sense, or a value that cannot be sent.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum CodecError {
    /// A name that no axis can have.
    #[error("{0:?} cannot be the name of an axis")]
    BadName(String),
    /// A number that is not finite, or too large for any stage.
    #[error("{0} cannot be sent as a number")]
    BadNumber(f64),
    /// The answer has another form.
    #[error("{answer:?} is no answer to {command}")]
    Unexpected {
        /// What was asked.
        command: &'static str,
        /// What came, shortened.
        answer: String,
    },
    /// An axis is missing in the answer, or there twice.
    #[error("the answer to {command} should name axis {axis} once")]
    Axis {
        /// What was asked.
        command: &'static str,
        /// The axis.
        axis: String,
    },
}

/// The controller's name of an axis: up to 16 printable characters, no space and no "=".
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct AxisName(String);

impl AxisName {
    /// Checks the name.
    ///
    /// # Errors
    /// [`CodecError::BadName`].
    pub fn new(name: &str) -> Result<Self, CodecError> {
        let fits = (1..=16).contains(&name.len())
            && name.bytes().all(|b| b.is_ascii_graphic() && b != b'=');
        if fits {
            Ok(Self(name.to_string()))
        } else {
            Err(CodecError::BadName(shortened(name)))
        }
    }
    /// As text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for AxisName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// One command. Values are in what the controller counts in, or that per second: millimetres and degrees unless it says otherwise.
#[derive(Debug, Clone, PartialEq)]
pub enum Command<'a> {
    /// Who it is. Answered by one line.
    Identify,
    /// The names of its axes. Answered by a line for each.
    Axes,
    /// Where axes are. Answered by `name=value`.
    Positions(&'a [AxisName]),
    /// Moves axes to places, together.
    Move(&'a [(AxisName, f64)]),
    /// Whether a platform can be brought to a place. Answered by 0 or 1.
    CanReach(&'a [(AxisName, f64)]),
    /// Whether axes are at their goals. Answered by `name=0` or `name=1`.
    OnTarget(&'a [AxisName]),
    /// Which axes move: one byte, answered by a hexadecimal bit mask.
    MotionStatus,
    /// Whether it can take commands: one byte, answered by one byte.
    Ready,
    /// Stops all axes abruptly: one byte, no answer.
    StopAll,
    /// The same as a line.
    Stop,
    /// Stops axes smoothly.
    Halt(&'a [AxisName]),
    /// The number of the last error, which is cleared by asking.
    Error,
    /// Lower ends of travel. Answered by `name=value`.
    LowerEnds(&'a [AxisName]),
    /// Upper ends of travel. Answered by `name=value`.
    UpperEnds(&'a [AxisName]),
    /// Whether axes know where they are. Answered by `name=0` or `name=1`; controllers of axes that always do may not know it.
    Referenced(&'a [AxisName]),
    /// What axes are counted in. Answered by `name=unit`; some controllers do not know it.
    Units(&'a [AxisName]),
    /// Starts a reference move. THE STAGE MOVES.
    Reference(&'a [AxisName]),
    /// Velocities of axes. Answered by `name=value`.
    Velocities(&'a [AxisName]),
    /// Sets velocities of axes.
    SetVelocities(&'a [(AxisName, f64)]),
    /// Velocity of a platform, mm/s. Answered by a number.
    PlatformVelocity,
    /// Sets the velocity of a platform, mm/s.
    SetPlatformVelocity(f64),
    /// The point that a platform turns about. Answered by `X=value` and so on.
    Pivot,
    /// Sets that point. Only with all rotations at zero.
    SetPivot([f64; 3]),
}

impl Command<'_> {
    /// The command's name for messages.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Identify => "*IDN?",
            Self::Axes => "SAI?",
            Self::Positions(_) => "POS?",
            Self::Move(_) => "MOV",
            Self::CanReach(_) => "VMO?",
            Self::OnTarget(_) => "ONT?",
            Self::MotionStatus => "#5",
            Self::Ready => "#7",
            Self::StopAll => "#24",
            Self::Stop => "STP",
            Self::Halt(_) => "HLT",
            Self::Error => "ERR?",
            Self::LowerEnds(_) => "TMN?",
            Self::UpperEnds(_) => "TMX?",
            Self::Referenced(_) => "FRF?",
            Self::Units(_) => "PUN?",
            Self::Reference(_) => "FRF",
            Self::Velocities(_) => "VEL?",
            Self::SetVelocities(_) => "VEL",
            Self::PlatformVelocity => "VLS?",
            Self::SetPlatformVelocity(_) => "VLS",
            Self::Pivot => "SPI?",
            Self::SetPivot(_) => "SPI",
        }
    }

    /// The bytes to send.
    ///
    /// # Errors
    /// [`CodecError::BadNumber`].
    pub fn encode(&self) -> Result<Vec<u8>, CodecError> {
        let mut line = self.name().to_string();
        match self {
            Self::MotionStatus => return Ok(vec![5]),
            Self::Ready => return Ok(vec![7]),
            Self::StopAll => return Ok(vec![STOP_ALL]),
            Self::Identify
            | Self::Axes
            | Self::Stop
            | Self::Error
            | Self::PlatformVelocity
            | Self::Pivot => {}
            Self::Positions(names)
            | Self::OnTarget(names)
            | Self::Halt(names)
            | Self::LowerEnds(names)
            | Self::UpperEnds(names)
            | Self::Referenced(names)
            | Self::Units(names)
            | Self::Reference(names)
            | Self::Velocities(names) => {
                for name in *names {
                    line.push(' ');
                    line.push_str(name.as_str());
                }
            }
            Self::Move(places) | Self::CanReach(places) | Self::SetVelocities(places) => {
                for (name, value) in *places {
                    line.push(' ');
                    line.push_str(name.as_str());
                    push_number(&mut line, *value)?;
                }
            }
            Self::SetPlatformVelocity(value) => push_number(&mut line, *value)?,
            Self::SetPivot(point) => {
                for (name, value) in ["X", "Y", "Z"].into_iter().zip(point) {
                    line.push(' ');
                    line.push_str(name);
                    push_number(&mut line, *value)?;
                }
            }
        }
        line.push('\n');
        Ok(line.into_bytes())
    }
}

/// Six decimals: a nanometre, or four thousandths of an arc second, where it counts in millimetres and degrees.
fn push_number(line: &mut String, value: f64) -> Result<(), CodecError> {
    if !(value.is_finite() && value.abs() < 1e9) {
        return Err(CodecError::BadNumber(value));
    }
    line.push_str(&format!(" {value:.6}"));
    Ok(())
}

fn shortened(text: &str) -> String {
    text.chars().take(80).collect()
}

fn unexpected(command: &'static str, answer: &str) -> CodecError {
    CodecError::Unexpected {
        command,
        answer: shortened(answer),
    }
}

/// A line of an answer, and whether another follows it.
pub fn line_and_more(line: &str) -> (&str, bool) {
    match line.strip_suffix(' ') {
        Some(line) => (line, true),
        None => (line, false),
    }
}

/// The only line of an answer.
///
/// # Errors
/// [`CodecError::Unexpected`].
pub fn one_line<'a>(command: &'static str, lines: &'a [String]) -> Result<&'a str, CodecError> {
    match lines {
        [line] => Ok(line),
        _ => Err(unexpected(command, &lines.join(" | "))),
    }
}

/// A number in the form that controllers send.
fn number(command: &'static str, text: &str) -> Result<f64, CodecError> {
    let plain = |b: u8| b.is_ascii_digit() || b"+-.eE".contains(&b);
    text.parse()
        .ok()
        .filter(|v: &f64| v.is_finite() && text.bytes().all(plain))
        .ok_or_else(|| unexpected(command, text))
}

/// One number alone.
///
/// # Errors
/// [`CodecError::Unexpected`].
pub fn decode_number(command: &'static str, lines: &[String]) -> Result<f64, CodecError> {
    number(command, one_line(command, lines)?.trim())
}

/// `name=value` for each of `names`, in their order. The lines may come in any other.
///
/// # Errors
/// [`CodecError::Unexpected`], [`CodecError::Axis`].
pub fn decode_values(
    command: &'static str,
    names: &[AxisName],
    lines: &[String],
) -> Result<Vec<f64>, CodecError> {
    let mut found = vec![None; names.len()];
    for line in lines {
        let (name, value) = line
            .split_once('=')
            .ok_or_else(|| unexpected(command, line))?;
        let at = names
            .iter()
            .position(|n| n.as_str() == name.trim())
            .ok_or_else(|| unexpected(command, line))?;
        let value = number(command, value.trim())?;
        if found[at].replace(value).is_some() {
            return Err(twice_or_missing(command, &names[at]));
        }
    }
    let all = found.into_iter().zip(names);
    all.map(|(value, name)| value.ok_or_else(|| twice_or_missing(command, name)))
        .collect()
}

/// `name=0` or `name=1` for each of `names`, in their order.
///
/// # Errors
/// As [`decode_values`].
pub fn decode_flags(
    command: &'static str,
    names: &[AxisName],
    lines: &[String],
) -> Result<Vec<bool>, CodecError> {
    decode_values(command, names, lines)?
        .into_iter()
        .map(|value| match value {
            0.0 => Ok(false),
            1.0 => Ok(true),
            other => Err(unexpected(command, &other.to_string())),
        })
        .collect()
}

/// What comes after `name=` for each of `names`, in their order, in whatever code it is written. The lines may come in any other.
///
/// # Errors
/// [`CodecError::Unexpected`], [`CodecError::Axis`].
pub fn decode_words(
    command: &'static str,
    names: &[AxisName],
    lines: &[Vec<u8>],
) -> Result<Vec<String>, CodecError> {
    let mut found = vec![None; names.len()];
    for line in lines {
        let text = match std::str::from_utf8(line) {
            Ok(text) => text.to_string(),
            // Of one byte for each character: Latin-1.
            Err(_) => line.iter().copied().map(char::from).collect(),
        };
        let (name, word) = text
            .split_once('=')
            .ok_or_else(|| unexpected(command, &text))?;
        let at = names.iter().position(|n| n.as_str() == name.trim());
        let at = at.ok_or_else(|| unexpected(command, &text))?;
        if found[at].replace(word.trim().to_string()).is_some() {
            return Err(twice_or_missing(command, &names[at]));
        }
    }
    let all = found.into_iter().zip(names);
    all.map(|(word, name)| word.ok_or_else(|| twice_or_missing(command, name)))
        .collect()
}

fn twice_or_missing(command: &'static str, axis: &AxisName) -> CodecError {
    CodecError::Axis {
        command,
        axis: axis.to_string(),
    }
}

/// The names of the axes.
///
/// # Errors
/// [`CodecError::BadName`], or [`CodecError::Unexpected`] when there is none.
pub fn decode_axes(lines: &[String]) -> Result<Vec<AxisName>, CodecError> {
    if lines.is_empty() {
        return Err(unexpected("SAI?", ""));
    }
    lines.iter().map(|l| AxisName::new(l.trim())).collect()
}

/// Whether any axis moves, from the hexadecimal mask, with or without "0x" before it.
///
/// # Errors
/// [`CodecError::Unexpected`].
pub fn decode_moving(lines: &[String]) -> Result<bool, CodecError> {
    let line = one_line("#5", lines)?.trim();
    let digits = line.strip_prefix("0x").unwrap_or(line);
    if !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
        return Err(unexpected("#5", line));
    }
    u64::from_str_radix(digits, 16)
        .map(|mask| mask != 0)
        .map_err(|_| unexpected("#5", line))
}

/// Whether the controller takes commands. The answer is not text: byte 177 for yes, 176 for no.
///
/// # Errors
/// [`CodecError::Unexpected`].
pub fn decode_ready(line: &[u8]) -> Result<bool, CodecError> {
    match line {
        [177] => Ok(true),
        [176] => Ok(false),
        _ => Err(unexpected("#7", &line.escape_ascii().to_string())),
    }
}

/// Whether a pose can be reached: one 0 or 1, or, from some firmware, one for each axis, all of which must be 1.
///
/// # Errors
/// [`CodecError::Unexpected`].
pub fn decode_reachable(lines: &[String]) -> Result<bool, CodecError> {
    if lines.is_empty() {
        return Err(unexpected("VMO?", ""));
    }
    let mut all = true;
    for line in lines {
        let value = line.split_once('=').map_or(line.as_str(), |(_, v)| v);
        all &= match value.trim() {
            "1" => true,
            "0" => false,
            _ => return Err(unexpected("VMO?", line)),
        };
    }
    Ok(all)
}

/// The number of the last error; 0 for none.
///
/// # Errors
/// [`CodecError::Unexpected`].
pub fn decode_error(lines: &[String]) -> Result<i32, CodecError> {
    let line = one_line("ERR?", lines)?.trim();
    line.parse().map_err(|_| unexpected("ERR?", line))
}

/// What an error number means and what to do, for those that matter here.
pub fn error_in_words(number: i32) -> String {
    let words = match number {
        0 => "no error",
        1 => "a parameter has the wrong form",
        2 => "the controller does not know the command",
        3 => "the command is too long",
        5 => "an axis is not homed or its servo is off; home the stage first",
        7 => "the position is out of limits or cannot be reached in this pose",
        8 => "the velocity is out of limits",
        9 => "the pivot point can only be set while all rotations are zero",
        10 => "the controller was stopped by a command",
        15 => "there is no axis of that name; look at the axis names in the settings",
        17 => "a parameter is out of range",
        23 => "an axis name is not allowed here",
        26 => "a parameter is missing",
        _ => "see the list of errors in the controller's manual",
    };
    format!("controller error {number}: {words}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(text: &str) -> Vec<AxisName> {
        text.split(' ').map(|n| AxisName::new(n).unwrap()).collect()
    }

    fn sent(command: &Command<'_>) -> String {
        String::from_utf8(command.encode().unwrap()).unwrap()
    }

    /// Bytes as they come, cut into the lines of one answer.
    fn answer(bytes: &str) -> Vec<String> {
        let mut lines = Vec::new();
        let mut all = bytes.split('\n');
        loop {
            let (line, more) = line_and_more(all.next().unwrap());
            lines.push(line.to_string());
            if !more {
                assert_eq!(all.collect::<Vec<_>>(), [""], "the answer ends here");
                return lines;
            }
        }
    }

    #[test]
    fn commands_are_written_as_the_controller_reads_them() {
        let xyz = names("X Y Z");
        let to = [
            (AxisName::new("X").unwrap(), 1.5),
            (AxisName::new("U").unwrap(), -0.25),
        ];
        for (command, bytes) in [
            (Command::Identify, "*IDN?\n"),
            (Command::Axes, "SAI?\n"),
            (Command::Positions(&xyz), "POS? X Y Z\n"),
            (Command::Move(&to), "MOV X 1.500000 U -0.250000\n"),
            (Command::CanReach(&to), "VMO? X 1.500000 U -0.250000\n"),
            (Command::OnTarget(&xyz), "ONT? X Y Z\n"),
            (Command::MotionStatus, "\u{5}"),
            (Command::Ready, "\u{7}"),
            (Command::StopAll, "\u{18}"),
            (Command::Stop, "STP\n"),
            (Command::Halt(&xyz), "HLT X Y Z\n"),
            (Command::Error, "ERR?\n"),
            (Command::LowerEnds(&xyz), "TMN? X Y Z\n"),
            (Command::UpperEnds(&xyz), "TMX? X Y Z\n"),
            (Command::Referenced(&xyz), "FRF? X Y Z\n"),
            (Command::Units(&xyz), "PUN? X Y Z\n"),
            (Command::Reference(&xyz), "FRF X Y Z\n"),
            (Command::Velocities(&xyz[..1]), "VEL? X\n"),
            (Command::SetVelocities(&to), "VEL X 1.500000 U -0.250000\n"),
            (Command::PlatformVelocity, "VLS?\n"),
            (Command::SetPlatformVelocity(5.0), "VLS 5.000000\n"),
            (Command::Pivot, "SPI?\n"),
            (
                Command::SetPivot([0.0, -1.0, 20.5]),
                "SPI X 0.000000 Y -1.000000 Z 20.500000\n",
            ),
        ] {
            assert_eq!(sent(&command), bytes);
        }
    }

    #[test]
    fn numbers_that_are_none_are_not_sent() {
        for value in [f64::NAN, f64::INFINITY, 1e9, -1e12] {
            let to = [(AxisName::new("X").unwrap(), value)];
            assert!(Command::Move(&to).encode().is_err(), "{value}");
            assert!(Command::SetPlatformVelocity(value).encode().is_err());
        }
    }

    #[test]
    fn names_that_would_break_a_line_are_refused() {
        for name in ["", "X Y", "X\n", "X=", "Ä", "ABCDEFGHIJKLMNOPQ"] {
            assert!(AxisName::new(name).is_err(), "{name:?}");
        }
        assert_eq!(AxisName::new("1").unwrap().as_str(), "1");
    }

    #[test]
    fn a_hexapods_answers_are_read() {
        let axes = decode_axes(&answer("X \nY \nZ \nU \nV \nW\n")).unwrap();
        assert_eq!(axes, names("X Y Z U V W"));
        let at = answer("X=1.2345 \nY=-0.0001 \nZ=0 \nU=1e-3 \nV=0.0000 \nW=+2.5\n");
        assert_eq!(
            decode_values("POS?", &axes, &at).unwrap(),
            [1.2345, -0.0001, 0.0, 1e-3, 0.0, 2.5]
        );
        let known = answer("X=1 \nY=1 \nZ=0 \nU=1 \nV=1 \nW=1\n");
        assert_eq!(
            decode_flags("FRF?", &axes, &known).unwrap(),
            [true, true, false, true, true, true]
        );
        assert!(!decode_moving(&answer("0\n")).unwrap());
        assert!(decode_moving(&answer("3F\n")).unwrap());
        assert!(decode_moving(&answer("0x3f\n")).unwrap());
        assert_eq!(decode_error(&answer("10\n")).unwrap(), 10);
        assert_eq!(decode_error(&answer("-1024\n")).unwrap(), -1024);
        assert_eq!(decode_number("VLS?", &answer("5.0000\n")).unwrap(), 5.0);
        assert!(decode_ready(&[177]).unwrap());
        assert!(!decode_ready(&[176]).unwrap());
    }

    #[test]
    fn units_are_read_in_whatever_code_they_come() {
        let lines = |all: &[&[u8]]| -> Vec<Vec<u8>> { all.iter().map(|l| l.to_vec()).collect() };
        let xyu = names("X Y U");
        let answer = lines(&[b"Y=\xb5m", b"X = UM", b"U=\xc2\xb0"]);
        assert_eq!(
            decode_words("PUN?", &xyu, &answer).unwrap(),
            ["UM", "\u{b5}m", "\u{b0}"]
        );
        for wrong in [
            &[&b"X=MM"[..], b"Y=MM"][..],
            &[b"X=MM", b"Y=MM", b"U=DEG", b"X=MM"],
            &[b"X=MM", b"Y=MM", b"Z=MM"],
            &[b"MM", b"MM", b"DEG"],
        ] {
            assert!(decode_words("PUN?", &xyu, &lines(wrong)).is_err());
        }
    }

    #[test]
    fn both_forms_of_the_virtual_moves_answer_are_read() {
        assert!(decode_reachable(&answer("1\n")).unwrap());
        assert!(!decode_reachable(&answer("0\n")).unwrap());
        assert!(decode_reachable(&answer("X=1 \nU=1\n")).unwrap());
        assert!(!decode_reachable(&answer("X=1 \nU=0\n")).unwrap());
        assert!(decode_reachable(&answer("2\n")).is_err());
        assert!(decode_reachable(&[]).is_err());
    }

    #[test]
    fn answers_that_are_not_to_the_question_are_refused() {
        let xy = names("X Y");
        for wrong in [
            "X=1 \nX=2\n",
            "X=1\n",
            "X=1 \nY=2 \nZ=3\n",
            "X=1 \nY=\n",
            "X=1 \nY=nan\n",
            "X=1 \nY=inf\n",
            "X=1 \nY=1,5\n",
            "X 1 \nY 2\n",
            "0\n",
        ] {
            assert!(
                decode_values("POS?", &xy, &answer(wrong)).is_err(),
                "{wrong:?}"
            );
        }
        assert!(decode_flags("ONT?", &xy, &answer("X=1 \nY=2\n")).is_err());
        assert!(decode_moving(&answer("+1\n")).is_err());
        assert!(decode_moving(&answer("\n")).is_err());
        assert!(decode_moving(&answer("0 \n0\n")).is_err());
        assert!(decode_error(&answer("none\n")).is_err());
        assert!(decode_ready(b"").is_err());
        assert!(decode_ready(&[177, 177]).is_err());
    }

    #[test]
    fn errors_that_matter_are_told_in_words() {
        for number in [0, 1, 2, 5, 7, 8, 9, 10, 15, 17, 23, 26] {
            let words = error_in_words(number);
            assert!(words.contains(&number.to_string()), "{words}");
            assert!(!words.contains("manual"), "{words}");
        }
        assert!(error_in_words(-1024).contains("manual"));
    }
}

//! Commands to bytes and answers to values. No input, no output, no state.
//!
//! Commands and answers are lines; every command here has an answer of one line. Positions are whole steps.

use thiserror::Error;

/// Ends the move under way. Answered by a line with "abort" in it.
pub const STOP: &[u8] = b"stop\n";
/// Longer lines than this come from no board.
pub const MAX_LINE_BYTES: usize = 256;
/// The board counts with 32 bits.
pub const MAX_STEPS: i64 = i32::MAX as i64;

/// An answer that makes no sense, or a value that cannot be sent.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum CodecError {
    /// More steps than the board can count.
    #[error("{0} steps are more than the board can count")]
    TooFar(i64),
    /// The answer has another form.
    #[error("{answer:?} is no answer to {command}")]
    Unexpected {
        /// What was asked.
        command: &'static str,
        /// What came, shortened.
        answer: String,
    },
}

/// One command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// What the firmware is.
    Version,
    /// Whether a move keeps the board from hearing.
    IsBlocking,
    /// Moves do not keep the board from hearing, from now on and after the next start.
    DoNotBlock,
    /// Where it is.
    Position,
    /// Moves by so many steps of x, y and z.
    MoveBy([i64; 3]),
    /// Whether it moves.
    IsMoving,
    /// How long a step takes at the least.
    StepTime,
    /// Steps take so long at the least, us, in moves that begin from now on, and after the next start.
    SetStepTime(i64),
    /// Takes the current off the motors. They may then jump by some steps.
    Release,
}

impl Command {
    /// The command's name for messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Version => "version",
            Self::IsBlocking => "blocking_moves?",
            Self::DoNotBlock => "blocking_moves false",
            Self::Position => "p?",
            Self::MoveBy(_) => "mr",
            Self::IsMoving => "moving?",
            Self::StepTime => "dt?",
            Self::SetStepTime(_) => "dt",
            Self::Release => "release",
        }
    }

    /// The bytes to send.
    ///
    /// # Errors
    /// [`CodecError::TooFar`].
    pub fn encode(self) -> Result<Vec<u8>, CodecError> {
        let steps = match self {
            Self::MoveBy(steps) => steps,
            Self::SetStepTime(us) => return Ok(format!("dt {us}\n").into_bytes()),
            _ => return Ok(format!("{}\n", self.name()).into_bytes()),
        };
        if let Some(far) = steps
            .into_iter()
            .find(|s| !(-MAX_STEPS..=MAX_STEPS).contains(s))
        {
            return Err(CodecError::TooFar(far));
        }
        let [x, y, z] = steps;
        Ok(format!("mr {x} {y} {z}\n").into_bytes())
    }
}

fn unexpected(command: Command, answer: &str) -> CodecError {
    CodecError::Unexpected {
        command: command.name(),
        answer: answer.chars().take(80).collect(),
    }
}

/// The firmware's name, which must say that it is a Sangaboard's.
///
/// # Errors
/// [`CodecError::Unexpected`].
pub fn decode_version(line: &str) -> Result<String, CodecError> {
    let line = line.trim();
    if line.to_ascii_lowercase().contains("sangaboard") {
        Ok(line.to_string())
    } else {
        Err(unexpected(Command::Version, line))
    }
}

/// Whether moves block; `None` when the firmware does not know the question.
pub fn decode_blocking(line: &str) -> Option<bool> {
    match line.trim().strip_prefix("blocking_moves ")?.trim() {
        "true" => Some(true),
        "false" => Some(false),
        _ => None,
    }
}

/// Three numbers of steps.
///
/// # Errors
/// [`CodecError::Unexpected`].
pub fn decode_position(line: &str) -> Result<[i64; 3], CodecError> {
    let no = || unexpected(Command::Position, line);
    let mut steps = [0; 3];
    let mut words = line.split_ascii_whitespace();
    for step in &mut steps {
        let value: i32 = words.next().and_then(|w| w.parse().ok()).ok_or_else(no)?;
        *step = i64::from(value);
    }
    match words.next() {
        None => Ok(steps),
        Some(_) => Err(no()),
    }
}

/// Whether it moves.
///
/// # Errors
/// [`CodecError::Unexpected`].
pub fn decode_moving(line: &str) -> Result<bool, CodecError> {
    match line.trim() {
        "true" => Ok(true),
        "false" => Ok(false),
        other => Err(unexpected(Command::IsMoving, other)),
    }
}

/// How long a step takes at the least, us; `None` when the firmware does not know the question.
pub fn decode_step_time(line: &str) -> Option<i64> {
    let us = line.trim().strip_prefix("minimum step delay ")?;
    let us: i32 = us.trim().parse().ok()?;
    (us > 0).then_some(i64::from(us))
}

/// "done", with or without a full stop.
///
/// # Errors
/// [`CodecError::Unexpected`].
pub fn decode_done(command: Command, line: &str) -> Result<(), CodecError> {
    match line.trim() {
        "done" | "done." => Ok(()),
        other => Err(unexpected(command, other)),
    }
}

/// The answer to a stop.
///
/// # Errors
/// [`CodecError::Unexpected`] when the firmware does not know it.
pub fn decode_stopped(line: &str) -> Result<(), CodecError> {
    if line.to_ascii_lowercase().contains("abort") {
        return Ok(());
    }
    Err(CodecError::Unexpected {
        command: "stop",
        answer: line.chars().take(80).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_written_as_the_board_reads_them() {
        for (command, line) in [
            (Command::Version, "version\n"),
            (Command::IsBlocking, "blocking_moves?\n"),
            (Command::DoNotBlock, "blocking_moves false\n"),
            (Command::Position, "p?\n"),
            (Command::MoveBy([100, -20, 0]), "mr 100 -20 0\n"),
            (Command::IsMoving, "moving?\n"),
            (Command::StepTime, "dt?\n"),
            (Command::SetStepTime(1250), "dt 1250\n"),
            (Command::Release, "release\n"),
        ] {
            assert_eq!(command.encode().unwrap(), line.as_bytes());
        }
        assert!(
            Command::MoveBy([0, i64::from(i32::MIN), 0])
                .encode()
                .is_err()
        );
        assert!(Command::MoveBy([MAX_STEPS, 0, -MAX_STEPS]).encode().is_ok());
    }

    #[test]
    fn a_boards_answers_are_read() {
        assert!(decode_version("Sangaboard Firmware v1.0.1-dev").is_ok());
        assert_eq!(decode_blocking("blocking_moves true"), Some(true));
        assert_eq!(decode_blocking("blocking_moves false"), Some(false));
        assert_eq!(decode_position("12000 -350 0"), Ok([12000, -350, 0]));
        assert_eq!(decode_moving("true"), Ok(true));
        assert_eq!(decode_moving("false"), Ok(false));
        assert_eq!(decode_step_time("minimum step delay 1000"), Some(1000));
        assert!(decode_done(Command::Release, "done").is_ok());
        assert!(decode_done(Command::DoNotBlock, "done.").is_ok());
        assert!(decode_stopped("Move aborted").is_ok());
        assert!(decode_stopped("aborted").is_ok());
    }

    #[test]
    fn answers_that_are_not_to_the_question_are_refused() {
        let help = "Type 'help' for a list of commands.";
        assert!(decode_version(help).is_err());
        assert_eq!(decode_blocking(help), None);
        assert_eq!(decode_blocking("blocking_moves maybe"), None);
        for wrong in ["", "1 2", "1 2 3 4", "1 2 x", "1.0 2 3", "99999999999 0 0"] {
            assert!(decode_position(wrong).is_err(), "{wrong:?}");
        }
        for wrong in [
            help,
            "",
            "minimum step delay",
            "1000",
            "minimum step delay -1",
        ] {
            assert_eq!(decode_step_time(wrong), None, "{wrong:?}");
        }
        assert!(decode_moving("1").is_err());
        assert!(decode_done(Command::Release, help).is_err());
        assert!(decode_stopped(help).is_err());
    }
}

//! Talking with a controller: questions, the lines of their answers, and what its error numbers mean.

use crate::gcs2::codec::{self, AxisName, CodecError, Command};
use crate::link::shown;
use crate::session::{Exchange, device, refused};
use scopeservo_scope::ScopeError;

/// A controller that was told to stop reports this.
pub(super) const STOPPED_BY_COMMAND: i32 = 10;

/// It does not know a command.
const NOT_KNOWN: i32 = 2;

/// So does one whose axes do not know where they are.
const NOT_REFERENCED: i32 = 5;

/// What it reports of a command that it could read and will not carry out: a place out of reach, a velocity, a pivot, a number out of
/// range.
const REFUSALS: [i32; 4] = [7, 8, 9, 17];

pub(super) fn not_homed() -> ScopeError {
    ScopeError::NotHomed { device: "stage" }
}

/// What an error number of the controller in answer to a command means for the caller: the command was refused, was stopped, or was
/// none, which is a fault of ours.
pub(super) fn refusal(number: i32) -> ScopeError {
    match number {
        STOPPED_BY_COMMAND => ScopeError::Interrupted { at: None },
        NOT_REFERENCED => not_homed(),
        number if REFUSALS.contains(&number) => refused(codec::error_in_words(number)),
        other => device(codec::error_in_words(other)),
    }
}

/// A decoded answer, or the end of the link.
pub(super) fn read<T>(ex: &Exchange<'_>, decoded: Result<T, CodecError>) -> Result<T, ScopeError> {
    decoded.map_err(|e| ex.nonsense(e))
}

/// Sends a question.
fn put(ex: &mut Exchange<'_>, command: &Command<'_>) -> Result<(), ScopeError> {
    let bytes = read(ex, command.encode())?;
    ex.send(&bytes)
}

/// A question and the lines of its answer.
pub(super) fn ask(ex: &mut Exchange<'_>, command: &Command<'_>) -> Result<Vec<String>, ScopeError> {
    put(ex, command)?;
    let deadline = ex.deadline();
    let mut lines = Vec::new();
    loop {
        let raw = ex.line(deadline)?;
        let (line, more) = codec::line_and_more(&raw);
        lines.push(line.to_string());
        if !more {
            break;
        }
        not_endless(ex, command, lines.len())?;
    }
    complete(ex, command)?;
    Ok(lines)
}

/// A question that not every controller knows, and the bytes of the lines of its answer; `None` where the controller does not know it. Such a
/// question has no answer, so that the number of the error is asked for with it.
pub(super) fn ask_if_known(
    ex: &mut Exchange<'_>,
    command: &Command<'_>,
) -> Result<Option<Vec<Vec<u8>>>, ScopeError> {
    let both = [command, &Command::Error].map(Command::encode);
    let mut bytes = Vec::new();
    for part in both {
        bytes.extend(read(ex, part)?);
    }
    ex.send(&bytes)?;
    let deadline = ex.deadline();
    let mut lines = Vec::new();
    loop {
        let mut line = ex.line_bytes(deadline)?;
        let more = line.last() == Some(&b' ');
        line.truncate(line.len() - usize::from(more));
        lines.push(line);
        if !more {
            break;
        }
        not_endless(ex, command, lines.len())?;
    }
    // The answer names axes, the number of an error none.
    let known = lines.iter().any(|line| line.contains(&b'='));
    let number = match known {
        true => ex.line(deadline)?,
        false => lines.iter().map(|l| shown(l)).collect(),
    };
    complete(ex, command)?;
    match (known, read(ex, codec::decode_error(&[number]))?) {
        (true, _) => Ok(Some(lines)),
        (false, NOT_KNOWN) => Ok(None),
        (false, number) => Err(device(format!(
            "it does not answer {}: {}",
            command.name(),
            codec::error_in_words(number)
        ))),
    }
}

/// A question that not every controller knows and whose answer is one number, which is given with its digits; `None` where the controller does not
/// know it.
pub(super) fn number_if_known(
    ex: &mut Exchange<'_>,
    command: &Command<'_>,
) -> Result<Option<(f64, String)>, ScopeError> {
    let both = [command, &Command::Error].map(Command::encode);
    let mut bytes = Vec::new();
    for part in both {
        bytes.extend(read(ex, part)?);
    }
    ex.send(&bytes)?;
    let deadline = ex.deadline();
    let said = ex.line(deadline)?.trim().to_string();
    // The number of an error alone, or a number and then that of an error: a velocity may be whole, too.
    let error = match said.parse::<i32>() {
        Ok(_) => ex.line_if_any(deadline)?,
        Err(_) => Some(ex.line(deadline)?),
    };
    complete(ex, command)?;
    let Some(error) = error else {
        return Ok(None);
    };
    let value = read(
        ex,
        codec::decode_number(command.name(), std::slice::from_ref(&said)),
    )?;
    match read(ex, codec::decode_error(&[error]))? {
        0 | STOPPED_BY_COMMAND => Ok(Some((value, said))),
        number => Err(device(codec::error_in_words(number))),
    }
}

fn not_endless(ex: &Exchange<'_>, command: &Command<'_>, lines: usize) -> Result<(), ScopeError> {
    if lines < codec::MAX_LINES {
        return Ok(());
    }
    Err(ex.nonsense(format!(
        "more than {} lines to {}",
        codec::MAX_LINES,
        command.name()
    )))
}

fn complete(ex: &Exchange<'_>, command: &Command<'_>) -> Result<(), ScopeError> {
    if ex.has_more() {
        return Err(ex.nonsense(format!("more came than the answer to {}", command.name())));
    }
    Ok(())
}

pub(super) fn ready(ex: &mut Exchange<'_>) -> Result<bool, ScopeError> {
    put(ex, &Command::Ready)?;
    let line = ex.line_bytes(ex.deadline())?;
    complete(ex, &Command::Ready)?;
    read(ex, codec::decode_ready(&line))
}

pub(super) fn moving(ex: &mut Exchange<'_>) -> Result<bool, ScopeError> {
    let lines = ask(ex, &Command::MotionStatus)?;
    read(ex, codec::decode_moving(&lines))
}

pub(super) fn error_number(ex: &mut Exchange<'_>) -> Result<i32, ScopeError> {
    let lines = ask(ex, &Command::Error)?;
    read(ex, codec::decode_error(&lines))
}

pub(super) fn values(
    ex: &mut Exchange<'_>,
    command: &Command<'_>,
    names: &[AxisName],
) -> Result<Vec<f64>, ScopeError> {
    let lines = ask(ex, command)?;
    read(ex, codec::decode_values(command.name(), names, &lines))
}

pub(super) fn all_set(
    ex: &mut Exchange<'_>,
    command: &Command<'_>,
    names: &[AxisName],
) -> Result<bool, ScopeError> {
    let lines = ask(ex, command)?;
    let flags = read(ex, codec::decode_flags(command.name(), names, &lines))?;
    Ok(flags.into_iter().all(|set| set))
}

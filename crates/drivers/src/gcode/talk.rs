//! Talking with a board: lines with numbers, sent again while they arrive damaged, and what comes until they are done.

use crate::gcode::codec::{self, Command, Line, Report};
use crate::gcode::settings::Motor;
use crate::session::{Exchange, bad_setting, device, lock, refused};
use scopeservo_scope::{ScopeError, visible};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// How often a damaged line is sent again.
const SENDINGS: usize = 4;
/// How often it is asked where it is, when the answer arrives damaged.
const ASKINGS: usize = 3;
/// What the board's two decimals of a millimetre hide.
pub(super) const PLAN_TOLERANCE_MM: f64 = 0.011;

/// What a board said before its "ok".
#[derive(Debug, Default)]
pub(super) struct Answer {
    pub(super) report: Option<Report>,
    pub(super) emergency_parser: bool,
    pub(super) firmware: Option<String>,
}

/// Sends commands with numbers and reads what comes until they are done.
pub(super) struct Talk {
    /// The number of the last line sent; `None` without checksums.
    last: Mutex<Option<u32>>,
    busy_timeout: Duration,
}

impl Talk {
    pub(super) fn new(checksums: bool, busy_timeout: Duration) -> Self {
        Self {
            last: Mutex::new(checksums.then_some(0)),
            busy_timeout,
        }
    }

    pub(super) fn next(&self) -> Option<u32> {
        let mut last = lock(&self.last);
        if let Some(number) = &mut *last {
            *number += 1;
        }
        *last
    }

    /// The board has not taken the last line.
    pub(super) fn take_back(&self) {
        if let Some(number) = &mut *lock(&self.last) {
            *number = number.saturating_sub(1);
        }
    }

    /// One command, sent again while it arrives damaged; a move is not sent when a stop came after `stops`.
    pub(super) fn ask(
        &self,
        ex: &mut Exchange<'_>,
        command: &Command<'_>,
        stops: Option<u64>,
    ) -> Result<Answer, ScopeError> {
        let number = match command {
            // This is the one that sets the numbers.
            Command::StartNumbers => *lock(&self.last),
            _ => self.next(),
        };
        let bytes = match command.encode(number) {
            Ok(bytes) => bytes,
            Err(e) => {
                self.take_back();
                return Err(bad_setting(e.to_string()));
            }
        };
        for _ in 0..SENDINGS {
            let sent = match stops {
                Some(stops) => ex.send_unless_stopped(&bytes, stops),
                None => ex.send(&bytes),
            };
            if let Err(e) = sent {
                self.take_back();
                return Err(e);
            }
            let owed = ex.take_owed();
            let no = |why| of_command(command, why);
            if let Some(answer) = self.answer(ex, owed, number, &no)? {
                return Ok(answer);
            }
        }
        Err(ex.nonsense(format!("a line arrived damaged {SENDINGS} times")))
    }

    /// Reads until the board is done with `owed` stops and the line with `number`. `None`: the line arrived damaged.
    /// `no` is what it means that the board will not carry it out.
    pub(super) fn answer(
        &self,
        ex: &mut Exchange<'_>,
        mut owed: u32,
        number: Option<u32>,
        no: &dyn Fn(String) -> ScopeError,
    ) -> Result<Option<Answer>, ScopeError> {
        let give_up = Instant::now() + self.busy_timeout;
        let mut deadline = ex.deadline();
        let mut answer = Answer::default();
        let (mut damaged, mut refused) = (false, None);
        loop {
            let line = ex.line(deadline.min(give_up))?;
            match codec::decode(&line) {
                Line::Ok(_) if owed > 0 => owed -= 1,
                Line::Ok(report) => {
                    if report.is_none() && line.trim() != "ok" {
                        ex.pass_over(&line);
                    }
                    answer.report = answer.report.or(report);
                    return match refused {
                        _ if damaged => Ok(None),
                        None => Ok(Some(answer)),
                        Some(why) => Err(no(why)),
                    };
                }
                Line::Busy => deadline = ex.deadline(),
                Line::Resend(wanted) => damaged = self.wanted(ex, wanted, number)?,
                Line::Refused(why) => {
                    // Some firmware says no more after that.
                    ex.pass_over(&line);
                    refused = Some(why);
                }
                Line::Position(report) => answer.report = Some(report),
                Line::Firmware(name) => answer.firmware = Some(name),
                Line::Capability(name, can) => {
                    answer.emergency_parser |= can && name == "EMERGENCY_PARSER";
                }
                Line::Start => return Err(restarted(ex)),
                Line::Error(why) => return Err(ex.nonsense(format!("the board says: {why}"))),
                Line::Damaged(_) | Line::Other(_) => ex.pass_over(&line),
            }
        }
    }

    /// Whether the line wanted again is the one that was sent; another one nobody has any more.
    pub(super) fn wanted(
        &self,
        ex: &Exchange<'_>,
        wanted: u32,
        number: Option<u32>,
    ) -> Result<bool, ScopeError> {
        // Line 0 starts the numbers: until it arrives the board goes on from those of the driver before.
        if Some(wanted) == number || number == Some(0) {
            return Ok(true);
        }
        Err(ex.nonsense(format!("the board wants line {wanted} again")))
    }

    /// Waits for the answers to stops.
    pub(super) fn settle_owed(&self, ex: &mut Exchange<'_>) -> Result<(), ScopeError> {
        match ex.take_owed_now() {
            0 => Ok(()),
            owed => self.answer(ex, owed - 1, None, &device).map(|_| ()),
        }
    }

    /// Where it is, asked again when the answer arrives damaged.
    pub(super) fn position(&self, ex: &mut Exchange<'_>) -> Result<Report, ScopeError> {
        for _ in 1..ASKINGS {
            if let Some(report) = self.ask(ex, &Command::Position, None)?.report
                && !report.steps.is_empty()
            {
                return Ok(report);
            }
        }
        let answer = self.ask(ex, &Command::Position, None)?;
        let unread = || {
            let came = ex.passed_over();
            ex.nonsense(format!("no position that can be read (M114){came}"))
        };
        let report = answer.report.ok_or_else(unread)?;
        if report.steps.is_empty() {
            return Err(ex.nonsense(format!(
                "the position (M114) does not say in steps where the steppers are (Count X:0 Y:0 Z:0), by which a stop or an obstacle is \
                 seen; it is '{}'",
                visible(&report.said)
            )));
        }
        Ok(report)
    }
}

/// What a board says of a line that it read and will not carry out: of a move it is a refusal, of anything else a board that cannot do
/// what it must.
fn of_command(command: &Command<'_>, why: String) -> ScopeError {
    match command {
        Command::Move { .. } if codec::wants_homing(&why) => {
            ScopeError::NotHomed { device: "stage" }
        }
        Command::Move { .. } => refused(why),
        _ => device(why),
    }
}

pub(super) fn restarted(ex: &Exchange<'_>) -> ScopeError {
    ex.nonsense("the board started anew and no longer knows where the stage is")
}

pub(super) fn steps_of(
    ex: &Exchange<'_>,
    report: &Report,
    motor: &Motor,
) -> Result<i64, ScopeError> {
    report.steps_of(motor.letter).ok_or_else(|| {
        ex.nonsense(format!(
            "the position (M114) does not count the steps of {}: it is '{}'",
            motor.letter,
            visible(&report.said)
        ))
    })
}

//! The report of a calibration, a focus or a tilt, whether it succeeded or not.

use crate::error::CliError;
use crate::open_instrument::OpenInstrument;
use crate::output;
use crate::progress::Watcher;
use scopeservo_report::{Context, Failure, Work, WorkEnd, work_html};
use scopeservo_servo::ErrorKind;
use std::time::Instant;

/// Why it failed, where it did.
pub(super) fn failure<T>(output: &Result<T, CliError>) -> Option<Failure> {
    let error = output.as_ref().err()?;
    let stopped =
        |e: &CliError| matches!(e, CliError::Servo(e) if e.kind() == ErrorKind::Interruption);
    Some(Failure {
        message: error.to_string(),
        stopped: stopped(error),
    })
}

/// The page of what was done since then.
pub(super) fn work_page(
    opened: &OpenInstrument,
    watcher: &Watcher,
    end: &WorkEnd,
    since: Instant,
) -> String {
    let what = match end.work {
        Work::Calibration => "Calibration",
        Work::Focus => "Focus",
        Work::Level => "Tilt",
    };
    let context = Context {
        title: format!("{what} of {}", opened.config.name),
        wall_time_s: Some(since.elapsed().as_secs_f64()),
        ..context(opened)
    };
    work_html(&watcher.recorder, end, &context)
}

/// What every page says of an instrument and of how it was made.
pub(super) fn context(opened: &OpenInstrument) -> Context {
    opened.page_context(output::command_line())
}

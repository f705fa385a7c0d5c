//! The report of a calibration or a focus, whether it succeeded or not.

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
    };
    let context = Context {
        title: format!("{what} of {}", opened.config.name),
        instrument: opened.config.name.clone(),
        simulated: opened.is_simulated(),
        command: output::command_line(),
        version: env!("CARGO_PKG_VERSION").into(),
        wall_time_s: Some(since.elapsed().as_secs_f64()),
        ..Context::default()
    };
    work_html(&watcher.recorder, end, &context)
}

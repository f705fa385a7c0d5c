//! The report of a calibration or a focus, whether it succeeded or not.

use super::calibration_of;
use crate::error::CliError;
use crate::open_instrument::OpenInstrument;
use crate::output;
use crate::progress::Watcher;
use scopeservo_library::Calibrations as _;
use scopeservo_report::{Context, Failure, InUse, Work, WorkEnd, work_html};
use scopeservo_scope::Objective;
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

/// What every page says: when, of which instrument over what, where the stage stands, and by which calibrations.
pub(super) fn about(opened: &OpenInstrument) -> Context {
    let gate = opened.scope.gate();
    let file = |objective: &Objective| {
        let path = opened.library.calibration_path(&objective.id).ok()??;
        let kept = calibration_of(opened, objective).ok()??;
        Some(InUse {
            objective: objective.id.0.clone(),
            file: path.display().to_string(),
            um_per_px: kept.calibration.um_per_px(),
        })
    };
    Context {
        date: output::date(),
        specimen: opened.specimen(),
        instrument: opened.config.name.clone(),
        place: gate
            .last_reported()
            .map_or(String::new(), |at| at.to_string()),
        calibrations: gate.objectives().iter().filter_map(file).collect(),
        simulated: opened.is_simulated(),
        command: output::command_line(),
        version: env!("CARGO_PKG_VERSION").into(),
        ..Context::default()
    }
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
        wall_time_s: Some(since.elapsed().as_secs_f64()),
        ..about(opened)
    };
    work_html(&watcher.recorder, end, &context)
}

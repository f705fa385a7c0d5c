//! The report of a calibration, a focus or a tilt, whether it succeeded or not.

use crate::error::CliError;
use crate::open_instrument::OpenInstrument;
use crate::output;
use crate::progress::Watcher;
use scopeservo_library::{CalibrationFile, Calibrations as _, KeptCalibration};
use scopeservo_report::{Context, Failure, Stored, Work, WorkEnd, work_html};
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
    Context {
        specimen: opened.specimen(),
        instrument: opened.config.name.clone(),
        simulated: opened.is_simulated(),
        command: output::command_line(),
        version: env!("CARGO_PKG_VERSION").into(),
        date: output::date(),
        stored: stored(opened),
        ..Context::default()
    }
}

/// The calibrations of this instrument and camera that are kept, the newest of each objective. One that is damaged was told of before.
fn stored(opened: &OpenInstrument) -> Vec<Stored> {
    let info = opened.scope.camera().info();
    let fits = |kept: &KeptCalibration| {
        kept.instrument == opened.config.name
            && kept.calibration.image_size_px == [info.width, info.height]
    };
    let history = opened.library.calibration_history().unwrap_or_default();
    let newest = |files: Vec<CalibrationFile>| {
        files
            .into_iter()
            .rev()
            .find_map(|CalibrationFile { path, kept }| {
                let kept = kept.ok().filter(fits)?;
                Some(Stored {
                    calibration: kept.calibration,
                    file: path.display().to_string(),
                    made: output::readable(&kept.made),
                })
            })
    };
    history.into_iter().filter_map(newest).collect()
}

//! The commands that work with an instrument: what the user asked becomes a job of the station, and its answer words.

mod calibrate;
mod check;
mod focus;
mod grid;
mod level;
mod report;
mod reposition;
mod resume;
mod save_target;

pub(crate) use calibrate::calibrate;
pub(crate) use check::check;
pub(crate) use focus::focus;
pub(crate) use grid::grid;
pub(crate) use level::level;
pub(crate) use reposition::reposition;
pub(crate) use resume::{abandon, resume};
pub(crate) use save_target::save_target;

use crate::answer::Answer;
use crate::args::ConfigArgs;
use crate::bar;
use crate::error::CliError;
use crate::open_instrument::OpenInstrument;
use scopeservo_library::Database;
use scopeservo_servo::Calibration;
use scopeservo_setup::Config;

/// Where the instrument's calibrations and targets are kept. What files of an earlier version lie there is taken in.
pub(crate) fn library_of(description: &ConfigArgs, answer: &Answer) -> Result<Database, CliError> {
    let config = Config::read(&description.config)?;
    let library = Database::new(config.resolve(&config.data_folder));
    let shown = bar::Parts::new("taking in what an earlier version kept");
    for wrong in library.take_in(&mut |done, all| shown.done(done, all))? {
        answer.or_warn::<()>(Err(wrong));
    }
    Ok(library)
}

/// The calibrations that this instrument and camera made. One that is damaged is measured again on the way.
fn known_calibrations(opened: &OpenInstrument, answer: &Answer) -> Vec<Calibration> {
    opened.known_calibrations(|unread| {
        answer.or_warn::<()>(Err(unread));
    })
}

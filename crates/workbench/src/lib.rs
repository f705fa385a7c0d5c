//! An instrument opened from its description, with what its library knows of it: where every front end works, be it a terminal or a server.
//!
//! A [`Workbench`] is the open instrument; [`FileJournal`] keeps what its jobs are at, a [`RunRecord`] what they told and answered. How that
//! is shown is the front end's.

#![warn(clippy::too_many_lines)]

mod calibrations;
mod console;
mod journal;
mod known;
mod page;
mod record;
mod specimen;
mod targets;
mod usual;
mod workbench;

pub use console::{Console, Late, Told};
pub use journal::{Asked, FileJournal, Made, contradiction, standing, what};
pub use page::readable;
pub use record::{RunRecord, label_of};
pub use specimen::LayError;
pub use usual::Usual;
pub use workbench::{OpenError, Workbench};

//! What is kept: targets, calibrations, the shadows on cameras, what every run did, and the journal of the one under way.
//!
//! Each is a trait. [`Database`] keeps all of them but the journal: rows in SQLite, and beside it what is large, in files that are called by
//! their checksums. [`Folder`] keeps journals, and is what earlier versions kept and what [`Database::export`] writes: plain files. Nothing is
//! overwritten but the journal. A file is there whole or not at all ([`files`]), and what is damaged is told, and does not keep the rest away.

#![warn(clippy::too_many_lines)]

mod calibrations;
mod cameras;
mod database;
mod error;
pub mod files;
mod folder;
mod journal;
mod names;
mod nosepieces;
mod runs;
mod sets;
mod target_file;
mod targets;

pub use calibrations::{CalibrationFile, Calibrations, KeptCalibration};
pub use cameras::Cameras;
pub use database::{
    BackedUp, Chance, Checked, Database, Exported, FRAMES_BYTES, Fault, NewPicture, PICTURES,
    PictureRow, Purged, Rebuilt, Restored, RunQuery, RunRow, SlideRow, TargetQuery, TargetRow,
    restore,
};
pub use error::{LibraryError, Use};
pub use folder::{Folder, keep_new};
pub use journal::{Journal, JournalHead, JournalStep, Journalled};
pub use names::{check_slide, utc};
pub use nosepieces::{KeptSwitching, Nosepieces};
pub use runs::{RunHead, RunLog, Runs};
pub use sets::{CalibrationSets, KeptSet};
pub use target_file::{KeptTarget, png_of};
pub use targets::{Label, NewTarget, Targets};

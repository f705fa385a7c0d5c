//! What is kept: targets, calibrations, the shadows on cameras, what every run did, and the journal of the one under way.
//!
//! Each is a trait, and a [`Library`] is all of them; [`Folder`] keeps them as files. Nothing is overwritten but what has one place: the
//! newest shadows of a camera and the journal. A file is there whole or not at all ([`files`]), and what is damaged is told, and does not
//! keep the rest away.

#![warn(clippy::too_many_lines)]

mod calibrations;
mod cameras;
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
pub use error::LibraryError;
pub use folder::Folder;
pub use journal::{Journal, JournalHead, JournalStep, Journalled};
pub use names::utc;
pub use nosepieces::{KeptSwitching, Nosepieces};
pub use runs::{RunHead, RunLog, Runs};
pub use sets::{CalibrationSets, KeptSet};
pub use target_file::{KeptTarget, png_of};
pub use targets::Targets;

/// Everything that is kept of an instrument.
pub trait Library:
    Calibrations + CalibrationSets + Cameras + Nosepieces + Targets + Runs + Journal + Send + Sync
{
}

impl<
    T: Calibrations + CalibrationSets + Cameras + Nosepieces + Targets + Runs + Journal + Send + Sync,
> Library for T
{
}

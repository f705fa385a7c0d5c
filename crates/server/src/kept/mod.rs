//! What is kept: targets, calibrations and runs, for people who look through them.

mod calibrations;
mod remembered;
mod runs;
mod targets;

pub(crate) use calibrations::calibrations;
pub(crate) use remembered::Remembered;
pub(crate) use runs::{events, report, run, runs};
pub(crate) use targets::{Edit, edit, picture, remove, target, targets, thumbnail};

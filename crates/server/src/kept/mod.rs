//! What is kept: targets, calibrations and runs, for people who look through them.

mod calibrations;
mod runs;
mod targets;

pub(crate) use calibrations::calibrations;
pub(crate) use runs::{arrival, events, pin, report, run, runs};
pub(crate) use targets::{
    Edit, Quality, edit, picture, purge, remove, slides, target, targets, thumbnail,
};

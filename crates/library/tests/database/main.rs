//! What a database keeps, finds again, and lets go of.

#[path = "../common/mod.rs"]
mod common;
mod copies;
mod gone;
mod measured;
mod programs;
mod runs;
mod targets;

use common::{calibration, keep, label, run};
use scopeservo_geometry::Mat2;
use scopeservo_library::{
    CalibrationSets as _, Calibrations, Cameras as _, Chance, Database, Fault, Folder, Label,
    LibraryError, NewPicture, Nosepieces as _, PICTURES, RunQuery, Runs as _, TargetQuery,
    Targets as _, restore,
};
use scopeservo_scope::{FlatField, Immersion, Objective, ObjectiveId};
use scopeservo_servo::Calibration;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

fn new() -> (tempfile::TempDir, Database) {
    let dir = tempfile::tempdir().unwrap();
    let library = Database::new(dir.path().join("data"));
    (dir, library)
}

fn found(library: &Database, query: &TargetQuery<'_>) -> Vec<String> {
    let rows = library.find_targets(query).unwrap();
    rows.into_iter().map(|row| row.name).collect()
}

/// All bytes of a folder's files, whatever they are.
fn bytes_below(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        match entry.path().is_dir() {
            true => all.extend(bytes_below(&entry.path())),
            false => all.push((entry.path(), fs::read(entry.path()).unwrap())),
        }
    }
    all
}

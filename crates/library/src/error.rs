//! What can go wrong with what is kept.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The error of every call to a library.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LibraryError {
    /// A name that is none, or under which nothing could be found again.
    #[error("{0}")]
    BadName(String),
    /// There is one of that name, and nothing is overwritten.
    #[error(
        "there is a target '{name}' already, and none is overwritten: give another name, or rename or remove that one"
    )]
    Taken {
        /// The name.
        name: String,
    },
    /// There is none of that name.
    #[error("there is no target '{name}'; {}", known_names(known, *more))]
    NoTarget {
        /// The name.
        name: String,
        /// Those that there are, or the newest of them.
        known: Vec<String>,
        /// How many more there are.
        more: usize,
    },
    /// There is none of that number, or no longer.
    #[error("there is no target of the number {number}: look at the list again")]
    NoTargetNumbered {
        /// The number.
        number: i64,
    },
    /// Something of the library is not in its export.
    #[error("{what} is not in the export: {why}")]
    NotExported {
        /// What it is.
        what: String,
        /// Why.
        why: String,
    },
    /// A run goes to it, or waits to go on with it.
    #[error("'{name}' stays as it is: {by}")]
    InUse {
        /// The target.
        name: String,
        /// What needs it.
        by: Use,
    },
    /// A folder takes no files. Found before anything was done for them.
    #[error(
        "cannot write to {path}: {source}. Make that possible, or name another data_folder in the description of the instrument"
    )]
    CannotWrite {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Found when something was there to be kept.
    #[error("{path} could not be kept: {what}. Make room before the next run")]
    NotKept {
        /// The file.
        path: PathBuf,
        /// What the system says.
        what: String,
    },
    /// A file that cannot be read, or is one of a newer version.
    #[error("{path} cannot be read: {what}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        what: String,
    },
    /// A file that is not what was kept.
    #[error("{path} is damaged: {what}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, and what to do.
        what: String,
    },
    /// A calibration that is not what was kept, or cannot be one of this objective.
    #[error("{path} is damaged: {what}. {}", cure(objective, before.as_deref()))]
    DamagedCalibration {
        /// The newest file of the objective.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
        /// The objective.
        objective: String,
        /// The newest of the older ones that can be used.
        before: Option<PathBuf>,
    },
    /// Another program writes for longer than anybody waits.
    #[error(
        "another program has been writing to {path} for some seconds. Try again when it is done"
    )]
    Busy {
        /// The file.
        path: PathBuf,
    },
    /// A database of a later version of this program.
    #[error(
        "{path} has version {version}, and this program reads up to {known}: a newer scopeservo made it. Use that one"
    )]
    Newer {
        /// The file.
        path: PathBuf,
        /// Its version.
        version: i32,
        /// The newest that this program knows.
        known: usize,
    },
    /// A database that two programs could damage.
    #[error(
        "{path} lies on a network drive ({kind}), where locks do not hold and a library can be damaged: name a data_folder on a disk of this computer in the description of the instrument, and bring copies to the drive with scopeservo library backup"
    )]
    NetworkDrive {
        /// The folder.
        path: PathBuf,
        /// What drive.
        kind: String,
    },
    /// A backup without the sums of what is in it.
    #[error(
        "{path} does not tell the sums of what is in it: it ends early, or an earlier version wrote it. Take another backup; one of an earlier version is brought back as it is with scopeservo library restore --without-sums"
    )]
    NoSums {
        /// The archive.
        path: PathBuf,
    },
    /// A calibration of which nobody knows whose it is.
    #[error(
        "the calibration of {objective} does not say on which instrument it was made: it counts as one of '{instrument}'. Calibrate again where it is not"
    )]
    NobodysCalibration {
        /// The objective.
        objective: String,
        /// The instrument that takes it for its own.
        instrument: String,
    },
    /// None of that name lies in the bin.
    #[error("no target '{name}' lies in the bin: scopeservo target bin tells which do")]
    NotInBin {
        /// The name.
        name: String,
    },
    /// There is no picture of that name.
    #[error("there is no picture '{name}'")]
    NoPicture {
        /// The name.
        name: String,
    },
    /// So many pictures are kept already.
    #[error("there are {most} pictures already: remove one first")]
    TooManyPictures {
        /// So many at most.
        most: usize,
    },
    /// There is no run of that name.
    #[error("there is no run '{id}': scopeservo run list tells which there are")]
    NoRun {
        /// What was asked for.
        id: String,
    },
    /// What was under way when a program was killed cannot be read.
    #[error("what was under way when a program ended cannot be read ({path}): {what}")]
    DamagedJournal {
        /// The folder of the journal.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// Something could not be made into a file: a mistake of ours.
    #[error("a file could not be made: {0}")]
    Encode(String),
}

/// What needs a target as it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    /// A run under way, of this program or another.
    Run,
    /// One whose program was killed, and that may go on.
    Left,
}

impl fmt::Display for Use {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Run => "a run with it is under way. Wait until that has ended, or stop it",
            Self::Left => {
                "a run to it was under way when its program ended. Go on with it by scopeservo resume, or end it by scopeservo abandon"
            }
        })
    }
}

fn known_names(known: &[String], more: usize) -> String {
    match (known.is_empty(), more) {
        (true, _) => "none is saved yet".into(),
        (false, 0) => format!("there are {}", known.join(", ")),
        (false, more) => format!("there are {} and {more} more", known.join(", ")),
    }
}

fn cure(objective: &str, before: Option<&Path>) -> String {
    match before {
        Some(before) => format!(
            "Move it away for the one before to count, {}, or calibrate {objective} again",
            before.display()
        ),
        None => format!("Move it away, or calibrate {objective} again"),
    }
}

impl LibraryError {
    /// What a file at `path` could not be kept for.
    pub fn not_kept(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        |source| Self::NotKept {
            path,
            what: source.to_string(),
        }
    }

    pub(crate) fn read(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        |source| Self::Read {
            path,
            what: source.to_string(),
        }
    }

    pub(crate) fn damaged(path: &Path, what: impl std::fmt::Display) -> Self {
        Self::Damaged {
            path: path.into(),
            what: format!("{what}. Move it away, or make it again"),
        }
    }
}

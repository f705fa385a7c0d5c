//! What can be wrong with a description of an instrument, or with finding the instrument.

use scopeservo_protocol::DriverError;
use scopeservo_scope::{Remedy, ScopeError};
use scopeservo_twin::TwinError;
use scopeservo_twin::specimen::SpecimenError;
use std::path::PathBuf;
use thiserror::Error;

/// Why there is no instrument.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SetupError {
    /// The file cannot be read.
    #[error("{path} cannot be read: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file cannot be understood.
    #[error("{path}:{line}:{column}: {what}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// Counts from 1.
        line: usize,
        /// Counts from 1.
        column: usize,
        /// What is wrong there.
        what: String,
    },
    /// The file is readable, but does not describe an instrument.
    #[error("{path}:{line}: {what}")]
    Invalid {
        /// The file.
        path: PathBuf,
        /// Counts from 1: where it says so, or where what lacks something begins.
        line: usize,
        /// What is wrong and what to do.
        what: String,
    },
    /// A driver cannot be started or found, or makes no sense.
    #[error(transparent)]
    Driver(#[from] DriverError),
    /// Another program drives it.
    #[error(
        "{what} is driven by another program{}: end that first",
        process.map_or(String::new(), |id| format!(", process {id}"))
    )]
    InUse {
        /// Which driver.
        what: String,
        /// The number of that program's process, where it left it.
        process: Option<u32>,
    },
    /// Another program works with an instrument of the same name in the same data folder.
    #[error(
        "another program{} works with an instrument that is called '{name}' and keeps its data in {folder}: end that first, or give one of \
         the two another name",
        process.map_or(String::new(), |id| format!(", process {id},"))
    )]
    NameInUse {
        /// The name.
        name: String,
        /// The folder.
        folder: PathBuf,
        /// The number of that program's process, where it left it.
        process: Option<u32>,
    },
    /// What tells other programs that this one drives an instrument cannot be written.
    #[error("whether another program drives the instrument cannot be seen: {path}: {source}")]
    Held {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A secret cannot be read.
    #[error("the secret in {path} cannot be used: {what}")]
    Secret {
        /// The file.
        path: PathBuf,
        /// Why.
        what: String,
    },
    /// The simulated microscope cannot be built.
    #[error(transparent)]
    Twin(#[from] TwinError),
    /// Its specimen cannot be read.
    #[error(transparent)]
    Specimen(#[from] SpecimenError),
    /// A device refused or failed, or a rule makes no sense for it.
    #[error(transparent)]
    Scope(#[from] ScopeError),
    /// What is wrong with one driver.
    #[error("drivers.{driver}: {source}")]
    In {
        /// Its name in the file.
        driver: String,
        /// What.
        source: Box<SetupError>,
    },
}

impl SetupError {
    /// What can be done about it, where a program can do it.
    pub fn remedy(&self) -> Option<Remedy> {
        match self.root() {
            Self::Scope(error) => error.remedy(),
            _ => None,
        }
    }

    /// What is wrong, whichever driver it is with.
    pub fn root(&self) -> &Self {
        match self {
            Self::In { source, .. } => source.root(),
            error => error,
        }
    }
}

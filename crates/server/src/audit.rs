//! Who moved what, and when: a line for each, kept beside the users.

use crate::error::ApiError;
use crate::lock;
use crate::people::Caller;
use scopeservo_library::files::make_folder;
use scopeservo_library::utc;
use serde_json::{Value, json};
use std::fs::{self, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::SystemTime;

/// A file that is longer gives way to a new one; the one before stays.
const LONGEST: u64 = 16 << 20;

/// The log.
pub(crate) struct Audit {
    file: Option<PathBuf>,
    one: Mutex<()>,
}

impl Audit {
    /// In that file; nowhere without.
    pub(crate) fn new(file: Option<PathBuf>) -> Self {
        Self {
            file,
            one: Mutex::default(),
        }
    }

    /// Adds a line. What cannot be written is told, as nothing else may be done for that person.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn note(&self, caller: &Caller, did: &str, what: Value) -> std::io::Result<()> {
        let Some(file) = &self.file else {
            return Ok(());
        };
        let line = json!({
            "at": utc(SystemTime::now()),
            "user": caller.user,
            "role": caller.role,
            "here": caller.here,
            "did": did,
            "what": what,
        });
        let _one = lock(&self.one);
        append(file, &line.to_string())
    }
}

impl Audit {
    /// The same, as an answer over the network.
    ///
    /// # Errors
    /// `internal`.
    pub(crate) fn noted(&self, caller: &Caller, did: &str, what: Value) -> Result<(), ApiError> {
        self.note(caller, did, what).map_err(|e| {
            ApiError::fault(format!(
                "it was done, and the log of who did it cannot be written: {e}"
            ))
        })
    }
}

fn append(file: &Path, line: &str) -> std::io::Result<()> {
    if let Some(folder) = file.parent() {
        make_folder(folder)?;
    }
    if fs::metadata(file).is_ok_and(|m| m.len() > LONGEST) {
        fs::rename(file, file.with_extension("before.jsonl"))?;
    }
    let mut open = OpenOptions::new().create(true).append(true).open(file)?;
    open.write_all(format!("{line}\n").as_bytes())
}

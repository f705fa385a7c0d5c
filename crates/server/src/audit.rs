//! Who moved what, and when: a line for each, kept beside the users.

use crate::error::ApiError;
use crate::lock;
use crate::people::Caller;
use scopeservo_library::files::make_folder;
use scopeservo_library::utc;
use serde_json::{Value, json};
use std::fs::{self, File, OpenOptions};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
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
    let mut options = OpenOptions::new();
    let mut open = options.create(true).append(true).read(true).open(file)?;
    // Whoever was killed in the middle of a line spoils no other.
    let begin = match is_whole(&mut open)? {
        true => "",
        false => "\n",
    };
    open.write_all(format!("{begin}{line}\n").as_bytes())
}

/// Whether what is there ends with a line's end.
fn is_whole(file: &mut File) -> std::io::Result<bool> {
    if file.metadata()?.len() == 0 {
        return Ok(true);
    }
    file.seek(SeekFrom::End(-1))?;
    let mut last = [0];
    file.read_exact(&mut last)?;
    Ok(last == *b"\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_was_cut_off_spoils_no_other() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("moved.jsonl");
        append(&file, "1").unwrap();
        append(&file, "2").unwrap();
        fs::write(&file, "1\n2\n{\"at").unwrap();
        append(&file, "3").unwrap();
        append(&file, "4").unwrap();
        let text = fs::read_to_string(&file).unwrap();
        assert_eq!(text, "1\n2\n{\"at\n3\n4\n");
    }
}

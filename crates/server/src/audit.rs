//! Who moved what, and when: a line for each, kept beside the users.

use crate::error::ApiError;
use crate::lock;
use crate::people::Caller;
use scopeservo_library::files::{make_folder, replace};
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

/// What stands where the name of something stood that was deleted for good.
const FORGOTTEN: &str = "(deleted)";

impl Audit {
    /// Nothing tells the name of a target any more that was deleted for good; that something was done, by whom and when, stays.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn forget(&self, name: &str) -> std::io::Result<()> {
        let Some(file) = &self.file else {
            return Ok(());
        };
        let _one = lock(&self.one);
        for file in [file.clone(), before(file)] {
            let Ok(text) = fs::read_to_string(&file) else {
                continue;
            };
            let lines: String = text
                .lines()
                .map(|line| without(line, name) + "\n")
                .collect();
            if lines != text {
                replace(&file, lines.as_bytes())?;
            }
        }
        Ok(())
    }
}

/// A line in which no value is that name.
fn without(line: &str, name: &str) -> String {
    let Ok(mut told) = serde_json::from_str::<Value>(line) else {
        return line.into();
    };
    let mut found = false;
    let mut open = vec![&mut told["what"]];
    while let Some(value) = open.pop() {
        match value {
            Value::String(text) if text == name => {
                *text = FORGOTTEN.into();
                found = true;
            }
            Value::Array(all) => open.extend(all),
            Value::Object(all) => open.extend(all.values_mut()),
            _ => {}
        }
    }
    match found {
        true => told.to_string(),
        false => line.into(),
    }
}

/// Where the lines went that were there before.
fn before(file: &Path) -> PathBuf {
    file.with_extension("before.jsonl")
}

fn append(file: &Path, line: &str) -> std::io::Result<()> {
    if let Some(folder) = file.parent() {
        make_folder(folder)?;
    }
    if fs::metadata(file).is_ok_and(|m| m.len() > LONGEST) {
        fs::rename(file, before(file))?;
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
    fn a_name_that_was_deleted_for_good_is_told_by_no_line() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("moved.jsonl");
        let line = |name: &str| json!({"user": "spot", "what": {"about": name, "all": [name, 3]}});
        fs::write(before(&file), format!("{}\n", line("spot"))).unwrap();
        fs::write(
            &file,
            format!("{}\nhalf a li\n{}\n", line("spot-2"), line("spot")),
        )
        .unwrap();
        Audit::new(Some(file.clone())).forget("spot").unwrap();
        let gone = line(FORGOTTEN);
        let text = fs::read_to_string(&file).unwrap();
        assert_eq!(text, format!("{}\nhalf a li\n{gone}\n", line("spot-2")));
        assert_eq!(
            fs::read_to_string(before(&file)).unwrap(),
            format!("{gone}\n")
        );
    }

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

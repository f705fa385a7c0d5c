//! The program as it is asked.

#![allow(unreachable_pub, reason = "a part of one test")]

use crate::common::{code, describe, json, scopeservo, stderr};
use serde_json::Value;
use std::fs::File;
use std::path::Path;
use std::process::{Command, Output, Stdio};

pub fn program(folder: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_scopeservo"));
    command.current_dir(folder).args(args);
    command
}

pub fn full() -> Stdio {
    File::options()
        .write(true)
        .open("/dev/full")
        .expect("Linux has it")
        .into()
}

/// The exit code when the readers of stdout and stderr go away before anything is said, as `| true` does.
pub fn unread(folder: &Path, args: &[&str]) -> Option<i32> {
    let mut command = program(folder, args);
    let mut child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop((child.stdout.take(), child.stderr.take()));
    child.wait().unwrap().code()
}

/// The one object on stdout. It has what every answer has.
pub fn object(output: &Output) -> Value {
    let said = String::from_utf8_lossy(&output.stdout);
    assert_eq!(said.lines().count(), 1, "{said}");
    let object = json(output);
    assert_eq!(object["schema"], 1, "{object}");
    assert!(object["warnings"].is_array(), "{object}");
    object
}

pub const ONE_OBJECTIVE: &str = "stage = \"xyz\"\nobjectives = [\"10x\"]";

/// A folder with a target `spot` and the objective's calibration, and the slide moved so far that it cannot be found again.
pub fn out_of_reach() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    describe(dir.path(), ONE_OBJECTIVE);
    let saved = scopeservo(dir.path(), &["target", "save", "spot", "--focus"]);
    assert_eq!(code(&saved), 0, "{}", stderr(&saved));
    let made = scopeservo(
        dir.path(),
        &["calibrate", "--no-focus", "--method", "two-step"],
    );
    assert_eq!(code(&made), 0, "{}", stderr(&made));
    let moved = format!("{ONE_OBJECTIVE}\ncentre_um = [9000, 9000]");
    describe(dir.path(), &moved);
    dir
}

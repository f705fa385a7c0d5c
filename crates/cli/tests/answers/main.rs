//! The answer always comes out: whoever reads it, whatever cannot be written, however the command ends.

#![cfg(unix)]

mod asked;
#[path = "../common/mod.rs"]
mod common;
mod kept;

use asked::{ONE_OBJECTIVE, full, object, out_of_reach, program, unread};
use common::{code, describe, save_gray8, scopeservo, stderr, tissue_gray};
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

#[test]
fn not_found_is_exit_3_whoever_reads_it() {
    let dir = out_of_reach();
    for args in [
        &["reposition", "spot"][..],
        &["reposition", "spot", "--json"],
    ] {
        assert_eq!(unread(dir.path(), args), Some(3), "{args:?}");
    }
    let read = scopeservo(dir.path(), &["reposition", "spot", "--json"]);
    assert_eq!(code(&read), 3, "{}", stderr(&read));
    assert_eq!(object(&read)["verdict"], "not_found");
}

#[test]
fn a_reader_who_leaves_does_not_cut_the_work_short() {
    let dir = tempfile::tempdir().unwrap();
    describe(dir.path(), "objectives = [\"10x\", \"20x\"]");
    assert_eq!(
        unread(dir.path(), &["calibrate", "--method", "two-step"]),
        Some(0)
    );
    for objective in ["10x", "20x"] {
        let kept = ["calibrations", "--objective", objective, "--json"];
        let kept = object(&scopeservo(dir.path(), &kept));
        assert_eq!(kept["history"].as_array().unwrap().len(), 1, "{kept}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn json_that_cannot_be_written_is_exit_1_and_lines_that_cannot_are_a_warning() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let (w, h) = (320, 240);
    save_gray8(&here.join("a.png"), w, h, tissue_gray(3, [0.0; 2], w, h));
    save_gray8(&here.join("b.png"), w, h, vec![200; w * h]);
    describe(here, ONE_OBJECTIVE);
    for (args, hoped) in [
        (&["target", "list"][..], 0),
        (&["register", "a.png", "a.png"], 0),
        (&["register", "a.png", "b.png"], 3),
    ] {
        let lines = program(here, args).stdout(full()).output().unwrap();
        assert_eq!(code(&lines), hoped, "{args:?}");
        assert!(
            stderr(&lines).contains("warning") && stderr(&lines).contains("stdout"),
            "{}",
            stderr(&lines)
        );
        let with_json = [args, &["--json"]].concat();
        let lost = program(here, &with_json).stdout(full()).output().unwrap();
        assert_eq!(code(&lost), 1, "{args:?}");
        assert!(!stderr(&lost).is_empty());
        // Nobody hears a warning where stderr takes nothing either.
        let deaf = program(here, args).stdout(full()).stderr(full()).status();
        assert_eq!(deaf.unwrap().code(), Some(hoped), "{args:?}");
    }
}

/// What ends a command early, by its code word and exit code.
#[test]
fn with_json_there_is_one_object_on_every_early_end() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    fs::write(here.join("letter.png"), "no image").unwrap();
    describe(here, ONE_OBJECTIVE);
    fs::write(here.join("broken.toml"), "name = 3").unwrap();
    for (line, word, exit) in [
        ("demo --nonsense", "usage", 2),
        ("register letter.png", "usage", 2),
        ("target save", "usage", 2),
        ("demo --lambda 0", "usage", 2),
        ("reposition none", "usage", 2),
        ("register letter.png letter.png", "bad_image", 2),
        ("demo --specimen letter.png", "bad_image", 2),
        ("doctor --config broken.toml", "bad_description", 2),
        ("target list --config none.toml", "bad_description", 2),
        ("driver check --tcp 127.0.0.1:1", "no_driver", 2),
        ("focus --objective 63x", "refused", 3),
        ("calibrate --objective 63x", "refused", 3),
        ("target save spot --objective 63x", "refused", 3),
    ] {
        let args: Vec<&str> = line.split(' ').chain(["--json"]).collect();
        let output = scopeservo(here, &args);
        assert_eq!(code(&output), exit, "{line}: {}", stderr(&output));
        let error = &object(&output)["error"];
        assert_eq!(error["code"], word, "{line}: {error}");
        let message = error["message"].as_str().unwrap();
        assert!(message.len() > 20, "{line}: {message}");
        // People read the same.
        assert!(stderr(&output).contains(message), "{line}");
    }
    // What follows -- belongs to the driver.
    let not_ours = scopeservo(here, &["driver", "check", "--", "/no/such", "--json"]);
    assert_eq!(code(&not_ours), 2);
    assert!(not_ours.stdout.is_empty());
}

/// Waits until a signal would no longer simply kill it.
#[cfg(target_os = "linux")]
fn listens(child: &Child) -> bool {
    const SIGINT: u64 = 1 << 1;
    let status = fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap();
    let caught = status.lines().find_map(|l| l.strip_prefix("SigCgt:"));
    u64::from_str_radix(caught.unwrap().trim(), 16).unwrap() & SIGINT != 0
}

/// Presses Ctrl-C when `ready`, and again and again until the program ends.
#[cfg(target_os = "linux")]
fn pressed(folder: &Path, args: &[&str], ready: impl Fn(&Child) -> bool) -> Output {
    let mut child = program(folder, args)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let look = Duration::from_millis(20);
    while !ready(&child) {
        assert!(child.try_wait().unwrap().is_none(), "it ended before");
        std::thread::sleep(look);
    }
    while child.try_wait().unwrap().is_none() {
        let id = child.id().to_string();
        Command::new("kill").args(["-INT", &id]).status().unwrap();
        std::thread::sleep(look);
    }
    child.wait_with_output().unwrap()
}

#[cfg(target_os = "linux")]
#[test]
fn ctrl_c_with_json_tells_one_object_however_often_it_is_pressed() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    // A driver that starts and says nothing: nobody waits for it after the third time.
    let silent = "name = \"silent\"\n[drivers.d]\nprogram = [\"sh\", \"-c\", \"touch started; cat > /dev/null\"]\n\
                  [devices]\nstage = \"d\"\ncamera = \"d\"\nnosepiece = \"none\"\n\
                  [[objective]]\nid = \"10x\"\nmagnification = 100\nnumerical_aperture = 0.25\num_per_px = 1.0\n";
    fs::write(here.join("scopeservo.toml"), silent).unwrap();
    let started = here.join("started");
    let output = pressed(here, &["calibrate", "--json"], |_| started.exists());
    assert_eq!(code(&output), 1, "{}", stderr(&output));
    assert_eq!(object(&output)["error"]["code"], "interrupted");
    // An instrument at work: it is stopped at the first, and nobody waits at the second.
    describe(here, &format!("{ONE_OBJECTIVE}\nreal_time = true"));
    let output = pressed(here, &["calibrate", "--json"], |_| {
        // By then it sweeps; where a machine is too slow for that, it is being opened.
        std::thread::sleep(Duration::from_secs(1));
        true
    });
    assert_eq!(code(&output), 1, "{}", stderr(&output));
    assert_eq!(object(&output)["error"]["code"], "interrupted");
    // Where no instrument is, it ends at once.
    let (w, h) = (640, 480);
    save_gray8(&here.join("a.png"), w, h, tissue_gray(3, [0.0; 2], w, h));
    let endless = ["register", "a.png", "a.png", "--time", "10000", "--json"];
    let output = pressed(here, &endless, listens);
    assert_eq!(code(&output), 1, "{}", stderr(&output));
    assert_eq!(object(&output)["error"]["code"], "interrupted");
}

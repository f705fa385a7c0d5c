//! What is kept: targets that are carried from one microscope to another, runs with their records.

mod common;

use common::{code, describe, json, ok, scopeservo, stderr};
use scopeservo_library::{Database, RunHead, Runs as _};
use serde_json::Value;
use std::fs;

const BY_HAND: &str = "stage = \"xy\"\nobjectives = [\"40x\"]\n";

#[test]
fn a_target_is_carried_to_another_microscope_and_found_there() {
    let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    describe(here.path(), BY_HAND);
    ok(
        here.path(),
        &["calibrate", "--no-focus", "--json", "--method", "two-step"],
    );
    ok(here.path(), &["target", "save", "spot", "--json"]);
    let file = there.path().join("carried.target");
    let file = file.to_str().unwrap();
    ok(here.path(), &["target", "export", "spot", file, "--json"]);
    let again = scopeservo(here.path(), &["target", "export", "spot", file]);
    assert_eq!(code(&again), 1, "none is overwritten: {}", stderr(&again));

    // Another microscope, over the same slide a little elsewhere.
    describe(there.path(), &format!("{BY_HAND}centre_um = [25, -18]\n"));
    let toml = there.path().join("scopeservo.toml");
    let text = fs::read_to_string(&toml).unwrap();
    fs::write(&toml, text.replace("test bench", "upstairs")).unwrap();
    let taken_in = ok(there.path(), &["target", "import", file, "--json"]);
    assert_eq!(taken_in["name"], "carried");
    assert_eq!(taken_in["instrument"], "test bench");
    let back = ok(
        there.path(),
        &["reposition", "carried", "--lambda", "0.7", "--json"],
    );
    assert_eq!(back["verdict"], "arrived", "{back}");
    assert_eq!(
        back["warnings"],
        Value::Array(Vec::new()),
        "its scale was calibrated"
    );

    // A file that was damaged on the way is not taken in.
    let mut bytes = fs::read(file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(there.path().join("damaged.target"), bytes).unwrap();
    let refused = scopeservo(
        there.path(),
        &["target", "import", "damaged.target", "--json"],
    );
    assert_eq!(code(&refused), 2);
    assert_eq!(json(&refused)["error"]["code"], "damaged");
}

#[test]
fn every_run_leaves_its_record_and_calibrations_made_on_the_way_are_used_again() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, BY_HAND);
    ok(here, &["target", "save", "spot", "--json"]);
    let first = ok(here, &["reposition", "spot", "--json"]);
    let second = ok(here, &["reposition", "spot", "--json"]);
    let frames = |answer: &Value| answer["frames"].as_u64().unwrap();
    assert!(frames(&second) < frames(&first), "{first} {second}");
    let list = ok(here, &["run", "list", "--json"]);
    let runs = list["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 3);
    let last = runs[0]["id"].as_str().unwrap();
    assert!(last.ends_with("_reposition"));
    let page = here.join("page.html");
    let show = [
        "run",
        "show",
        last,
        "--events",
        "--report",
        "page.html",
        "--json",
    ];
    let shown = ok(here, &show);
    assert_eq!(shown["answer"]["verdict"], second["verdict"]);
    assert_eq!(
        fs::read_to_string(&page).unwrap(),
        fs::read_to_string(here.join("scopeservo-run/report.html")).unwrap()
    );
    let over = scopeservo(here, &show);
    assert_eq!(code(&over), 1, "none is overwritten");
    // Every event, in order, those of the gate among them.
    let events = shown["events"].as_array().unwrap();
    let numbers: Vec<u64> = events
        .iter()
        .map(|e| e["number"].as_u64().unwrap())
        .collect();
    assert!(numbers.windows(2).all(|w| w[1] == w[0] + 1));
    let of = |from: &str, event: &str| {
        events
            .iter()
            .filter(|e| e["from"] == from && e["event"] == event)
            .count()
    };
    assert_eq!(
        of("gate", "arrived") as u64,
        second["moves"].as_u64().unwrap()
    );
    assert_eq!(of("procedure", "frame_grabbed") as u64, frames(&second));
    assert_eq!(of("station", "job_ended"), 1);
    assert_eq!(shown["inputs"]["name"], "spot");
    let visits = ok(here, &["target", "show", "spot", "--json"])["visits"].clone();
    assert_eq!(visits[0]["id"], *last);
    // All of it comes back from a backup, and goes where other programs can read it.
    assert_eq!(
        ok(here, &["library", "check", "--json"])["faults"],
        serde_json::json!([])
    );
    ok(here, &["library", "backup", "backup.tar", "--json"]);
    ok(here, &["library", "export", "plain", "--json"]);
    assert!(
        here.join("plain/runs")
            .join(last)
            .join("report.html")
            .is_file()
    );
    let refused = scopeservo(here, &["library", "restore", "backup.tar"]);
    assert_eq!(
        code(&refused),
        1,
        "no library is overwritten: {}",
        stderr(&refused)
    );
    fs::rename(here.join("scopeservo-data"), here.join("lost")).unwrap();
    ok(here, &["library", "restore", "backup.tar", "--json"]);
    assert_eq!(ok(here, &["run", "list", "--json"]), list);
    assert_eq!(
        ok(here, &["target", "show", "spot", "--json"])["visits"],
        visits
    );
    // And where the database is lost, the views are not.
    for ending in ["", "-wal", "-shm"] {
        let _ = fs::remove_file(here.join(format!("scopeservo-data/library.sqlite3{ending}")));
    }
    let rebuilt = ok(here, &["library", "rebuild", "--json"]);
    assert_eq!(rebuilt["targets"], serde_json::json!(["spot"]));
    let again = ok(here, &["reposition", "spot", "--json"]);
    assert_eq!(again["verdict"], "arrived", "{again}");
}

#[test]
fn targets_are_told_apart_by_slide_and_note_and_are_gone_for_good_only_when_that_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, BY_HAND);
    let save = [
        "target",
        "save",
        "spot",
        "--slide",
        "17-B",
        "--note",
        "metaphase",
        "--json",
    ];
    let saved = ok(here, &save);
    assert_eq!(
        (&saved["slide"], &saved["note"]),
        (&"17-B".into(), &"metaphase".into())
    );
    ok(here, &["target", "save", "other", "--json"]);
    let names = |args: &[&str]| -> Vec<String> {
        let list = ok(here, &[&["target", "list", "--json"], args].concat());
        let all = list["targets"].as_array().unwrap().iter();
        all.map(|t| t["name"].as_str().unwrap().to_owned())
            .collect()
    };
    assert_eq!(names(&[]), ["other", "spot"]);
    assert_eq!(names(&["--slide", "17-B"]), ["spot"]);
    assert_eq!(names(&["--text", "phase 17"]), ["spot"]);
    assert!(names(&["--text", "anaphase"]).is_empty());
    ok(
        here,
        &[
            "target", "note", "other", "anaphase", "--slide", "18-A", "--json",
        ],
    );
    assert_eq!(names(&["--text", "anaphase 18-a"]), ["other"]);
    ok(here, &["target", "note", "other", "--no-slide", "--json"]);
    assert_eq!(names(&["--text", "anaphase"]), ["other"]);
    assert!(names(&["--slide", "18-A"]).is_empty());
    for bad in [
        &["target", "note", "nobody", "x"][..],
        &["target", "note", "other", "--slide", ""],
        &["target", "purge", "spot"],
        &["target", "restore", "spot"],
        &["run", "show", "1"],
    ] {
        assert_eq!(code(&scopeservo(here, bad)), 2, "{bad:?}");
    }
    ok(here, &["target", "remove", "spot", "--json"]);
    assert_eq!(
        (names(&[]), names(&["--bin"])),
        (vec!["other".into()], vec!["spot".into()])
    );
    ok(
        here,
        &["target", "restore", "spot", "--as", "spot-2", "--json"],
    );
    assert_eq!(names(&["--slide", "17-B"]), ["spot-2"]);
    ok(here, &["target", "remove", "spot-2", "--json"]);
    let purged = ok(here, &["target", "purge", "--all", "--json"]);
    assert_eq!(purged["purged"][0]["runs"].as_array().unwrap().len(), 1);
    assert!(names(&["--bin"]).is_empty());
    assert_eq!(
        ok(here, &["run", "list", "--json"])["runs"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
    assert_eq!(
        ok(here, &["library", "check", "--json"])["litter"],
        serde_json::json!([])
    );
}

/// Several programs with one library: what one is at no other takes away.
#[test]
fn what_a_run_of_another_program_goes_to_is_not_taken_away() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, BY_HAND);
    ok(here, &["target", "save", "spot", "--json"]);
    let library = Database::new(here.join("scopeservo-data"));
    let begin = || {
        let head = RunHead {
            job: "reposition".into(),
            instrument: "test bench".into(),
            version: String::new(),
            inputs: serde_json::json!({"name": "spot"}),
        };
        library.begin_run(&head).unwrap()
    };
    let refused = |args: &[&str]| {
        let said = scopeservo(here, args);
        assert_eq!(code(&said), 3, "{}", stderr(&said));
        let error = json(&said)["error"].clone();
        assert_eq!(error["code"], "in_use", "{error}");
        let message = error["message"].as_str().unwrap();
        assert!(message.contains("a run with it is under way"), "{message}");
    };
    let run = begin();
    refused(&["target", "remove", "spot", "--json"]);
    refused(&["target", "rename", "spot", "else", "--json"]);
    drop(run);
    ok(here, &["target", "remove", "spot", "--json"]);
    let run = begin();
    refused(&["target", "purge", "spot", "--json"]);
    refused(&["target", "purge", "--all", "--json"]);
    drop(run);
    let purged = ok(here, &["target", "purge", "spot", "--json"]);
    assert_eq!(purged["purged"][0]["name"], "spot");
}

#[test]
fn a_backup_that_ends_early_is_brought_back_only_when_that_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, BY_HAND);
    ok(here, &["target", "save", "spot", "--json"]);
    ok(here, &["library", "backup", "all.tar", "--json"]);
    let again = |what: &str, args: &[&str]| {
        let there = tempfile::tempdir().unwrap();
        describe(there.path(), BY_HAND);
        let file = here.join(what);
        let restore = ["library", "restore", file.to_str().unwrap(), "--json"];
        let said = scopeservo(there.path(), &[&restore[..], args].concat());
        let is_there = there
            .path()
            .join("scopeservo-data")
            .join("library.sqlite3")
            .exists();
        (code(&said), json(&said), is_there)
    };
    let (exit, said, is_there) = again("all.tar", &[]);
    assert_eq!((exit, &said["summed"], is_there), (0, &true.into(), true));
    // Cut before its last member, the sums: two blocks and what fills up.
    let bytes = fs::read(here.join("all.tar")).unwrap();
    let name = b"SHA256SUMS";
    let end = bytes.windows(name.len()).rposition(|w| w == name).unwrap();
    fs::write(here.join("cut.tar"), &bytes[..end]).unwrap();
    let (exit, said, is_there) = again("cut.tar", &[]);
    assert_eq!((exit, is_there), (2, false));
    assert_eq!(said["error"]["code"], "damaged");
    let message = said["error"]["message"].as_str().unwrap();
    assert!(message.contains("--without-sums"), "{message}");
    let (exit, said, is_there) = again("cut.tar", &["--without-sums"]);
    assert_eq!((exit, &said["summed"], is_there), (0, &false.into(), true));
    fs::write(here.join("cut.tar"), &bytes[..end - 700]).unwrap();
    let (exit, said, is_there) = again("cut.tar", &["--without-sums"]);
    assert_eq!((exit, is_there), (2, false), "{said}");
}

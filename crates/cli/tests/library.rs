//! What is kept: targets that are carried from one microscope to another, runs with their records.

mod common;

use common::{code, describe, json, ok, scopeservo, stderr};
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
    let data = here.join("scopeservo-data");
    let mut runs: Vec<_> = fs::read_dir(data.join("runs"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    runs.sort();
    let last = runs.last().unwrap();
    assert_eq!(runs.len(), 3);
    assert!(last.to_str().unwrap().ends_with("_reposition"));
    let read = |name: &str| fs::read_to_string(last.join(name)).unwrap();
    let answer: Value = serde_json::from_str(&read("answer.json")).unwrap();
    assert_eq!(answer["verdict"], second["verdict"]);
    assert_eq!(
        read("report.html"),
        fs::read_to_string(here.join("scopeservo-run/report.html")).unwrap()
    );
    // Every event, in order, those of the gate among them.
    let events: Vec<Value> = read("events.jsonl")
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
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
    let asked: Value = serde_json::from_str(&read("run.json")).unwrap();
    assert_eq!(asked["inputs"]["name"], "spot");
}

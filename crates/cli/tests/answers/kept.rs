//! What can be kept and what cannot: full disks, damaged files, folders that are none.

use crate::asked::{ONE_OBJECTIVE, object, out_of_reach};
use crate::common::{code, describe, scopeservo, stderr};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

/// Runs a command in which no file can grow beyond a kilobyte: enough for a trial, too little for what is to be kept.
fn on_a_full_disk(folder: &Path, args: &str) -> Output {
    let program = env!("CARGO_BIN_EXE_scopeservo");
    // A write beyond is then an error and no signal.
    let script = format!("trap '' XFSZ; ulimit -f 2; exec '{program}' {args}");
    Command::new("sh")
        .current_dir(folder)
        .args(["-c", &script])
        .output()
        .unwrap()
}

fn codes(warnings: &Value) -> Vec<&str> {
    let all = warnings.as_array().unwrap().iter();
    all.map(|w| w["code"].as_str().unwrap()).collect()
}

#[test]
fn folders_are_tried_before_the_instrument_is_opened() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, ONE_OBJECTIVE);
    let saved = scopeservo(here, &["target", "save", "spot", "--focus"]);
    assert_eq!(code(&saved), 0, "{}", stderr(&saved));
    // An instrument that cannot be opened: what is refused was refused before.
    let closed = "name = \"test bench\"\n[drivers.d]\nprogram = [\"/no/such/driver\"]\n\
                  [devices]\nstage = \"d\"\ncamera = \"d\"\nnosepiece = \"d\"\n\
                  [objective_change]\nanywhere = true\n";
    fs::write(here.join("scopeservo.toml"), closed).unwrap();
    fs::write(here.join("file"), "in the way").unwrap();
    let refused = |args: &[&str]| -> String {
        let output = scopeservo(here, &[args, &["--json"]].concat());
        assert_eq!(code(&output), 2, "{args:?}: {}", stderr(&output));
        let error = object(&output)["error"].clone();
        assert_eq!(error["code"], "cannot_write", "{args:?}: {error}");
        error["message"].as_str().unwrap().to_owned()
    };
    // Each is told what it can do.
    let advice = refused(&["reposition", "spot", "--out", "file"]);
    assert!(advice.contains("--out"), "{advice}");
    refused(&["reposition", "spot", "--out", "file/run"]);
    let in_a_file = format!("data_folder = \"file\"\n{closed}");
    fs::write(here.join("scopeservo.toml"), in_a_file).unwrap();
    for args in [&["calibrate"][..], &["target", "save", "other"]] {
        let advice = refused(args);
        assert!(
            advice.contains("data_folder") && !advice.contains("--out"),
            "{advice}"
        );
    }
    let init = scopeservo(here, &["init", "file/scopeservo.toml"]);
    assert_eq!(code(&init), 2);
    assert!(!stderr(&init).contains("--out"), "{}", stderr(&init));
}

#[test]
fn on_a_full_disk_nothing_is_begun() {
    let dir = out_of_reach();
    let here = dir.path();
    let runs = || object(&scopeservo(here, &["run", "list", "--json"]))["runs"].clone();
    let before = runs();
    for args in [
        "reposition spot --json",
        "calibrate --json",
        "target save other --focus --json",
        "focus --json",
    ] {
        let refused = on_a_full_disk(here, args);
        assert_eq!(code(&refused), 2, "{args}: {}", stderr(&refused));
        let error = object(&refused)["error"].clone();
        assert_eq!(error["code"], "cannot_write", "{args}: {error}");
    }
    assert_eq!(runs(), before);
}

/// From now on nothing new can be kept beside the database: what would lie there finds a file in the way of its folder.
fn close_the_objects(here: &Path) {
    let objects = here.join("scopeservo-data/objects");
    for folder in 0..=255u8 {
        let folder = objects.join(format!("{folder:02x}"));
        if !folder.exists() {
            fs::write(folder, "in the way").unwrap();
        }
    }
}

#[test]
fn what_was_reached_is_told_when_it_cannot_be_kept() {
    let dir = out_of_reach();
    let here = dir.path();
    close_the_objects(here);
    // A run: its verdict, and what of it is missing.
    let run = scopeservo(here, &["reposition", "spot", "--json"]);
    assert_eq!(code(&run), 3, "{}", stderr(&run));
    let answer = object(&run);
    assert_eq!(answer["verdict"], "not_found");
    let missing = codes(&answer["warnings"]);
    assert!(
        !missing.is_empty() && missing.iter().all(|c| *c == "not_kept"),
        "{answer}"
    );
    // A calibration: its numbers.
    let made = scopeservo(here, &["calibrate", "--json"]);
    assert_eq!(code(&made), 0, "{}", stderr(&made));
    let answer = object(&made);
    let missing = codes(&answer["warnings"]);
    assert!(
        !missing.is_empty() && missing.iter().all(|c| *c == "not_kept"),
        "{answer}"
    );
    let calibration = &answer["calibrations"][0];
    assert!(calibration["file"].is_null(), "{calibration}");
    let um_per_px = &calibration["calibration"]["um_per_px"];
    assert!(
        (um_per_px.as_f64().unwrap() / 2.22 - 1.0).abs() < 0.01,
        "{calibration}"
    );
    // A target: it is there or it is not, and its name is not taken by half of one.
    let lost = scopeservo(here, &["target", "save", "other", "--focus", "--json"]);
    assert_eq!(code(&lost), 1, "{}", stderr(&lost));
    let answer = object(&lost);
    assert_eq!(answer["error"]["code"], "not_kept");
    assert!(answer["features"].as_u64().unwrap() > 100, "{answer}");
    let list = object(&scopeservo(here, &["target", "list", "--json"]));
    assert_eq!(list["targets"].as_array().unwrap().len(), 1, "{list}");
    for folder in fs::read_dir(here.join("scopeservo-data/objects")).unwrap() {
        let folder = folder.unwrap().path();
        if fs::read(&folder).is_ok_and(|text| text == b"in the way") {
            fs::remove_file(folder).unwrap();
        }
    }
    let again = scopeservo(here, &["target", "save", "other", "--focus"]);
    assert_eq!(code(&again), 0, "{}", stderr(&again));
}

#[test]
fn calibrations_made_before_a_refusal_are_kept_and_told() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, "objectives = [\"10x\", \"20x\"]");
    let toml = fs::read_to_string(here.join("scopeservo.toml")).unwrap();
    let toml = format!("{toml}[limits_for.20x]\nx_um = [5000, 6000]\n");
    fs::write(here.join("scopeservo.toml"), toml).unwrap();
    let output = scopeservo(here, &["calibrate", "--json"]);
    assert_eq!(code(&output), 3, "{}", stderr(&output));
    let answer = object(&output);
    assert_eq!(answer["error"]["code"], "refused", "{answer}");
    let made = answer["calibrations"].as_array().unwrap();
    assert_eq!(made.len(), 1, "{answer}");
    assert_eq!(made[0]["objective"], "10x");
    assert!(here.join(made[0]["file"].as_str().unwrap()).exists());
}

#[test]
fn what_is_damaged_is_told_and_the_rest_counts() {
    let dir = out_of_reach();
    let here = dir.path();
    fs::create_dir_all(here.join("scopeservo-data/targets")).unwrap();
    fs::write(
        here.join("scopeservo-data/targets/old.json"),
        "{\"schema\":1,",
    )
    .unwrap();
    let listed = scopeservo(here, &["target", "list", "--json"]);
    assert_eq!(code(&listed), 0, "{}", stderr(&listed));
    let list = object(&listed);
    assert_eq!(list["targets"][0]["name"], "spot", "{list}");
    assert_eq!(list["targets"].as_array().unwrap().len(), 1);
    assert_eq!(codes(&list["warnings"]), ["damaged"]);
    // A calibration that is none is measured anew on the way.
    let kept = here.join("scopeservo-data/calibrations/10x");
    fs::create_dir_all(&kept).unwrap();
    fs::write(kept.join("000002_2026.json"), "{}").unwrap();
    let found = |name: &str| {
        let doctor = object(&scopeservo(here, &["doctor", "--json"]));
        let findings = doctor["findings"].as_array().unwrap();
        let finding = findings.iter().find(|f| f["name"] == name).cloned();
        finding.unwrap_or_default()
    };
    assert_eq!(found("calibration of 10x")["ok"], false);
    assert_eq!(found("targets")["said"], "1 saved");
    let old = found("target old");
    assert_eq!(old["ok"], false);
    let said = old["said"].as_str().unwrap();
    assert!(said.contains(".json is damaged"), "{said}");
    assert!(
        said.ends_with("`scopeservo target remove old` puts it into the bin"),
        "{said}"
    );
    let removed = scopeservo(here, &["target", "remove", "old", "--json"]);
    assert_eq!(code(&removed), 0, "{}", stderr(&removed));
    assert_eq!(found("target old"), serde_json::Value::Null);
    let output = scopeservo(here, &["reposition", "spot", "--json"]);
    assert_eq!(code(&output), 3, "{}", stderr(&output));
    let answer = object(&output);
    assert_eq!(answer["reason"], "target_not_in_view", "{answer}");
    assert_eq!(codes(&answer["warnings"]), ["damaged"]);
    // That is kept, and counts from now on.
    assert_eq!(found("calibration of 10x")["ok"], true);
}

#[test]
fn a_job_that_cannot_be_read_any_more_is_put_aside_and_bars_the_way_no_longer() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, "stage = \"xy\"");
    for (k, text) in ["", "{\"schema\": 1, \"job\"", "[1, 2]"]
        .into_iter()
        .enumerate()
    {
        let journal = here.join("scopeservo-data/journal/test%20bench");
        fs::create_dir_all(&journal).unwrap();
        fs::write(journal.join("head.json"), text).unwrap();
        fs::write(journal.join("state.json"), "what is left").unwrap();
        for command in [&["focus", "--json"][..], &["resume", "--json"]] {
            let refused = object(&scopeservo(here, command));
            assert_eq!(refused["error"]["code"], "damaged", "{refused}");
            let told = refused["error"]["message"].as_str().unwrap();
            assert!(
                told.contains("`scopeservo abandon` puts it aside"),
                "{told}"
            );
        }
        let ended = scopeservo(here, &["abandon", "--json"]);
        assert_eq!(code(&ended), 0, "{k}: {}", stderr(&ended));
        let answer = object(&ended);
        assert_eq!(answer["abandoned"], serde_json::Value::Null);
        assert_eq!(codes(&answer["warnings"]), ["damaged"]);
        let aside = here.join(answer["set_aside"].as_str().unwrap());
        assert_eq!(fs::read_to_string(aside.join("head.json")).unwrap(), text);
        assert_eq!(
            fs::read_to_string(aside.join("state.json")).unwrap(),
            "what is left"
        );
        let again = scopeservo(here, &["abandon"]);
        assert_eq!(
            String::from_utf8_lossy(&again.stdout),
            "no job was under way\n"
        );
    }
}

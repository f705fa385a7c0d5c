//! `stage go`, and that one program at a time drives an instrument: the simulated microscope as a driver that keeps its place.

#![cfg(unix)]

mod common;

use common::served::serve_twin;
use common::{code, json, scopeservo, stderr};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

fn describe(folder: &Path, driver: &str, limits: &str) {
    let text = format!(
        "name = \"bench\"\n[drivers.main]\n{driver}\n[devices]\nstage = \"main\"\ncamera = \"main\"\nnosepiece = \"main\"\n\
         [limits]\n{limits}\n[objective_change]\nretract_z_um = -2000\nmargin_um = 0\n"
    );
    fs::write(folder.join("scopeservo.toml"), text).unwrap();
}

#[test]
fn stage_go_goes_within_the_rules_and_brings_a_stage_back_that_stands_outside() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let twin = serve_twin(here, &[]);
    let driver = format!("tcp = \"{}\"", twin.address);
    describe(here, &driver, "x_um = [-3000, 3000]");
    let go = |args: &[&str]| scopeservo(here, &[&["stage", "go"], args].concat());
    let there = go(&["--x-um", "500", "--rz-deg", "-0.5", "--json"]);
    assert_eq!(code(&there), 0, "{}", stderr(&there));
    let at = json(&there)["at"].clone();
    assert!((at["x_um"].as_f64().unwrap() - 500.0).abs() < 1.0, "{at}");
    assert!((at["rz_deg"].as_f64().unwrap() + 0.5).abs() < 0.005, "{at}");
    let said = go(&["--x-um", "501"]);
    let shown = String::from_utf8_lossy(&said.stdout).into_owned();
    assert!(shown.contains("the stage stands at x = 50"), "{shown}");

    describe(here, &driver, "x_um = [-200, 200]");
    for outside in [
        go(&["--x-um", "600"]),
        go(&["--y-um", "10"]),
        scopeservo(here, &["focus"]),
    ] {
        assert_eq!(code(&outside), 3, "{}", stderr(&outside));
    }
    let doctor = json(&scopeservo(here, &["doctor", "--json"]));
    let findings = doctor["findings"].as_array().unwrap();
    let stands = findings
        .iter()
        .find(|f| f["name"] == "it stands where it may");
    assert_eq!(stands.unwrap()["ok"], false, "{doctor}");
    let back = go(&["--x-um", "100", "--json"]);
    assert_eq!(code(&back), 0, "{}", stderr(&back));
    assert_eq!(code(&go(&["--y-um", "10"])), 0);
    for wrong in [&[][..], &["--x-um", "far"], &["--x-um", "nan"]] {
        assert_eq!(code(&go(wrong)), 2, "{wrong:?}");
    }
}

#[test]
fn a_blurred_view_is_told_when_it_is_saved_and_the_height_stays() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let twin = serve_twin(here, &[]);
    describe(here, &format!("tcp = \"{}\"", twin.address), "");
    let run = |args: &[&str]| {
        let ran = scopeservo(here, args);
        assert_eq!(code(&ran), 0, "{args:?}: {}", stderr(&ran));
        ran
    };
    let z_um = |answer: serde_json::Value| answer["at"]["z_um"].as_f64().unwrap();
    let sharp = json(&run(&["focus", "--objective", "40x", "--json"]));
    let in_focus = sharp["z_um"].as_f64().unwrap();
    assert!(sharp["sigma_um"].as_f64().unwrap() < 0.5, "{sharp}");
    let saved = json(&run(&["target", "save", "sharp", "--json"]));
    assert_eq!(saved["warnings"], serde_json::json!([]), "{saved}");

    // Positive z is nearer to the specimen: 9 um farther away, it is sharper 9 um higher.
    let blurred = format!("{:.1}", in_focus - 9.0);
    let at = z_um(json(&run(&["stage", "go", "--z-um", &blurred, "--json"])));
    let saved = json(&run(&["target", "save", "blurred", "--json"]));
    assert_eq!(saved["warnings"][0]["code"], "blurred", "{saved}");
    let message = saved["warnings"][0]["message"].as_str().unwrap();
    assert!(message.contains("sharpest 9 um higher"), "{message}");
    assert!(message.contains("--focus"), "{message}");
    let still = json(&run(&["stage", "go", "--x-um", "0", "--json"]));
    assert!((z_um(still) - at).abs() < 0.5);

    let saved = json(&run(&["target", "save", "mended", "--focus", "--json"]));
    assert_eq!(saved["warnings"], serde_json::json!([]), "{saved}");
    for (args, what) in [
        (&["focus", "--range-um", "0"][..], "--range-um"),
        (&["calibrate", "--range-um", "-3"], "--range-um"),
        (&["reposition", "sharp", "--range-um", "nan"], "--range-um"),
        (&["target", "save", "x", "--range-um", "9999"], "--range-um"),
    ] {
        let wrong = scopeservo(here, args);
        assert_eq!(code(&wrong), 2, "{args:?}");
        assert!(stderr(&wrong).contains(what), "{}", stderr(&wrong));
    }
}

#[test]
fn two_programs_never_drive_one_instrument() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let program = env!("CARGO_BIN_EXE_scopeservo");
    // A name of its own, so that no other test has the same instrument.
    let link = here.join("microscope");
    fs::copy(program, &link).unwrap();
    let driver = format!("program = [\"{}\", \"twin\", \"serve\"]", link.display());
    describe(here, &driver, "");
    let mut first = Command::new(program)
        .current_dir(here)
        // It takes longer than the second waits for it to end.
        .args(["calibrate"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let elsewhere = tempfile::tempdir().unwrap();
    describe(elsewhere.path(), &driver, "");
    // It may not have begun yet, and is over at some time: until one is refused.
    let refused = (0..50).find_map(|_| {
        let second = scopeservo(elsewhere.path(), &["stage", "go", "--x-um", "0"]);
        (code(&second) != 0).then(|| (stderr(&second), code(&second)))
    });
    let first_id = first.id().to_string();
    Command::new("kill")
        .args(["-INT", &first_id])
        .status()
        .unwrap();
    first.wait().unwrap();
    let (said, code) = refused.expect("the second was never refused");
    assert!(said.contains("driven by another program"), "{said}");
    assert!(said.contains(&format!("process {first_id}")), "{said}");
    assert_eq!(code, 3, "the instrument refuses");
}

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

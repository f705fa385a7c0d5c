//! The commands for an instrument that the user describes, run as a user does, on the simulated microscope.

mod common;

use common::{assert_bad_input, code, describe, json, ok, scopeservo, stderr};
use std::fs;
use std::path::Path;

#[test]
fn from_init_to_arrived() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let init = scopeservo(here, &["init", "--twin"]);
    assert_eq!(code(&init), 0, "{}", stderr(&init));
    let doctor = ok(here, &["doctor", "--json"]);
    assert_eq!(doctor["ok"], true, "{doctor}");
    let made = ok(here, &["calibrate", "--json"]);
    // One instrument, of which each objective was seen in the view of the others.
    let set = &made["set"];
    assert_eq!(set["agrees"], true, "{made}");
    assert_eq!((&set["linked"], &set["freedom"]), (&3.into(), &24.into()));
    let offsets = set["parcentric"].as_array().unwrap();
    assert_eq!(offsets.len(), 3);
    for offset in offsets
        .iter()
        .flat_map(|p| p["offset_um"].as_array().unwrap())
    {
        // The simulated nosepiece's are at most twice 15 um, and twice 2 um.
        let number = |key: &str| offset[key].as_f64().unwrap();
        assert!(
            number("value").abs() < 34.0 && number("sigma") < 0.6,
            "{set}"
        );
    }
    // What makes them one instrument is kept once.
    ok(here, &["library", "export", "plain", "--json"]);
    let sets = here.join("plain/calibration-sets");
    let sets = std::fs::read_dir(sets).unwrap().next().unwrap().unwrap();
    assert_eq!(std::fs::read_dir(sets.path()).unwrap().count(), 1);
    let made = made["calibrations"].as_array().unwrap();
    assert_eq!(made.len(), 3);
    for (calibration, um_per_px) in made.iter().zip([2.22, 1.06, 0.508]) {
        let measured = calibration["calibration"]["um_per_px"].as_f64().unwrap();
        assert!((measured / um_per_px - 1.0).abs() < 0.01, "{calibration}");
        assert!(here.join(calibration["file"].as_str().unwrap()).exists());
    }
    let saved = ok(
        here,
        &[
            "target",
            "save",
            "spot",
            "--objective",
            "40x",
            "--focus",
            "--json",
        ],
    );
    assert!(saved["features"].as_u64().unwrap() > 1000, "{saved}");
    assert!(here.join(saved["file"].as_str().unwrap()).exists());
    // A name is given once.
    let again = scopeservo(here, &["target", "save", "spot"]);
    assert_eq!(code(&again), 2);
    assert!(
        stderr(&again).contains("none is overwritten"),
        "{}",
        stderr(&again)
    );
    let list = ok(here, &["target", "list", "--json"]);
    assert_eq!(list["targets"][0]["name"], "spot");

    // The slide is taken out and put back.
    let toml = fs::read_to_string(here.join("scopeservo.toml")).unwrap();
    let moved = toml
        .replace("centre_um = [0, 0]", "centre_um = [160, -110]")
        .replace("turned_deg = 0", "turned_deg = -2.5");
    assert_ne!(moved, toml);
    fs::write(here.join("scopeservo.toml"), moved).unwrap();
    let back = ok(here, &["reposition", "spot", "--lambda", "0.7", "--json"]);
    assert_eq!(back["verdict"], "arrived", "{back}");
    assert!(back["estimated_error_um"].as_f64().unwrap() < 0.6, "{back}");
    let report = fs::read_to_string(here.join("scopeservo-run/report.html")).unwrap();
    assert!(report.contains("Back to spot") && report.contains("Saved view in red"));
    // With the stored calibrations it takes fewer moves than calibrating on the way.
    let anew = ok(
        here,
        &[
            "reposition",
            "spot",
            "--lambda",
            "0.7",
            "--calibrate",
            "--json",
        ],
    );
    assert_eq!(anew["verdict"], "arrived", "{anew}");
    assert!(anew["moves"].as_u64() > back["moves"].as_u64());
}

#[test]
fn stages_without_rotation_and_one_objective_work_and_tell_the_angle_left() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, "stage = \"xyz\"\nobjectives = [\"40x\"]");
    ok(here, &["target", "save", "spot", "--focus", "--json"]);
    describe(
        here,
        "stage = \"xyz\"\nobjectives = [\"40x\"]\ncentre_um = [40, 25]",
    );
    let back = ok(here, &["reposition", "spot", "--lambda", "0.7", "--json"]);
    assert_eq!(back["verdict"], "arrived", "{back}");
    describe(
        here,
        "stage = \"xyz\"\nobjectives = [\"40x\"]\ncentre_um = [40, 25]\nturned_deg = 2",
    );
    let turned = ok(here, &["reposition", "spot", "--json"]);
    assert_eq!(turned["verdict"], "arrived", "{turned}");
    let left = turned["angle_left_deg"].as_f64().unwrap();
    assert!((left - 2.0).abs() < 0.02, "{turned}");
    assert!(turned["in_view"].as_f64().unwrap() > 0.9, "{turned}");
    assert!(
        turned["message"].as_str().unwrap().contains("2.0"),
        "{turned}"
    );
    // Less may be left: by this run, and by the description.
    let strict = ["reposition", "spot", "--within-deg", "1", "--json"];
    let described = |asked: &str| {
        let toml = fs::read_to_string(here.join("scopeservo.toml")).unwrap();
        fs::write(here.join("scopeservo.toml"), format!("{toml}{asked}")).unwrap();
        scopeservo(here, &["reposition", "spot", "--json"])
    };
    let refused = [
        scopeservo(here, &strict),
        described("\n[arrival]\nwithin_deg = 1\n"),
    ];
    for refused in refused {
        assert_eq!(code(&refused), 3, "{}", stderr(&refused));
        let refused = json(&refused);
        assert_eq!(refused["reason"], "cannot_turn", "{refused}");
        assert!(refused["message"].as_str().unwrap().contains("2.0"));
    }
    // The command line goes before the description.
    let allowed = ["reposition", "spot", "--within-deg", "3", "--json"];
    assert_eq!(ok(here, &allowed)["verdict"], "arrived");
    for bad in [["--within-deg", "0"], ["--within-um", "-1"]] {
        assert_bad_input(here, &["reposition", "spot", bad[0], bad[1]]);
    }
}

#[test]
fn a_mirrored_camera_on_a_turning_plate_is_found_out() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let make = "stage = \"xyz-theta\"\nmirrored = true\nobjectives = [\"10x\", \"40x\"]";
    describe(here, make);
    ok(here, &["calibrate", "--json"]);
    ok(
        here,
        &[
            "target",
            "save",
            "spot",
            "--objective",
            "40x",
            "--focus",
            "--json",
        ],
    );
    describe(
        here,
        &format!("{make}\ncentre_um = [-120, 80]\nturned_deg = 3"),
    );
    let back = ok(here, &["reposition", "spot", "--lambda", "0.5", "--json"]);
    assert_eq!(back["verdict"], "arrived", "{back}");
}

#[test]
fn without_a_focus_drive_the_user_focuses() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, "stage = \"xy\"");
    let focus = ok(here, &["focus", "--json"]);
    assert!(focus["z_um"].is_null(), "{focus}");
}

#[test]
fn what_the_rules_forbid_is_refused_with_the_reason() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, "");
    let toml = fs::read_to_string(here.join("scopeservo.toml")).unwrap();
    fs::write(
        here.join("scopeservo.toml"),
        format!("{toml}[limits]\nz_um = [-2500, -1000]\n"),
    )
    .unwrap();
    // The stage stands at z = 0, outside.
    let doctor = scopeservo(here, &["doctor", "--json"]);
    assert_eq!(code(&doctor), 3);
    let findings = json(&doctor);
    let wrong: Vec<_> = findings["findings"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|f| f["ok"] == false)
        .collect();
    assert!(
        wrong.iter().any(|f| f["name"] == "it stands where it may"),
        "{findings}"
    );
}

#[test]
fn bad_descriptions_and_names_are_said_before_anything_moves() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    for args in [
        vec!["doctor"],
        vec!["calibrate"],
        vec!["focus"],
        vec!["target", "save", "spot"],
        vec!["reposition", "spot"],
    ] {
        // No description at all.
        assert_bad_input(here, &args);
    }
    describe(here, "speed = 3");
    assert_bad_input(here, &["doctor"]);
    describe(here, "objectives = [\"63x\"]");
    assert_bad_input(here, &["doctor"]);
    describe(here, "specimen = \"none.png\"");
    assert_bad_input(here, &["doctor"]);
    describe(here, "");
    for args in [
        vec!["reposition", "spot"],
        vec!["reposition", "../spot"],
        vec!["reposition", "spot", "--lambda", "0"],
        vec!["focus", "--range-um", "-3"],
        vec!["target", "save", "a/b"],
        vec!["driver", "check"],
        vec!["driver", "check", "--", "/no/such/driver"],
        vec!["driver", "check", "--tcp", "127.0.0.1:1"],
        vec!["twin", "serve", "--listen", "0.0.0.0:0"],
        vec!["twin", "serve", "--listen", "nowhere"],
        vec!["twin", "serve", "--described-in", "no.toml"],
    ] {
        assert_bad_input(here, &args);
    }
    let init = scopeservo(here, &["init"]);
    assert_eq!(code(&init), 2);
    assert!(stderr(&init).contains("not overwritten"));
    let unknown = scopeservo(here, &["focus", "--objective", "63x"]);
    assert_eq!(code(&unknown), 3);
    assert!(
        stderr(&unknown).contains("it carries 10x, 20x, 40x"),
        "{}",
        stderr(&unknown)
    );
    // A damaged target is said so, and nothing is overwritten.
    fs::create_dir_all(here.join("scopeservo-data/targets")).unwrap();
    fs::write(
        here.join("scopeservo-data/targets/old.json"),
        "{\"schema\":1,",
    )
    .unwrap();
    assert_bad_input(here, &["reposition", "old"]);
}

#[test]
fn the_simulated_microscope_as_a_driver_passes_its_check() {
    let dir = tempfile::tempdir().unwrap();
    let program = env!("CARGO_BIN_EXE_scopeservo");
    let check = ok(
        dir.path(),
        &[
            "driver",
            "check",
            "--retract-z-um",
            "-2000",
            "--json",
            "--",
            program,
            "twin",
            "serve",
        ],
    );
    assert_eq!(check["ok"], true, "{check}");
    assert!(check["findings"].as_array().unwrap().len() >= 15, "{check}");
}

#[test]
fn the_microscope_that_a_file_describes_is_served() {
    let dir = tempfile::tempdir().unwrap();
    let program = env!("CARGO_BIN_EXE_scopeservo");
    describe(
        dir.path(),
        "made.sparse.per_mm2 = 3000\ncamera.width = 64\ncamera.height = 48\ncamera.dust = [{ specks = 3 }]",
    );
    let check = ["driver", "check", "--retract-z-um", "-2000", "--json", "--"];
    let serve = [
        program,
        "twin",
        "serve",
        "--described-in",
        "scopeservo.toml",
    ];
    let check = ok(dir.path(), &[&check[..], &serve].concat());
    assert_eq!(check["ok"], true, "{check}");
    let hello = check["findings"][0]["said"].as_str().unwrap();
    assert!(hello.contains("64 x 48 px"), "{hello}");
}

#[test]
#[ignore = "needs node"]
fn a_driver_written_from_the_page_alone_passes_its_check() {
    let dir = tempfile::tempdir().unwrap();
    let driver =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/examples/simulated-driver.mjs");
    let driver = driver.to_str().unwrap();
    let check = ok(
        dir.path(),
        &[
            "driver",
            "check",
            "--retract-z-um",
            "-1000",
            "--json",
            "--",
            "node",
            driver,
        ],
    );
    assert_eq!(check["ok"], true, "{check}");
}

#[cfg(unix)]
#[test]
fn ctrl_c_stops_the_instrument_and_ends() {
    use std::process::{Command, Stdio};
    use std::time::Duration;
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, "real_time = true");
    let mut child = Command::new(env!("CARGO_BIN_EXE_scopeservo"))
        .current_dir(here)
        .args(["calibrate"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    let kill = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .unwrap();
    assert!(kill.success());
    let status = child.wait().unwrap();
    assert_eq!(status.code(), Some(1));
    let mut said = String::new();
    std::io::Read::read_to_string(&mut child.stderr.take().unwrap(), &mut said).unwrap();
    assert!(said.contains("stopped on request"), "{said}");
    // Nothing half done is kept, and nothing waits to go on; the record says how it ended.
    let data = here.join("scopeservo-data");
    let kept = ok(here, &["calibrations", "--json"]);
    assert_eq!(kept["history"], serde_json::json!([]));
    assert!(!data.join("journal/test%20bench/head.json").exists());
    let runs = ok(here, &["run", "list", "--json"]);
    let run = runs["runs"][0]["id"].as_str().unwrap();
    let answer = ok(here, &["run", "show", run, "--json"])["answer"].clone();
    assert_eq!(answer["error"]["code"], "interrupted", "{answer}");
}

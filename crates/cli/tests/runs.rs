//! Whole runs of the program.

mod common;

use common::{code, json, save_gray8, scopeservo, stderr, tissue_gray};
use std::fs;

#[test]
fn the_same_seed_gives_the_same_json_on_one_thread_or_two() {
    let dir = tempfile::tempdir().unwrap();
    let run = |threads: &str| {
        let args = [
            "demo",
            "--seed",
            "4",
            "--lambda",
            "0.7",
            "--threads",
            threads,
            "--json",
        ];
        let output = scopeservo(dir.path(), &args);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        output.stdout
    };
    let (one, two) = (run("1"), run("2"));
    assert_eq!(String::from_utf8_lossy(&one), String::from_utf8_lossy(&two));
}

/// What an outsider does: recompute the errors from the views' hidden poses alone.
#[test]
fn the_kept_views_tell_the_same_errors_as_the_answer() {
    let dir = tempfile::tempdir().unwrap();
    let args = [
        "demo",
        "--lambda",
        "1",
        "--start-um",
        "-180,120",
        "--start-deg",
        "-2.5",
        "--out",
        "kept",
        "--json",
    ];
    let output = scopeservo(dir.path(), &args);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let answer = json(&output);
    let kept = dir.path().join("kept");
    let read = |name: &str| -> serde_json::Value {
        serde_json::from_str(&fs::read_to_string(kept.join(name)).unwrap()).unwrap()
    };
    assert_eq!(read("result.json"), answer);
    let views = read("views.json");
    let views = views.as_array().unwrap();
    let of = |role: &str| {
        views
            .iter()
            .filter(|v| v["role"] == role)
            .collect::<Vec<_>>()
    };
    let (target, servo) = (of("target"), of("servo"));
    assert_eq!(target.len(), 1);
    assert_eq!(views.len() as u64, answer["frames"].as_u64().unwrap() + 1);
    let centre =
        |view: &serde_json::Value| [0, 1].map(|k| view["truth"]["centre_um"][k].as_f64().unwrap());
    let (goal, first, last) = (
        centre(target[0]),
        centre(servo[0]),
        centre(servo[servo.len() - 1]),
    );
    let apart = |a: [f64; 2], b: [f64; 2]| f64::hypot(a[0] - b[0], a[1] - b[1]);
    // The slide's seat scatters by 3 um, and each objective looks up to 15 um beside the others.
    assert!((apart(goal, first) - f64::hypot(180.0, 120.0)).abs() < 40.0);
    let told = answer["true_error_um"].as_f64().unwrap();
    let angle = |view: &serde_json::Value| view["truth"]["angle_deg"].as_f64().unwrap();
    let turn = (angle(servo[servo.len() - 1]) - angle(target[0])).abs();
    let told_deg = answer["true_error_deg"].as_f64().unwrap();
    assert!((turn - told_deg).abs() < 1e-6, "{turn} {told_deg}");
    assert!(
        (apart(goal, last) - told).abs() < 1e-6,
        "{} {told}",
        apart(goal, last)
    );
    assert!(told <= 1.0);
    for view in views {
        let file = kept.join(view["file"].as_str().unwrap());
        assert!(
            fs::metadata(&file).unwrap().len() > 10_000,
            "{}",
            file.display()
        );
    }
    let page = fs::read_to_string(kept.join("report.html")).unwrap();
    assert!(page.contains("Arrived") && page.trim_end().ends_with("</html>"));
    assert!(read("events.json").as_array().unwrap().len() > 100);
}

#[test]
fn help_has_examples_and_exit_codes() {
    let dir = tempfile::tempdir().unwrap();
    for args in [
        vec!["--help"],
        vec!["demo", "--help"],
        vec!["register", "--help"],
    ] {
        let output = scopeservo(dir.path(), &args);
        assert_eq!(code(&output), 0);
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(
            text.contains("Exit codes") || text.contains("Examples"),
            "{text}"
        );
    }
}

#[test]
fn the_papers_keys_are_all_there() {
    let dir = tempfile::tempdir().unwrap();
    let output = scopeservo(
        dir.path(),
        &["demo", "--max-iterations", "1", "--noise", "none", "--json"],
    );
    assert_eq!(code(&output), 3, "{}", stderr(&output));
    let answer = json(&output);
    for key in [
        "schema",
        "verdict",
        "reason",
        "estimated_error_um",
        "true_error_um",
        "true_error_deg",
        "virtual_time_s",
        "moves",
        "frames",
        "magnifications",
        "noise",
    ] {
        assert!(answer.get(key).is_some(), "{key} is missing");
    }
    assert_eq!(answer["noise"], "none");
    for key in [
        "magnification",
        "iterations",
        "inliers",
        "error_um",
        "error_deg",
        "calibration",
    ] {
        assert!(
            answer["magnifications"][0].get(key).is_some(),
            "{key} is missing"
        );
    }
}

#[test]
fn register_tells_its_time_when_asked_and_the_same_answer_on_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let (w, h) = (640, 480);
    for (name, x) in [("view.png", 0.0), ("target.png", 30.0)] {
        save_gray8(&dir.path().join(name), w, h, tissue_gray(3, [x, 0.0], w, h));
    }
    let run = |more: &[&str]| {
        let output = scopeservo(
            dir.path(),
            &[&["register", "view.png", "target.png"], more].concat(),
        );
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        output
    };
    let plain = json(&run(&["--json"]));
    assert!(plain.get("ms").is_none(), "{plain}");
    // 2000 is what is looked at by default, in each image.
    assert_eq!(plain, json(&run(&["--json", "--features", "2000"])));
    assert_ne!(
        plain["keypoints"],
        json(&run(&["--json", "--features", "300"]))["keypoints"]
    );
    for threads in ["1", "2"] {
        let mut timed = json(&run(&["--json", "--time", "3", "--threads", threads]));
        let ms = timed.as_object_mut().unwrap().remove("ms").unwrap();
        assert!(ms.as_f64().unwrap() > 0.0, "{ms}");
        assert_eq!(timed, plain);
        assert_eq!(json(&run(&["--json", "--threads", threads])), plain);
    }
    // A thread more than there are cores, so that the line shows the pool and not the machine.
    let output = run(&["--time", "1", "--threads", "7"]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        said.contains(" ms for ") && said.contains("threads: 7"),
        "{said}"
    );
    let said = String::from_utf8_lossy(&run(&[]).stdout).into_owned();
    assert!(!said.contains(" ms for "), "{said}");
}

//! Real pairs: the same slide on two scanners is found, look-alike neighbours are not.

mod common;

use common::{code, json, scopeservo, stderr};
use std::path::PathBuf;

fn specimens() -> PathBuf {
    std::env::var_os("SCOPESERVO_SPECIMENS")
        .expect("SCOPESERVO_SPECIMENS names the folder of real slides")
        .into()
}

fn register(view: PathBuf, target: PathBuf, level: &str) -> (i32, serde_json::Value) {
    let args = [
        "register",
        view.to_str().expect("the path is UTF-8"),
        target.to_str().expect("the path is UTF-8"),
        "--level",
        level,
        "--json",
    ];
    let output = scopeservo(&std::env::temp_dir(), &args);
    let code = code(&output);
    assert!(code == 0 || code == 3, "{}", stderr(&output));
    (code, json(&output))
}

#[test]
#[ignore = "needs real slides: SCOPESERVO_SPECIMENS"]
fn the_same_slide_on_two_scanners_is_found_at_every_level() {
    let folder = specimens();
    for level in ["0", "1", "2", "3", "4"] {
        let (a, b) = (
            folder.join("cytology_scanner_a.tif"),
            folder.join("cytology_scanner_b.tif"),
        );
        let (code, answer) = register(a, b, level);
        assert_eq!(code, 0, "level {level}: {answer}");
        let number = |key: &str| answer[key].as_f64().unwrap();
        assert!(
            (number("scale") - 0.897).abs() <= 0.01,
            "level {level}: {answer}"
        );
        assert!(
            (number("rotation_deg") - 0.24).abs() <= 0.3,
            "level {level}: {answer}"
        );
    }
}

#[test]
#[ignore = "needs real slides: SCOPESERVO_SPECIMENS"]
fn the_next_section_of_a_series_is_not_found() {
    let folder = specimens();
    let (one, three) = (
        folder.join("olfactory_bulb_1.png"),
        folder.join("olfactory_bulb_3.png"),
    );
    for (view, target) in [(&one, &three), (&three, &one)] {
        let (code, answer) = register(view.clone(), target.clone(), "0");
        assert_eq!(
            (code, &answer["verdict"]),
            (3, &"not_found".into()),
            "{answer}"
        );
    }
}

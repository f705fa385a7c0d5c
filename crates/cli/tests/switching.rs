//! `scopeservo calibrate --switching`, as a user runs it.

mod common;

use common::{assert_bad_input, code, describe, ok, scopeservo, stderr};

#[test]
fn switching_tells_and_keeps_how_objectives_come_back_and_leaves_out_other_media() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, "stage = \"xyz\"\nimmersion = { \"40x\" = \"oil\" }\n");
    assert_bad_input(here, &["calibrate", "--switching", "1"]);
    let told = ok(
        here,
        &[
            "calibrate",
            "--switching",
            "3",
            "--immersion",
            "oil",
            "--json",
        ],
    );
    assert_eq!(told["calibrations"].as_array().unwrap().len(), 3, "{told}");
    // Nobody puts on oil for it again and again.
    let all = told["switching"].as_array().unwrap();
    assert_eq!(all.len(), 1, "{told}");
    let report = &all[0];
    assert_eq!(
        (&report["from"], &report["to"]),
        (&"10x".into(), &"20x".into())
    );
    assert_eq!(report["arrivals"], serde_json::json!([3, 3]));
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    for k in [0, 1] {
        // The simulated nosepiece's are at most twice 15 um, and 2 um.
        let (offset, one) = (&report["offset_um"][k], &report["repeatability_um"][k]);
        assert!(number(&offset["value"]).abs() < 35.0, "{report}");
        assert!((0.05..4.0).contains(&number(&offset["sigma"])), "{report}");
        assert!((0.1..4.0).contains(&number(&one["value"])), "{report}");
    }
    assert!(
        number(&report["focus"]["offset_um"]["value"]).abs() < 35.0,
        "{report}"
    );
    // What is damaged is a warning, and the instrument is opened without it.
    let folder = here.join("scopeservo-data/nosepieces/test%20bench");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("000002_x.json"), "{}").unwrap();
    let focused = scopeservo(here, &["focus", "--objective", "20x"]);
    assert_eq!(code(&focused), 0, "{}", stderr(&focused));
    assert!(
        stderr(&focused).contains(".json is damaged"),
        "{}",
        stderr(&focused)
    );
}

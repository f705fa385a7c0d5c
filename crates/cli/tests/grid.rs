//! `scopeservo grid`, as a user runs it.

mod common;

use common::{assert_bad_input, code, describe, json, ok, scopeservo, stderr};

const STAGE: &str = "stage = \"xy\"\nobjectives = [\"40x\"]\n";

#[test]
fn a_grid_agrees_with_a_calibration_or_says_what_does_not_and_changes_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    for args in [
        vec!["grid"],
        vec!["grid", "--pitch-um", "0"],
        vec!["grid", "--pitch-um", "nan"],
        vec!["grid", "--pitch-um", "20", "--reach-um", "-3"],
        // No description at all.
        vec!["grid", "--pitch-um", "20"],
    ] {
        assert_bad_input(here, &args);
    }
    let on_grid = format!("{STAGE}made.lattice = {{ pitch_um = 20, turned_deg = 17 }}\n");
    describe(here, &on_grid);
    let grid = ["grid", "--reach-um", "300", "--no-focus", "--json"];
    let with = |pitch: &'static str| [&grid[..], &["--pitch-um", pitch]].concat();
    let alone = ok(here, &with("20"));
    assert!(
        alone["agrees"].is_null() && alone["comparison"].is_null(),
        "{alone}"
    );
    let reading = &alone["grid"]["reading"];
    for (key, truth) in [("kx_px_per_m", -1_953_155.0), ("ky_px_per_m", -1_981_235.0)] {
        let number = &reading[key];
        let [value, sigma] = ["value", "sigma"].map(|k| number[k].as_f64().unwrap());
        assert!(
            (value - truth).abs() < 2e-4 * f64::abs(truth) && sigma < 200.0,
            "{number}"
        );
    }
    assert!(alone["grid"]["rotation_centre_um"].is_null());

    describe(here, STAGE);
    ok(
        here,
        &["calibrate", "--no-focus", "--json", "--method", "two-step"],
    );
    let tissue = scopeservo(here, &with("20"));
    assert_eq!(code(&tissue), 3, "{}", stderr(&tissue));
    assert_eq!(json(&tissue)["error"]["code"], "grid_failed");

    describe(here, &on_grid);
    let agrees = ok(here, &with("20"));
    assert_eq!(agrees["agrees"], true, "{agrees}");
    // The scale is off by more than two steps can be.
    let wrong = scopeservo(here, &with("20.6"));
    assert_eq!(code(&wrong), 3, "{}", stderr(&wrong));
    let wrong = json(&wrong);
    assert!(
        wrong["agrees"] == false && wrong.get("error").is_none(),
        "{wrong}"
    );
    assert_eq!(wrong["comparison"]["compared"][0]["agrees"], false);
    // It was not kept as a calibration.
    let kept = ok(here, &["calibrations", "--json"]);
    assert_eq!(kept["history"].as_array().unwrap().len(), 1);
}

//! `scopeservo level`, as a user runs it.

mod common;

use common::{assert_bad_input, code, describe, json, ok, scopeservo, stderr};

const TILTED: &str =
    "objectives = [\"40x\"]\ntilt_mrad = [8, -8]\ncamera = { width = 320, height = 240 }\n";

#[test]
fn a_tilt_is_told_levelled_or_left_to_the_hand_and_the_answer_says_which() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    for args in [
        // No description at all.
        vec!["level"],
        vec!["level", "--lever-mm", "0"],
        vec!["level", "--lever-mm", "nan"],
        vec!["level", "--lever-mm", "5000", "--apply"],
    ] {
        assert_bad_input(here, &args);
    }
    describe(here, TILTED);
    let told = ok(here, &["level", "--json"]);
    assert!(
        told["level"] == false && told["levelled"].is_null(),
        "{told}"
    );
    assert!(told["by_hand"].as_str().unwrap().starts_with("by hand: "));
    let tilt = &told["seen"]["tilt"];
    assert!(tilt["shown"] == true && tilt["stage"].is_null(), "{tilt}");
    for slope in tilt["slope_um_per_mm"].as_array().unwrap() {
        let [value, sigma] = ["value", "sigma"].map(|k| slope[k].as_f64().unwrap());
        assert!(
            (value.abs() - 8.0).abs() < 3.5 * sigma && sigma < 1.2,
            "{slope}"
        );
    }

    let levelled = ok(here, &["level", "--apply", "--json"]);
    assert!(
        levelled["level"] == true && levelled["by_hand"].is_null(),
        "{levelled}"
    );
    let after = levelled["levelled"]["after"]["tilt"]["corner_um"]["value"].as_f64();
    assert!(after.unwrap() < 0.7, "{levelled}");

    // Its page shows the heights, before and after.
    let runs = ok(here, &["run", "list", "--json"]);
    let newest = runs["runs"][0]["id"].as_str().unwrap();
    ok(
        here,
        &["run", "show", newest, "--report", "page.html", "--json"],
    );
    let page = std::fs::read_to_string(here.join("page.html")).unwrap();
    assert!(
        page.matches("Heights in focus over the view at 40x")
            .count()
            >= 4
    );

    // A stage without rx and ry: told the same, and not level.
    describe(here, &format!("stage = \"xyz\"\n{TILTED}"));
    let measured = scopeservo(here, &["level"]);
    let words = String::from_utf8_lossy(&measured.stdout).into_owned();
    assert_eq!(code(&measured), 0, "{words}");
    assert!(
        words.contains("this stage has no axis that tips; by hand: "),
        "{words}"
    );
    let left = scopeservo(here, &["level", "--apply", "--json"]);
    assert_eq!(code(&left), 3, "{}", stderr(&left));
    let left = json(&left);
    assert!(
        left.get("error").is_none() && left["level"] == false,
        "{left}"
    );
    assert!(left["by_hand"].is_string(), "{left}");

    // Nothing to focus on: an answer of its own.
    describe(here, &format!("{TILTED}made.blank = {{}}\n"));
    let blank = scopeservo(here, &["level", "--apply", "--json"]);
    assert_eq!(code(&blank), 3, "{}", stderr(&blank));
    assert_eq!(json(&blank)["error"]["code"], "no_focus");
    let blank = scopeservo(here, &["level", "--no-focus", "--json"]);
    assert_eq!(code(&blank), 3, "{}", stderr(&blank));
    assert!(json(&blank)["seen"]["tilt"].is_null());
}

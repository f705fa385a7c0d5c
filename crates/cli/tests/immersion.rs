//! Objectives that work in different media, on the command line: nobody sits at a terminal.

mod common;

use common::{assert_bad_input, code, describe, json, ok, scopeservo, stderr};
use std::path::Path;

const WET: &str =
    "stage = \"xy\"\nobjectives = [\"10x\", \"40x\"]\nimmersion = { \"40x\" = \"oil\" }\n";

/// A command that needs another medium is refused with a code word and says what to do, and nothing turned.
fn is_refused(here: &Path, args: &[&str]) {
    let refused = scopeservo(here, args);
    assert_eq!(code(&refused), 3, "{args:?}: {}", stderr(&refused));
    let error = json(&refused)["error"].clone();
    assert_eq!(error["code"], "immersion", "{args:?}: {error}");
    let said = error["message"].as_str().unwrap();
    assert!(
        said.contains("40x works in oil") && said.ends_with("with --immersion oil"),
        "{args:?}: {said}"
    );
}

#[test]
fn nothing_goes_into_oil_unasked_and_a_flag_names_the_medium_for_one_change() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, WET);
    let calibrate = ["calibrate", "--no-focus", "--json"];
    let focus = ["focus", "--objective", "40x", "--json"];
    let save = ["target", "save", "t", "--objective", "40x", "--json"];
    for args in [&calibrate[..], &focus, &save] {
        is_refused(here, args);
        // What the specimen was made ready for is not what the objective works in.
        is_refused(here, &[args, &["--immersion", "air"]].concat());
    }
    // The dry objective was calibrated before the other was refused, and stays kept.
    let kept = ok(here, &["calibrations", "--json"]);
    let history = kept["history"].as_array().unwrap();
    assert!(
        !history.is_empty() && history.iter().all(|c| c["objective"] == "10x"),
        "{kept}"
    );
    let both = ok(here, &[&calibrate[..], &["--immersion", "oil"]].concat());
    assert_eq!(both["calibrations"].as_array().unwrap().len(), 2, "{both}");
    assert_bad_input(here, &["focus", "--immersion", "castor"]);
}

#[test]
fn a_medium_that_there_is_not_is_told_with_its_place_and_a_guess() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, &WET.replace("\"oil\"", "\"oill\""));
    let wrong = scopeservo(here, &["focus"]);
    assert_eq!(code(&wrong), 2);
    let said = stderr(&wrong);
    assert!(
        said.contains("scopeservo.toml:6:") && said.contains("did you mean 'oil'?"),
        "{said}"
    );
}

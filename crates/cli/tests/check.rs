//! `scopeservo check` and `scopeservo calibrations`, as a user runs them.

mod common;

use common::{assert_bad_input, code, describe, json, ok, scopeservo, stderr};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const STAGE: &str = "stage = \"xy\"\nobjectives = [\"20x\", \"40x\"]\n";

/// The files beside the database, by their folders and names.
fn files(here: &Path) -> BTreeSet<PathBuf> {
    let list = |folder: &Path| {
        std::fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().path())
    };
    let folders = list(&here.join("scopeservo-data/objects")).filter(|p| p.is_dir());
    folders.flat_map(|folder| list(&folder)).collect()
}

/// A later calibration of 40x that is the first one, changed. Where it lies.
fn keep_changed(here: &Path, change: impl FnOnce(&mut Value)) -> PathBuf {
    let history = ok(here, &["calibrations", "--objective", "40x", "--json"]);
    let first = here.join(history["history"][0]["file"].as_str().unwrap());
    let mut kept: Value = serde_json::from_slice(&std::fs::read(first).unwrap()).unwrap();
    change(&mut kept["calibration"]);
    let before = files(here);
    // As an earlier version would have kept it: it is taken in.
    let folder = here.join("scopeservo-data/calibrations/40x");
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("000007_2099-01-01T00-00-00Z.json");
    std::fs::write(&path, kept.to_string()).unwrap();
    ok(here, &["calibrations", "--json"]);
    let mut new = files(here).difference(&before).cloned().collect::<Vec<_>>();
    new.pop().unwrap()
}

#[test]
fn the_objective_that_alone_is_off_is_named_and_all_that_is_kept_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, STAGE);
    // None is kept yet.
    assert_bad_input(here, &["check"]);
    assert_eq!(
        ok(here, &["calibrations", "--json"])["history"],
        Value::Array(vec![])
    );
    let two_step = ["calibrate", "--no-focus", "--json", "--method", "two-step"];
    ok(here, &two_step);
    let check = ["check", "--no-focus", "--json"];
    let good = ok(here, &check);
    assert_eq!(good["ok"], true, "{good}");
    assert_eq!(good["together"]["disagree"], "none");
    let all = good["checked"].as_array().unwrap();
    assert!(
        all.len() == 2 && all.iter().all(|c| c["verdict"] == "good"),
        "{good}"
    );

    let changed = keep_changed(here, |c| {
        for k in 0..4 {
            let v = &mut c["stage_from_pixel"][k / 2][k % 2];
            *v = (0.95 * v.as_f64().unwrap()).into();
        }
    });
    let off = scopeservo(here, &check);
    assert_eq!(code(&off), 3, "{}", stderr(&off));
    let off = json(&off);
    assert!(off.get("error").is_none() && off["ok"] == false, "{off}");
    assert_eq!(off["together"]["disagree"], "alone", "{off}");
    assert_eq!(off["together"]["objective"], "40x");
    assert_eq!(off["checked"][0]["verdict"], "good");
    assert_eq!(off["checked"][1]["verdict"], "drifted");
    let lines = scopeservo(here, &check[..2]);
    let lines = String::from_utf8_lossy(&lines.stdout).into_owned();
    assert!(lines.contains("40x alone disagrees: scale +5."), "{lines}");

    let history = ok(here, &["calibrations", "--objective", "40x", "--json"]);
    let [first, second] = history["history"].as_array().unwrap().as_slice() else {
        panic!("{history}");
    };
    assert!(first["in_use"] == false && second["in_use"] == true);
    assert_eq!(
        second["file"],
        changed
            .strip_prefix(here)
            .unwrap_or(&changed)
            .to_str()
            .unwrap()
    );
    let scale = &second["changes"][0];
    assert_eq!(scale["what"], "scale_percent");
    assert!(
        (scale["by"].as_f64().unwrap() + 5.0).abs() < 1e-6,
        "{scale}"
    );

    // What cannot be is told, and nothing is done by it: the other objective is checked all the same, and all are not good.
    let impossible = keep_changed(here, |c| c["scatter"] = serde_json::json!([-1e-7, 0, 0]));
    let partly = scopeservo(here, &check);
    assert_eq!(code(&partly), 3, "{}", stderr(&partly));
    let partly = json(&partly);
    assert_eq!(partly["checked"].as_array().unwrap().len(), 1, "{partly}");
    assert_eq!(partly["checked"][0]["verdict"], "good");
    assert_eq!(partly["ok"], false);
    let warning = partly["warnings"][0].clone();
    assert_eq!(warning["code"], "damaged");
    // The cure is named: the older one that can be used, and the command that makes another.
    for word in [
        "standard deviation",
        "for the one before to count, scopeservo-data/objects/",
        "`scopeservo calibrate --objective 40x`",
    ] {
        let said = warning["message"].as_str().unwrap();
        assert!(said.contains(word), "{word}: {said}");
    }
    // Asked for by its name it is the answer.
    let refused = scopeservo(here, &[&check[..], &["--objective", "40x"]].concat());
    assert_eq!(code(&refused), 2, "{}", stderr(&refused));
    assert_eq!(json(&refused)["error"]["code"], "damaged");
    let history = ok(here, &["calibrations", "--json"]);
    assert_eq!(history["history"].as_array().unwrap().len(), 3);
    let name = impossible.file_name().unwrap().to_str().unwrap();
    assert!(history["warnings"].to_string().contains(name), "{history}");
}

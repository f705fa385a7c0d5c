//! What the description says holds for the jobs of the server as for the commands.

mod common;

use common::{Bench, HURRIED, described};
use scopeservo_library::Database;
use serde_json::{Value, json};

/// All values of that key, wherever they are.
fn all<'v>(value: &'v Value, key: &str, found: &mut Vec<&'v Value>) {
    match value {
        Value::Object(object) => {
            for (name, value) in object {
                if name == key {
                    found.push(value);
                }
                all(value, key, found);
            }
        }
        Value::Array(values) => values.iter().for_each(|v| all(v, key, found)),
        _ => {}
    }
}

#[test]
fn every_job_is_done_as_the_description_says() {
    let more = "[focus]\nsweep = true\n[arrival]\nwithin_um = 3.5\nwithin_deg = 0.5\n[target]\nstill = true\n";
    let bench = Bench::of(&format!("{}{more}", described(HURRIED)), true);
    let visitor = bench.visitor();
    let library = Database::new(bench.folder.path().join("scopeservo-data"));
    for job in [
        json!({"job": "focus", "objective": "10x"}),
        json!({"job": "calibrate", "objectives": ["10x"]}),
        json!({"job": "check"}),
        json!({"job": "save_target", "name": "spot", "focus": true}),
        json!({"job": "reposition", "target": "spot"}),
    ] {
        let done = visitor.run(&job);
        assert_eq!(done["error"], json!(null), "{done}");
        let (inputs, _) = library.run_said(done["run"].as_str().unwrap()).unwrap();
        let mut sweeps = Vec::new();
        all(&inputs, "sweep", &mut sweeps);
        assert!(!sweeps.is_empty(), "{job}: {inputs}");
        assert!(
            sweeps.iter().all(|sweep| **sweep == true),
            "{job}: {inputs}"
        );
        match job["job"].as_str().unwrap() {
            // Whether all was seen to be good is one word.
            "check" => assert_eq!(done["answer"]["ok"], true, "{done}"),
            "save_target" => assert_eq!(inputs["input"]["still"], true, "{inputs}"),
            "reposition" => {
                let servo = &inputs["options"]["servo"];
                assert_eq!(
                    [&servo["within_um"], &servo["within_deg"]],
                    [&json!(3.5), &json!(0.5)]
                );
            }
            _ => {}
        }
    }
}

#[test]
fn a_check_that_leaves_out_a_damaged_calibration_is_not_all_good() {
    let bench = Bench::demo(HURRIED);
    let visitor = bench.visitor();
    for objective in ["10x", "40x"] {
        let made = visitor.run(&json!({"job": "calibrate", "objectives": [objective]}));
        assert_eq!(made["error"], json!(null), "{made}");
    }
    let library = Database::new(bench.folder.path().join("scopeservo-data"));
    let open = rusqlite::Connection::open(library.file()).unwrap();
    let file = "SELECT file FROM measurements WHERE kind = 'calibration' AND of = '40x'";
    let file: String = open.query_row(file, [], |row| row.get(0)).unwrap();
    let place = library.path().join("objects").join(&file[..2]).join(&file);
    std::fs::write(place, "damaged").unwrap();
    let checked = visitor.run(&json!({"job": "check"}));
    let answer = &checked["answer"];
    assert_eq!(answer["checked"].as_array().unwrap().len(), 1, "{checked}");
    assert_eq!(answer["ok"], false, "{checked}");
    let warning = answer["warnings"][0].as_str().unwrap();
    assert!(warning.contains("40x"), "{warning}");
}

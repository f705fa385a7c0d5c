//! What earlier versions kept as files becomes rows: nothing is lost, whatever is damaged and whenever the program is killed.

mod common;

use common::{calibration, keep, label};
use scopeservo_library::{
    CalibrationSets as _, Calibrations as _, Cameras as _, Database, Folder, Label, LibraryError,
    Nosepieces as _, RunQuery, Runs as _, Targets as _,
};
use scopeservo_scope::{FlatField, Immersion, Objective, ObjectiveId};
use scopeservo_servo::{CalibrationSet, Known, SET_SCHEMA, SwitchingReport};
use serde_json::json;
use std::fs;
use std::path::Path;

/// A library of the first version's and the second's files.
fn old(path: &Path) -> Folder {
    let folder = Folder::new(path.into());
    for (name, note) in [("spot", "a note"), ("other", ""), ("gone", "")] {
        keep(&folder, name, &label("", note)).unwrap();
    }
    folder.remove_target("gone").unwrap();
    keep(&folder, "gone", &Label::default()).unwrap();
    folder.remove_target("gone").unwrap();
    let stored = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/schema1");
    fs::copy(stored.join("old.json"), path.join("targets/first.json")).unwrap();
    for um in [0.19, 0.2] {
        folder
            .keep_calibration("Bench 1", &calibration("Plan 40x/0.65", um), None, None)
            .unwrap();
    }
    let set = CalibrationSet {
        schema: SET_SCHEMA,
        calibrations: Vec::new(),
        covariance: vec![1e-14, 0.0, 0.0, 0.0, 1e-14, 0.0, 0.0, 0.0, 1e-10],
        parcentric: Vec::new(),
        linked: 0,
        chi_sq: 2.0,
        freedom: 6,
    };
    folder.keep_calibration_set("Bench 1", &set).unwrap();
    let known = |value: f64| Known { value, sigma: 0.1 };
    let switching = SwitchingReport {
        from: ObjectiveId("10x".into()),
        to: ObjectiveId("40x".into()),
        arrivals: [5, 5],
        offset_um: [known(1.0), known(2.0)],
        repeatability_um: [known(1.0); 2],
        repeatability_deg: known(0.01),
        focus: None,
    };
    folder.keep_switching("Bench 1", &switching).unwrap();
    folder
        .keep_shadows("Bench 1", &FlatField::new(4, 3, vec![0.5; 12]).unwrap())
        .unwrap();
    for (job, ends) in [("reposition", true), ("focus", false)] {
        let mut run = folder.begin_run(&common::head(job, "spot")).unwrap();
        run.event(&json!({"of": job}).to_string());
        run.event("{}");
        if ends {
            run.attach("report.html", b"<p>").unwrap();
            run.end(&json!({"verdict": "arrived"})).unwrap();
        }
    }
    folder
}

fn objective() -> Objective {
    Objective {
        id: ObjectiveId("Plan 40x/0.65".into()),
        magnification: 400.0,
        numerical_aperture: 0.65,
        nominal_um_per_px: 0.2,
        immersion: Immersion::Air,
    }
}

/// Everything of [`old`] is in it.
fn is_whole(library: &Database, before: [&scopeservo_library::KeptTarget; 2]) {
    assert_eq!(library.target_names().unwrap(), ["first", "other", "spot"]);
    assert_eq!(&library.target("spot").unwrap(), before[0]);
    assert_eq!(&library.target("first").unwrap(), before[1]);
    assert_eq!(library.target_label("spot").unwrap().note, "a note");
    assert!(library.target_picture("spot").is_some());
    assert_eq!(
        library
            .bin()
            .unwrap()
            .iter()
            .filter(|row| row.name == "gone")
            .count(),
        2
    );
    let newest = library
        .calibration("Bench 1", &objective(), &[], [640, 480])
        .unwrap()
        .unwrap();
    assert_eq!(newest.calibration, calibration("Plan 40x/0.65", 0.2));
    assert_eq!(library.calibration_history().unwrap()[0].len(), 2);
    assert!(library.calibration_set("Bench 1").unwrap().is_some());
    assert_eq!(library.switchings("Bench 1").unwrap().len(), 1);
    assert!(library.shadows("Bench 1", [4, 3]).unwrap().is_some());
    let runs = library
        .runs(&RunQuery {
            limit: 9,
            ..RunQuery::default()
        })
        .unwrap();
    assert_eq!(
        (runs.len(), runs[0].job.as_str(), runs[1].verdict.as_deref()),
        (2, "focus", Some("arrived"))
    );
    assert!(
        runs.iter()
            .all(|run| library.run_events(&run.id).unwrap().len() == 2)
    );
    assert!(runs[1].report && runs[0].ended.is_none());
    let checked = library.check(false, &mut |_, _| {}).unwrap();
    assert_eq!(
        (checked.faults.len(), checked.litter.len()),
        (0, 0),
        "{checked:?}"
    );
}

#[test]
fn all_of_an_old_library_is_in_the_database_and_its_files_are_put_aside() {
    let dir = tempfile::tempdir().unwrap();
    let folder = old(dir.path());
    let (spot, first) = (
        folder.target("spot").unwrap(),
        folder.target("first").unwrap(),
    );
    let library = Database::new(dir.path().into());
    let mut told = Vec::new();
    let wrong = library
        .take_in(&mut |done, of| told.push((done, of)))
        .unwrap();
    assert!(wrong.is_empty(), "{wrong:?}");
    assert_eq!(told.last(), Some(&(12, 12)));
    is_whole(&library, [&spot, &first]);
    let mut left: Vec<String> = fs::read_dir(dir.path())
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    left.retain(|name| !name.starts_with("library.sqlite3") && name != ".lock");
    left.sort();
    assert_eq!(left, ["before-database", "objects"]);
    let aside = Folder::new(dir.path().join("before-database"));
    assert_eq!(aside.target("spot").unwrap(), spot);
    // Nothing is taken in twice, by nobody.
    let again = Database::new(dir.path().into());
    assert!(
        again
            .take_in(&mut |_, _| panic!("there is nothing to do"))
            .unwrap()
            .is_empty()
    );
    is_whole(&again, [&spot, &first]);
    // What is purged is deleted there, too.
    again.remove_target("spot").unwrap();
    again.purge_targets(None).unwrap();
    assert_eq!(aside.target_names().unwrap(), ["first", "other"]);
    assert!(
        fs::read_dir(dir.path().join("before-database/targets/removed"))
            .unwrap()
            .next()
            .is_none()
    );
}

#[test]
fn what_is_damaged_is_told_by_name_and_does_not_keep_the_rest_away() {
    let dir = tempfile::tempdir().unwrap();
    let folder = old(dir.path());
    let (spot, first) = (
        folder.target("spot").unwrap(),
        folder.target("first").unwrap(),
    );
    fs::write(dir.path().join("targets/half.target"), "half a file").unwrap();
    let newest = folder
        .calibration_path("Bench 1", &objective().id)
        .unwrap()
        .unwrap();
    fs::write(newest.with_file_name("000003_x.json"), "{").unwrap();
    let run = dir.path().join("runs/000009_x");
    fs::create_dir_all(&run).unwrap();
    fs::write(run.join("run.json"), "no json").unwrap();
    let library = Database::new(dir.path().into());
    let told: Vec<String> = library
        .take_in(&mut |_, _| {})
        .unwrap()
        .iter()
        .map(ToString::to_string)
        .collect();
    assert_eq!(told.len(), 2, "{told:?}");
    assert!(
        told.iter().any(|t| t.contains("000003_x.json"))
            && told.iter().any(|t| t.contains("run.json")),
        "{told:?}"
    );
    // A target has its name, and is told as what it is; it is found by nobody who looks for another.
    let half = library.target("half").unwrap_err();
    assert!(matches!(half, LibraryError::Damaged { .. }), "{half}");
    let row = library.target_row("half").unwrap();
    assert!(
        row.damaged
            .is_some_and(|what| what.contains("Move it away"))
    );
    library.remove_target("half").unwrap();
    library.purge_targets(Some(&["half".into()])).unwrap();
    is_whole(&library, [&spot, &first]);
    // What was not taken in stays where it was, and is told again until somebody moves it away.
    assert!(run.join("run.json").exists());
    let again = Database::new(dir.path().into());
    assert_eq!(again.take_in(&mut |_, _| {}).unwrap().len(), 2);
    fs::remove_dir_all(dir.path().join("runs")).unwrap();
    fs::remove_dir_all(dir.path().join("calibrations")).unwrap();
    let again = Database::new(dir.path().into());
    assert!(again.take_in(&mut |_, _| {}).unwrap().is_empty());
}

#[test]
fn a_file_that_is_put_there_later_is_taken_in_and_takes_no_name_away() {
    let dir = tempfile::tempdir().unwrap();
    let library = Database::new(dir.path().join("data"));
    keep(&library, "spot", &Label::default()).unwrap();
    let file = dir.path().join("spot.target");
    library.export_target("spot", &file).unwrap();
    let inbox = dir.path().join("data/targets");
    fs::create_dir_all(&inbox).unwrap();
    fs::copy(&file, inbox.join("SPOT.target")).unwrap();
    fs::copy(&file, inbox.join("carried.target")).unwrap();
    let library = Database::new(dir.path().join("data"));
    let told = library.take_in(&mut |_, _| {}).unwrap();
    assert_eq!(library.target_names().unwrap(), ["carried", "spot"]);
    assert!(
        told.len() == 1 && told[0].to_string().contains("already"),
        "{told:?}"
    );
    assert!(
        inbox.join("SPOT.target").exists(),
        "it stays until it has a name"
    );
    fs::rename(inbox.join("SPOT.target"), inbox.join("second.target")).unwrap();
    let library = Database::new(dir.path().join("data"));
    assert!(library.take_in(&mut |_, _| {}).unwrap().is_empty());
    assert_eq!(
        library.target_names().unwrap(),
        ["carried", "second", "spot"]
    );
}

#[test]
fn a_take_in_that_is_broken_off_goes_on_the_next_time() {
    for stop in [0, 1, 4, 8, 11] {
        let dir = tempfile::tempdir().unwrap();
        let folder = old(dir.path());
        let (spot, first) = (
            folder.target("spot").unwrap(),
            folder.target("first").unwrap(),
        );
        let broken = std::panic::catch_unwind(|| {
            let library = Database::new(dir.path().into());
            let _ = library.take_in(&mut |done, _| assert!(done < stop, "here it ends"));
        });
        assert!(broken.is_err());
        let library = Database::new(dir.path().into());
        assert!(library.take_in(&mut |_, _| {}).unwrap().is_empty());
        is_whole(&library, [&spot, &first]);
    }
}

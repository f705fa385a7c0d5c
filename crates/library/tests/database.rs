//! What a database keeps, finds again, and lets go of.

mod common;

use common::{calibration, keep, label, run};
use scopeservo_geometry::Mat2;
use scopeservo_library::{
    CalibrationSets as _, Calibrations, Cameras as _, Chance, Database, Fault, Folder, Label,
    LibraryError, NewPicture, Nosepieces as _, PICTURES, RunQuery, Runs as _, TargetQuery,
    Targets as _, restore,
};
use scopeservo_scope::{FlatField, Immersion, Objective, ObjectiveId};
use scopeservo_servo::Calibration;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

fn new() -> (tempfile::TempDir, Database) {
    let dir = tempfile::tempdir().unwrap();
    let library = Database::new(dir.path().join("data"));
    (dir, library)
}

fn found(library: &Database, query: &TargetQuery<'_>) -> Vec<String> {
    let rows = library.find_targets(query).unwrap();
    rows.into_iter().map(|row| row.name).collect()
}

/// All bytes of a folder's files, whatever they are.
fn bytes_below(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        match entry.path().is_dir() {
            true => all.extend(bytes_below(&entry.path())),
            false => all.push((entry.path(), fs::read(entry.path()).unwrap())),
        }
    }
    all
}

#[test]
fn nothing_is_made_on_disk_before_something_is_kept() {
    let (dir, library) = new();
    assert!(library.target_names().unwrap().is_empty());
    assert!(
        library
            .runs(&RunQuery {
                limit: 9,
                ..RunQuery::default()
            })
            .unwrap()
            .is_empty()
    );
    assert!(library.calibration_history().unwrap().is_empty());
    assert!(library.bin().unwrap().is_empty() && library.slides().unwrap().is_empty());
    library.check_new_target("spot").unwrap();
    assert!(library.take_in(&mut |_, _| {}).unwrap().is_empty());
    assert!(matches!(
        library.target("spot"),
        Err(LibraryError::NoTarget { .. })
    ));
    assert!(matches!(
        library.run("000001_x"),
        Err(LibraryError::NoRun { .. })
    ));
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn a_target_is_kept_with_its_slide_and_note_and_is_the_same_when_it_is_opened_again() {
    let (dir, library) = new();
    let file = keep(&library, "spot", &label("17-B", "the mitosis at the rim")).unwrap();
    assert!(file.is_file() && file.extension().is_some_and(|e| e == "target"));
    let library = Database::new(dir.path().join("data"));
    let row = library.target_row("spot").unwrap();
    assert_eq!(row.label, label("17-B", "the mitosis at the rim"));
    assert_eq!(
        (row.instrument.as_str(), row.objective.as_str(), row.size_px),
        ("lab", "40x", [4, 3])
    );
    let kept = library.target("spot").unwrap();
    assert_eq!(kept.target, common::view());
    assert_eq!((kept.id.len(), &row.id), (64, &kept.id));
    assert_eq!(library.target_picture("spot").unwrap().width, 4);
    library.label_target("spot", &label("", "another")).unwrap();
    assert_eq!(library.target_label("spot").unwrap(), label("", "another"));
    let slides = library.slides().unwrap();
    assert_eq!((slides.len(), slides[0].targets), (1, 0));
    for bad in ["", " 17", "a\nb", &"x".repeat(201)] {
        let said = library.label_target(
            "spot",
            &Label {
                slide: Some(bad.into()),
                note: String::new(),
            },
        );
        assert!(matches!(said, Err(LibraryError::BadName(_))), "{bad:?}");
    }
}

#[test]
fn a_name_is_given_once_whatever_its_case_and_is_free_again_when_it_is_in_the_bin() {
    let (_dir, library) = new();
    keep(&library, "spot", &Label::default()).unwrap();
    for name in ["spot", "SPOT", "Spot"] {
        assert!(
            matches!(
                library.check_new_target(name),
                Err(LibraryError::Taken { .. })
            ),
            "{name}"
        );
        assert!(
            matches!(
                keep(&library, name, &Label::default()),
                Err(LibraryError::Taken { .. })
            ),
            "{name}"
        );
    }
    keep(&library, "other", &Label::default()).unwrap();
    for (to, word) in [
        ("OTHER", "already"),
        ("Spot", "already"),
        ("CON", "device"),
        ("../x", "is no name"),
    ] {
        let said = library.rename_target("spot", to).unwrap_err().to_string();
        assert!(said.contains(word), "{to}: {said}");
    }
    library.rename_target("spot", "mitosis").unwrap();
    assert_eq!(library.target_names().unwrap(), ["mitosis", "other"]);
    library.remove_target("mitosis").unwrap();
    keep(&library, "mitosis", &label("", "the second")).unwrap();
    let said = library
        .restore_target("mitosis", None)
        .unwrap_err()
        .to_string();
    assert!(said.contains("already"), "{said}");
    library.restore_target("mitosis", Some("first")).unwrap();
    assert_eq!(
        library.target_names().unwrap(),
        ["first", "mitosis", "other"]
    );
    let said = library.restore_target("mitosis", None).unwrap_err();
    assert!(matches!(said, LibraryError::NotInBin { .. }), "{said}");
}

#[test]
fn targets_are_found_by_parts_of_words_of_name_note_and_slide() {
    let (_dir, library) = new();
    for (name, slide, note) in [
        ("mitosis-1", "17-B", "metaphase, Kernteilung"),
        ("mitosis-2", "17-B", "anaphase"),
        ("vessel", "18-A", "100% 'sharp' \"edge\" a_b"),
        ("noyau", "Müller 3", "éosine forte"),
    ] {
        keep(&library, name, &label(slide, note)).unwrap();
    }
    for (text, names) in [
        ("mitosis", vec!["mitosis-2", "mitosis-1"]),
        ("MITO", vec!["mitosis-2", "mitosis-1"]),
        ("itos", vec!["mitosis-2", "mitosis-1"]),
        ("phase 17-B", vec!["mitosis-2", "mitosis-1"]),
        ("teil", vec!["mitosis-1"]),
        ("eosine", vec!["noyau"]),
        ("muller", vec!["noyau"]),
        ("17", vec!["mitosis-2", "mitosis-1"]),
        ("0%", vec!["vessel"]),
        ("_b", vec!["vessel"]),
        ("\"edge\"", vec!["vessel"]),
        ("'sharp'", vec!["vessel"]),
        ("NOT vessel", vec![]),
        ("mitosis OR vessel", vec![]),
        ("*", vec![]),
        ("nothing", vec![]),
        ("", vec!["noyau", "vessel", "mitosis-2", "mitosis-1"]),
    ] {
        assert_eq!(
            found(
                &library,
                &TargetQuery {
                    text,
                    ..TargetQuery::default()
                }
            ),
            names,
            "{text}"
        );
    }
    let on = |slide| {
        found(
            &library,
            &TargetQuery {
                slide: Some(slide),
                ..TargetQuery::default()
            },
        )
    };
    assert_eq!(on("18-A"), ["vessel"]);
    assert!(on("18-a").is_empty());
    // Page by page it is the same list.
    let mut paged = Vec::new();
    loop {
        let after = paged.last().cloned();
        let page = found(
            &library,
            &TargetQuery {
                limit: 3,
                after: after.as_deref(),
                ..TargetQuery::default()
            },
        );
        if page.is_empty() {
            break;
        }
        paged.extend(page);
    }
    assert_eq!(paged, ["noyau", "vessel", "mitosis-2", "mitosis-1"]);
    // After one that is gone nobody knows what comes: not the list from its beginning.
    let after = TargetQuery {
        after: Some("gone"),
        ..TargetQuery::default()
    };
    let said = library.find_targets(&after).unwrap_err();
    assert!(matches!(said, LibraryError::NoTarget { .. }), "{said}");
    // By how surely they are come back to.
    let open = rusqlite::Connection::open(library.file()).unwrap();
    for (name, chance) in [("noyau", 0.95), ("vessel", 0.9), ("mitosis-2", 0.3)] {
        let quality = format!("{{\"chance\": {chance}}}");
        let set = "UPDATE targets SET quality = ?1 WHERE name = ?2";
        open.execute(set, [quality.as_str(), name]).unwrap();
    }
    let by = |chance| {
        let query = TargetQuery {
            chance: Some(chance),
            ..TargetQuery::default()
        };
        found(&library, &query)
    };
    let of = |least, below| Chance::Of { least, below };
    assert_eq!(by(of(0.9, f64::INFINITY)), ["noyau", "vessel"]);
    assert_eq!(by(of(f64::NEG_INFINITY, 0.9)), ["mitosis-2"]);
    assert_eq!(by(Chance::Unknown), ["mitosis-1"]);
}

#[test]
fn the_newest_measurement_counts_and_one_that_was_moved_away_does_not() {
    let (_dir, library) = new();
    let objective = Objective {
        id: ObjectiveId("40x".into()),
        magnification: 400.0,
        numerical_aperture: 0.65,
        nominal_um_per_px: 0.2,
        immersion: Immersion::Air,
    };
    let files = [0.19, 0.2, 0.21].map(|um| {
        library
            .keep_calibration("lab", &calibration("40x", um), None, None)
            .unwrap()
    });
    let newest = || library.calibration("lab", &objective, &[]);
    assert_eq!(
        newest().unwrap().unwrap().calibration,
        calibration("40x", 0.21)
    );
    assert_eq!(library.calibration_history().unwrap()[0].len(), 3);
    let before = fs::read(&files[2]).unwrap();
    for damage in ["", "{}", "{\"schema\":7}"] {
        fs::write(&files[2], damage).unwrap();
        let said = newest().unwrap_err().to_string();
        assert!(
            said.contains("is damaged") && said.contains(files[1].to_str().unwrap()),
            "{said}"
        );
    }
    fs::remove_file(&files[2]).unwrap();
    assert_eq!(
        newest().unwrap().unwrap().calibration,
        calibration("40x", 0.2)
    );
    fs::write(&files[2], before).unwrap();
    assert_eq!(
        newest().unwrap().unwrap().calibration,
        calibration("40x", 0.21)
    );
    assert_eq!(library.calibration_set("lab").unwrap(), None);
    assert!(library.switchings("lab").unwrap().is_empty());
    // Of shadows the former ones are gone: each run sees them anew.
    for shade in [0.5, 0.25] {
        let seen = FlatField::new(4, 3, vec![shade; 12]).unwrap();
        library.keep_shadows("lab", &seen).unwrap();
        assert_eq!(library.shadows("lab", [4, 3]).unwrap(), Some(seen));
    }
    assert_eq!(library.shadows("other", [4, 3]).unwrap(), None);
    let pictures = bytes_below(&library.path().join("objects"));
    let pictures = pictures
        .iter()
        .filter(|(p, _)| p.extension().is_some_and(|e| e == "png"));
    assert_eq!(pictures.count(), 1);
}

/// Two instruments that share a library, with stages whose axes go the other way round: what one measured the other must never move by.
#[test]
fn each_instrument_has_its_own_calibrations_whoever_measured_last() {
    let (_dir, library) = new();
    let folder = Folder::new(library.path().join("files"));
    let objective = Objective {
        id: ObjectiveId("40x".into()),
        magnification: 400.0,
        numerical_aperture: 0.65,
        nominal_um_per_px: 0.2,
        immersion: Immersion::Air,
    };
    let turned = |um: f64| Calibration {
        stage_from_pixel: Mat2::diagonal(-um * 1e-6, -um * 1e-6),
        ..calibration("40x", um)
    };
    let both: [&dyn Calibrations; 2] = [&library, &folder];
    for library in both {
        let of = |instrument: &str| {
            let kept = library.calibration(instrument, &objective, &[]).unwrap();
            kept.map(|kept| kept.calibration)
        };
        let keep = |instrument: &str, calibration: &Calibration| {
            let path = library.keep_calibration(instrument, calibration, None, None);
            let path = path.unwrap();
            let newest = library.calibration_path(instrument, &objective.id);
            assert_eq!(newest.unwrap(), Some(path.clone()));
            path
        };
        keep("left", &calibration("40x", 0.2));
        assert_eq!(of("left"), Some(calibration("40x", 0.2)));
        assert_eq!(of("right"), None);
        let right = keep("right", &turned(0.21));
        assert_eq!(of("left"), Some(calibration("40x", 0.2)));
        assert_eq!(of("right"), Some(turned(0.21)));
        let left = keep("left", &calibration("40x", 0.19));
        assert_eq!(of("right"), Some(turned(0.21)));
        // A name that is nearly the same is another's.
        assert_eq!(of("Left"), None);
        // One that is damaged: nobody else's takes its place.
        fs::write(&left, "{}").unwrap();
        for instrument in ["left", "right"] {
            match library.calibration(instrument, &objective, &[]) {
                Ok(Some(kept)) => {
                    assert_eq!((instrument, kept.calibration), ("right", turned(0.21)))
                }
                Err(error) => {
                    let said = error.to_string();
                    assert!(
                        !said.contains(right.to_str().unwrap()) || instrument == "right",
                        "{said}"
                    );
                }
                Ok(None) => panic!("{instrument}"),
            }
        }
        fs::remove_file(&left).unwrap();
        assert_eq!(of("left"), Some(calibration("40x", 0.2)));
        // One of before instruments were named is anybody's, as it was.
        keep("", &calibration("40x", 0.22));
        assert_eq!(of("left"), Some(calibration("40x", 0.22)));
        assert_eq!(of("new"), Some(calibration("40x", 0.22)));
        keep("right", &turned(0.23));
        assert_eq!(of("right"), Some(turned(0.23)));
        assert_eq!(of("left"), Some(calibration("40x", 0.22)));
    }
}

#[test]
fn pictures_are_kept_as_they_came_once_each_and_go_with_their_files() {
    let dir = tempfile::tempdir().unwrap();
    let library = Database::new(dir.path().join("data"));
    assert!(library.pictures().unwrap().is_empty());
    fn new(name: &str) -> NewPicture<'_> {
        NewPicture {
            name,
            um_per_px: 0.25,
            size_px: [640, 480],
            user: "anna",
        }
    }
    let row = library.keep_picture(new("one"), b"bytes", "png").unwrap();
    library.keep_picture(new("two"), b"bytes", "png").unwrap();
    assert_eq!(library.pictures().unwrap().len(), 2);
    let (again, path) = library.picture("one").unwrap();
    assert_eq!(again, row);
    assert_eq!(fs::read(&path).unwrap(), b"bytes");
    for (name, what) in [
        ("ONE", "Taken"),
        ("../up", "BadName"),
        ("", "BadName"),
        ("a/b", "BadName"),
    ] {
        let said = format!(
            "{:?}",
            library.keep_picture(new(name), b"x", "png").unwrap_err()
        );
        assert!(said.starts_with(what), "{name}: {said}");
    }
    let checked = library.check(false, &mut |_, _| {}).unwrap();
    assert_eq!((checked.faults.len(), checked.litter.len()), (0, 0));
    // Mending takes none away, and one that is damaged is told.
    library.check(true, &mut |_, _| {}).unwrap();
    library.remove_picture("one").unwrap();
    assert!(path.exists(), "the other is the same picture");
    fs::write(&path, b"other").unwrap();
    assert!(matches!(
        library.picture("two"),
        Err(LibraryError::Damaged { .. })
    ));
    let checked = library.check(false, &mut |_, _| {}).unwrap();
    assert!(matches!(&checked.faults[..], [Fault::Changed { of, .. }] if of == "picture two"));
    library.remove_picture("two").unwrap();
    assert!(!path.exists());
    let none = library.remove_picture("two").unwrap_err();
    assert!(matches!(none, LibraryError::NoPicture { .. }));
    for k in 0..PICTURES {
        let name = format!("p-{k}");
        let kept = library.keep_picture(new(&name), &[k as u8], "png");
        kept.unwrap();
    }
    let said = library.keep_picture(new("more"), b"x", "png").unwrap_err();
    assert!(matches!(said, LibraryError::TooManyPictures { .. }));
}

#[test]
fn a_run_is_kept_with_its_events_and_is_one_of_the_visits_to_its_target() {
    let (_dir, library) = new();
    keep(&library, "spot", &Label::default()).unwrap();
    let first = run(&library, "reposition", "spot", 3, b"<p>one");
    let second = run(&library, "focus", "spot", 1, b"<p>two");
    let third = run(&library, "reposition", "spot", 0, b"<p>three");
    assert!(
        first.starts_with("000001_") && first.ends_with("_reposition"),
        "{first}"
    );
    let ids = |query: &RunQuery<'_>| -> Vec<String> {
        library
            .runs(query)
            .unwrap()
            .into_iter()
            .map(|r| r.id)
            .collect()
    };
    assert_eq!(
        ids(&RunQuery {
            limit: 9,
            ..RunQuery::default()
        }),
        [third.clone(), second.clone(), first.clone()]
    );
    assert_eq!(
        ids(&RunQuery {
            limit: 1,
            before: Some(&third),
            ..RunQuery::default()
        }),
        [second]
    );
    assert_eq!(
        ids(&RunQuery {
            limit: 9,
            target: Some("spot"),
            ..RunQuery::default()
        }),
        [third, first.clone()]
    );
    let row = library.run(&first).unwrap();
    assert_eq!(
        (row.user.as_deref(), row.verdict.as_deref(), row.seconds),
        (Some("anna"), Some("arrived"), Some(1.5))
    );
    assert!(row.ended.is_some() && row.report);
    let events = library.run_events(&first).unwrap();
    assert_eq!(events.len(), 3);
    assert_eq!(
        serde_json::from_str::<serde_json::Value>(&events[2]).unwrap()["event"],
        2
    );
    let (asked, answer) = library.run_said(&first).unwrap();
    assert_eq!(
        (asked["name"].as_str(), answer.unwrap()["verdict"].as_str()),
        (Some("spot"), Some("arrived"))
    );
    let report = library.run_file(&first, "report.html").unwrap().unwrap();
    assert_eq!(fs::read(report).unwrap(), b"<p>one");
    // One that was killed has its events, and no end.
    let mut killed = library
        .begin_run(&common::head("reposition", "spot"))
        .unwrap();
    killed.event("{\"last\":true}");
    let id = killed.id().to_owned();
    drop(killed);
    assert_eq!(library.run_events(&id).unwrap(), ["{\"last\":true}"]);
    assert_eq!(library.run(&id).unwrap().ended, None);
}

#[test]
fn what_is_purged_is_nowhere_any_more_and_what_is_only_in_the_bin_is_as_it_was() {
    let (_dir, library) = new();
    keep(
        &library,
        "Geheimnis-Eins",
        &label("Patient Zwiebel", "Notizwort"),
    )
    .unwrap();
    keep(&library, "stays", &label("Patient Anders", "Bleibwort")).unwrap();
    let failed = run(
        &library,
        "save_target",
        "Geheimnis-Eins",
        2,
        b"<p>Geheimnis-Eins failed",
    );
    run(
        &library,
        "reposition",
        "Geheimnis-Eins",
        50,
        b"<p>Geheimnis-Eins",
    );
    let other = run(&library, "reposition", "stays", 2, b"<p>stays");
    let before = library.target("Geheimnis-Eins").unwrap();
    library.remove_target("Geheimnis-Eins").unwrap();
    assert_eq!(library.target_names().unwrap(), ["stays"]);
    assert!(
        found(
            &library,
            &TargetQuery {
                text: "Geheimnis",
                ..TargetQuery::default()
            }
        )
        .is_empty()
    );
    assert_eq!(library.bin().unwrap()[0].name, "Geheimnis-Eins");
    library.restore_target("Geheimnis-Eins", None).unwrap();
    assert_eq!(library.target("Geheimnis-Eins").unwrap(), before);
    library.remove_target("Geheimnis-Eins").unwrap();
    let none = library
        .purge_targets(Some(&["Geheimnis-Eins".into(), "nobody".into()]))
        .unwrap_err();
    assert!(matches!(none, LibraryError::NotInBin { .. }));
    assert_eq!(
        library.bin().unwrap().len(),
        1,
        "nothing is purged when one is not there"
    );
    let purged = library
        .purge_targets(Some(&["Geheimnis-Eins".into()]))
        .unwrap();
    assert_eq!(
        (purged[0].name.as_str(), purged[0].runs.len()),
        ("Geheimnis-Eins", 2)
    );
    assert!(purged[0].runs.contains(&failed));
    for (file, bytes) in bytes_below(library.path()) {
        for word in ["Geheimnis", "Zwiebel", "Notizwort"] {
            let there = bytes.windows(word.len()).any(|w| w == word.as_bytes());
            assert!(!there, "{word} is in {}", file.display());
        }
    }
    assert_eq!(library.run_events(&other).unwrap().len(), 2);
    assert_eq!(
        found(
            &library,
            &TargetQuery {
                text: "Bleibwort",
                ..TargetQuery::default()
            }
        ),
        ["stays"]
    );
    assert_eq!(library.check(false, &mut |_, _| {}).unwrap().faults, []);
    assert!(library.purge_targets(None).unwrap().is_empty());
}

#[test]
fn two_targets_that_share_a_picture_do_not_lose_it_with_one_of_them() {
    let (_dir, library) = new();
    // The same letters, the same level, the same picture.
    keep(&library, "abc", &Label::default()).unwrap();
    keep(&library, "cab", &Label::default()).unwrap();
    library.remove_target("abc").unwrap();
    library.purge_targets(None).unwrap();
    assert!(library.target_picture("cab").is_some());
    assert_eq!(library.check(false, &mut |_, _| {}).unwrap().faults, []);
}

#[test]
fn frames_of_the_oldest_runs_go_first_and_events_never() {
    let (_dir, library) = new();
    let ids: Vec<String> = (0..5u8)
        .map(|k| run(&library, "focus", "", 2, &vec![k; 1000]))
        .collect();
    library.pin_run(&ids[1], true).unwrap();
    assert_eq!(library.frames_bytes().unwrap(), 5000);
    assert!(library.keep_frames_within(5000).unwrap().is_empty());
    assert_eq!(
        library.keep_frames_within(3000).unwrap(),
        [ids[0].clone(), ids[2].clone()]
    );
    let with: Vec<bool> = ids
        .iter()
        .map(|id| library.run(id).unwrap().report)
        .collect();
    assert_eq!(with, [false, true, false, true, true]);
    // The newest keeps its own, whatever the budget.
    library.keep_frames_within(0).unwrap();
    assert_eq!(library.frames_bytes().unwrap(), 2000);
    assert!(
        ids.iter()
            .all(|id| library.run_events(id).unwrap().len() == 2)
    );
    assert_eq!(library.check(false, &mut |_, _| {}).unwrap().faults, []);
}

#[test]
fn a_check_names_what_is_gone_or_changed_and_mends_what_nothing_names() {
    let (_dir, library) = new();
    let gone = keep(&library, "gone", &Label::default()).unwrap();
    let changed = keep(&library, "changed", &label("", "x")).unwrap();
    keep(&library, "sound", &Label::default()).unwrap();
    run(&library, "focus", "", 7, b"<p>");
    library
        .keep_calibration("lab", &calibration("40x", 0.2), None, None)
        .unwrap();
    let whole = library.check(false, &mut |_, _| {}).unwrap();
    assert_eq!(
        (whole.targets, whole.runs, whole.events, whole.measurements),
        (3, 1, 7, 1)
    );
    assert_eq!((whole.faults.len(), whole.litter.len()), (0, 0));
    fs::remove_file(&gone).unwrap();
    fs::write(&changed, "another").unwrap();
    let litter = library.path().join("objects/zz/none.target");
    fs::create_dir_all(litter.parent().unwrap()).unwrap();
    fs::write(&litter, "left by a killed program").unwrap();
    let checked = library.check(false, &mut |_, _| {}).unwrap();
    assert_eq!(checked.litter, std::slice::from_ref(&litter));
    let of = |fault: &Fault| match fault {
        Fault::Missing { of, .. } => format!("missing {of}"),
        Fault::Changed { of, .. } => format!("changed {of}"),
        other => other.to_string(),
    };
    let mut told: Vec<String> = checked.faults.iter().map(of).collect();
    told.sort();
    assert_eq!(told, ["changed target changed", "missing target gone"]);
    let mended = library.check(true, &mut |_, _| {}).unwrap();
    assert!(mended.mended && !litter.exists());
    assert_eq!(mended.faults.len(), 2, "what is gone is not mended");
    assert_eq!(
        library.target_names().unwrap().len(),
        3,
        "and is not forgotten"
    );
}

#[test]
fn a_backup_is_the_library_and_is_brought_back_whole_or_not_at_all() {
    let (dir, library) = new();
    keep(&library, "spot", &label("17-B", "a note")).unwrap();
    keep(&library, "binned", &Label::default()).unwrap();
    library.remove_target("binned").unwrap();
    let id = run(&library, "reposition", "spot", 4, b"<p>");
    let file = dir.path().join("backup.tar");
    let done = library.back_up(&file, &mut |_, _| {}).unwrap();
    assert!(done.missing.is_empty() && done.objects == 5, "{done:?}");
    assert!(
        library.back_up(&file, &mut |_, _| {}).is_err(),
        "none is overwritten"
    );
    let elsewhere = dir.path().join("elsewhere");
    let brought = restore(&file, &elsewhere, false).unwrap();
    assert_eq!((brought.objects, brought.summed), (5, true));
    assert_eq!(brought.missing, [""; 0]);
    let back = Database::new(elsewhere.clone());
    assert_eq!(
        back.target("spot").unwrap(),
        library.target("spot").unwrap()
    );
    assert_eq!(
        back.target_row("spot").unwrap(),
        library.target_row("spot").unwrap()
    );
    assert_eq!(back.run_events(&id).unwrap().len(), 4);
    assert_eq!(back.bin().unwrap().len(), 1);
    assert_eq!(back.check(false, &mut |_, _| {}).unwrap().faults, []);
    assert!(
        restore(&file, &elsewhere, false).is_err(),
        "no library is overwritten"
    );
}

#[test]
fn a_backup_and_a_purge_at_once_end_both() {
    let (dir, library) = new();
    for k in 0..20 {
        keep(&library, &format!("t-{k}"), &Label::default()).unwrap();
    }
    std::thread::scope(|threads| {
        threads.spawn(|| {
            for k in 0..10 {
                let file = dir.path().join(format!("{k}.tar"));
                let done = library.back_up(&file, &mut |_, _| {}).unwrap();
                assert!(done.missing.is_empty(), "{done:?}");
            }
        });
        for k in 0..20 {
            library.remove_target(&format!("t-{k}")).unwrap();
            library.purge_targets(None).unwrap();
        }
    });
    assert_eq!(library.check(false, &mut |_, _| {}).unwrap().targets, 0);
}

#[test]
fn an_export_is_plain_files_that_another_library_takes_in_again() {
    let (dir, library) = new();
    keep(&library, "spot", &label("17-B", "a note")).unwrap();
    keep(&library, "plain", &Label::default()).unwrap();
    library
        .keep_calibration("lab", &calibration("40x", 0.2), None, None)
        .unwrap();
    library
        .keep_calibration("lab", &calibration("Plan 10x/0.25", 0.8), None, None)
        .unwrap();
    library
        .keep_shadows("lab", &FlatField::new(4, 3, vec![0.5; 12]).unwrap())
        .unwrap();
    let id = run(&library, "reposition", "spot", 4, b"<p>");
    let out = dir.path().join("out");
    let done = library.export(&out, &mut |_, _| {}).unwrap();
    assert_eq!(
        (done.targets, done.measurements, done.runs, done.left.len()),
        (2, 3, 1, 0)
    );
    assert!(
        out.join("targets/spot.target").is_file()
            && out.join("runs").join(&id).join("events.jsonl").is_file()
    );
    assert!(
        library.export(&out, &mut |_, _| {}).is_err(),
        "only into an empty folder"
    );
    let back = Database::new(out);
    assert!(back.take_in(&mut |_, _| {}).unwrap().is_empty());
    let row = |library: &Database, name| library.target_row(name).unwrap();
    for name in ["spot", "plain"] {
        assert_eq!(row(&back, name), row(&library, name));
        assert_eq!(back.target(name).unwrap(), library.target(name).unwrap());
    }
    assert_eq!(back.calibration_history().unwrap().len(), 2);
    assert!(back.shadows("lab", [4, 3]).unwrap().is_some());
    assert_eq!(
        back.run_events(&id).unwrap(),
        library.run_events(&id).unwrap()
    );
    assert_eq!(back.run(&id).unwrap().verdict.as_deref(), Some("arrived"));
    assert!(back.run(&id).unwrap().report);
    assert_eq!(back.check(false, &mut |_, _| {}).unwrap().faults, []);
}

#[test]
fn a_database_that_was_lost_is_made_anew_from_the_files_beside_it() {
    let (_dir, library) = new();
    keep(&library, "spot", &label("17-B", "lost with the rows")).unwrap();
    keep(&library, "other", &Label::default()).unwrap();
    library
        .keep_calibration("lab", &calibration("40x", 0.19), None, None)
        .unwrap();
    library
        .keep_calibration("lab", &calibration("40x", 0.2), None, None)
        .unwrap();
    let before = library.target("spot").unwrap();
    let folder = library.path().to_owned();
    assert!(
        library.rebuild(&mut |_, _| {}).is_err(),
        "none is made in place of one"
    );
    drop(library);
    for ending in ["", "-wal", "-shm"] {
        let _ = fs::remove_file(folder.join(format!("library.sqlite3{ending}")));
    }
    let library = Database::new(folder);
    let mut made = library.rebuild(&mut |_, _| {}).unwrap();
    made.targets.sort();
    assert_eq!(
        (made.targets, made.measurements),
        (vec!["other".to_owned(), "spot".into()], 2)
    );
    assert_eq!(library.target("spot").unwrap(), before);
    assert_eq!(library.calibration_history().unwrap()[0].len(), 2);
}

#[test]
fn a_database_of_a_newer_version_of_another_program_or_damaged_is_refused_and_left_as_it_is() {
    let (_dir, library) = new();
    keep(&library, "spot", &Label::default()).unwrap();
    let (folder, file) = (library.path().to_owned(), library.file());
    drop(library);
    let open = rusqlite::Connection::open(&file).unwrap();
    open.pragma_update(None, "user_version", 99).unwrap();
    drop(open);
    let said = Database::new(folder.clone()).target_names().unwrap_err();
    assert!(
        matches!(said, LibraryError::Newer { version: 99, .. }),
        "{said}"
    );
    fs::remove_file(&file).unwrap();
    let open = rusqlite::Connection::open(&file).unwrap();
    open.execute_batch("CREATE TABLE theirs (x)").unwrap();
    drop(open);
    let said = Database::new(folder.clone())
        .target_names()
        .unwrap_err()
        .to_string();
    assert!(said.contains("another program"), "{said}");
    for ending in ["-wal", "-shm"] {
        let _ = fs::remove_file(folder.join(format!("library.sqlite3{ending}")));
    }
    for damage in [
        &b"no database at all, and long enough to be one"[..],
        &[0x53; 5000],
    ] {
        fs::write(&file, damage).unwrap();
        let library = Database::new(folder.clone());
        let said = library.target_names().unwrap_err();
        assert!(matches!(said, LibraryError::Damaged { .. }), "{said}");
        assert!(said.to_string().contains("library rebuild"), "{said}");
        assert!(
            library.check_new_target("new").is_err(),
            "nothing is done for what cannot be kept"
        );
        assert_eq!(fs::read(&file).unwrap(), damage);
    }
}

#[test]
fn several_programs_write_at_once_and_all_is_there() {
    let (dir, _) = new();
    std::thread::scope(|threads| {
        for who in 0..4 {
            let folder = dir.path().join("data");
            threads.spawn(move || {
                let library = Database::new(folder);
                for k in 0..10 {
                    keep(
                        &library,
                        &format!("t-{who}-{k}"),
                        &label(&format!("slide {k}"), ""),
                    )
                    .unwrap();
                    run(&library, "focus", "", 5, &[who; 100]);
                }
            });
        }
    });
    let library = Database::new(dir.path().join("data"));
    let checked = library.check(false, &mut |_, _| {}).unwrap();
    assert_eq!(
        (checked.targets, checked.runs, checked.events),
        (40, 40, 200)
    );
    assert_eq!((checked.faults.len(), checked.litter.len()), (0, 0));
    assert_eq!(library.slides().unwrap().len(), 10);
}

#[test]
fn who_waits_too_long_for_another_program_is_told_so() {
    let (_dir, library) = new();
    keep(&library, "spot", &Label::default()).unwrap();
    let other = rusqlite::Connection::open(library.file()).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    assert_eq!(
        library.target_names().unwrap(),
        ["spot"],
        "reading waits for nobody"
    );
    library.set_patience(Duration::from_millis(20)).unwrap();
    let said = library.remove_target("spot").unwrap_err();
    assert!(matches!(said, LibraryError::Busy { .. }), "{said}");
    other.execute_batch("COMMIT").unwrap();
    library.remove_target("spot").unwrap();
}

#[test]
fn a_folder_that_takes_no_files_is_told_before_anything_is_done() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("data"), "in the way").unwrap();
    let library = Database::new(dir.path().join("data"));
    for said in [
        library.try_targets(),
        library.check_new_target("spot"),
        library.try_calibrations(&[]),
    ] {
        assert!(
            matches!(said, Err(LibraryError::CannotWrite { .. })),
            "{said:?}"
        );
    }
    let error = keep(&library, "spot", &Label::default()).unwrap_err();
    assert!(
        matches!(
            error,
            LibraryError::CannotWrite { .. } | LibraryError::NotKept { .. }
        ),
        "{error}"
    );
    assert!(library.begin_run(&common::head("focus", "")).is_err());
}

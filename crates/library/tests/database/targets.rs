//! Targets: their names, slides and notes, and how they are found.

use super::*;

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
    // By its number the place is known also where the name is not the one in the list, until nothing is left of it.
    let numbered = |number| {
        library.find_targets(&TargetQuery {
            after_number: Some(number),
            ..TargetQuery::default()
        })
    };
    let vessel = library.target_row("vessel").unwrap().number;
    let names = |rows: Vec<scopeservo_library::TargetRow>| -> Vec<String> {
        rows.into_iter().map(|row| row.name).collect()
    };
    assert_eq!(names(numbered(vessel).unwrap()), ["mitosis-2", "mitosis-1"]);
    let said = numbered(9999).unwrap_err();
    assert!(
        matches!(said, LibraryError::NoTargetNumbered { number: 9999 }),
        "{said}"
    );
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
fn the_bin_is_read_page_by_page_whatever_has_one_name_comes_and_goes() {
    let (_dir, library) = new();
    for k in 0..7 {
        let name = if k % 2 == 0 { "same" } else { "other" };
        keep(&library, name, &label("17-B", &format!("the {k}th"))).unwrap();
        library.remove_target(name).unwrap();
    }
    let page = |after_number, limit| {
        library.find_targets(&TargetQuery {
            binned: true,
            after_number,
            limit,
            ..TargetQuery::default()
        })
    };
    let all = page(None, 0).unwrap();
    assert_eq!(all.len(), 7);
    let mut paged = page(None, 2).unwrap();
    // The last one that was read is taken out of the bin, the first one is deleted for good, and one more comes.
    let last = paged.last().unwrap();
    library.restore_target(&last.name, Some("back")).unwrap();
    keep(&library, "new", &label("17-B", "")).unwrap();
    library.remove_target("new").unwrap();
    loop {
        let more = page(paged.last().map(|row| row.number), 2).unwrap();
        if more.is_empty() {
            break;
        }
        paged.extend(more);
    }
    let notes = |rows: &[scopeservo_library::TargetRow]| -> Vec<String> {
        rows.iter().map(|row| row.label.note.clone()).collect()
    };
    // All that was there is told once, in the same order.
    assert_eq!(notes(&paged), notes(&all));
    let gone = paged[3].number;
    library.purge_targets(None).unwrap();
    let said = page(Some(gone), 2).unwrap_err();
    assert!(
        matches!(said, LibraryError::NoTargetNumbered { number } if number == gone),
        "{said}"
    );
}

//! What is purged, and what stays.

use super::*;

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

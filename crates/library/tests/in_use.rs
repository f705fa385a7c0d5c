//! What a run goes to is there until the run has ended, whichever program does it.

mod common;

use common::{head, keep, label};
use scopeservo_library::{
    Database, Journal as _, JournalHead, LibraryError, Runs as _, Targets as _, Use,
};
use serde_json::json;
use std::fs;

fn in_use(by: Use) -> impl Fn(LibraryError) -> bool {
    move |error| matches!(&error, LibraryError::InUse { name, by: is } if name == "spot" && *is == by)
}

/// Two programs with one library, as two that opened it; the second asks for what the first is at.
fn two() -> (tempfile::TempDir, Database, Database) {
    let dir = tempfile::tempdir().unwrap();
    let open = || Database::new(dir.path().join("data"));
    let (one, other) = (open(), open());
    for name in ["spot", "other"] {
        keep(&one, name, &label("", "")).unwrap();
    }
    (dir, one, other)
}

#[test]
fn what_a_run_goes_to_is_neither_removed_nor_renamed_nor_purged_until_it_has_ended() {
    let (_dir, one, other) = two();
    let is_run = in_use(Use::Run);
    let mut run = one.begin_run(&head("reposition", "spot")).unwrap();
    for library in [&one, &other] {
        assert!(is_run(library.remove_target("spot").unwrap_err()));
        assert!(is_run(library.rename_target("spot", "new").unwrap_err()));
        assert_eq!(library.target("spot").unwrap().instrument, "lab");
        // What is said of it may change, and others may go.
        library.label_target("spot", &label("17B", "seen")).unwrap();
    }
    other.rename_target("other", "else").unwrap();
    other.remove_target("else").unwrap();
    run.end(&json!({"verdict": "arrived"})).unwrap();
    drop(run);
    other.rename_target("spot", "new").unwrap();
    other.remove_target("new").unwrap();
    assert_eq!(other.purge_targets(None).unwrap().len(), 2);
}

#[test]
fn what_lies_in_the_bin_is_not_purged_while_a_run_has_its_name_and_nothing_is_purged_then() {
    let (_dir, one, other) = two();
    // Removed just before a run to it began that had read it already.
    for name in ["spot", "other"] {
        one.remove_target(name).unwrap();
    }
    let run = one.begin_run(&head("reposition", "spot")).unwrap();
    let names = |all: &[&str]| all.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
    for asked in [
        None,
        Some(names(&["spot"])),
        Some(names(&["other", "spot"])),
    ] {
        let said = other.purge_targets(asked.as_deref()).unwrap_err();
        assert!(in_use(Use::Run)(said));
        assert_eq!(one.bin().unwrap().len(), 2);
    }
    assert_eq!(
        other.purge_targets(Some(&names(&["other"]))).unwrap().len(),
        1
    );
    // A program that is killed holds nothing any more.
    drop(run);
    assert_eq!(other.purge_targets(None).unwrap()[0].runs.len(), 1);
}

#[test]
fn a_run_whose_program_was_killed_keeps_its_target_while_it_may_go_on() {
    let (dir, one, other) = two();
    let id = one.target("spot").unwrap().id;
    let left = JournalHead {
        job: "reposition".into(),
        began: "2026-11-26T04:00:00Z".into(),
        inputs: json!({"name": "spot"}),
        target: Some(["spot".into(), id]),
    };
    // Of whatever instrument: the library is that of all.
    one.begin_journal("bench 2", &left).unwrap();
    let is_left = in_use(Use::Left);
    assert!(is_left(other.remove_target("spot").unwrap_err()));
    assert!(is_left(other.rename_target("spot", "new").unwrap_err()));
    let said = other.remove_target("spot").unwrap_err().to_string();
    assert!(
        said.contains("scopeservo resume") && said.contains("scopeservo abandon"),
        "{said}"
    );
    other.remove_target("other").unwrap();
    // Put aside, as nobody can read it, it holds nothing; nor does one that is damaged.
    let mut journals = fs::read_dir(dir.path().join("data/journal")).unwrap();
    let journal = journals.next().unwrap().unwrap().path();
    let head_file = fs::read(journal.join("head.json")).unwrap();
    fs::write(journal.join("head.json"), "{").unwrap();
    other.rename_target("spot", "new").unwrap();
    other.rename_target("new", "spot").unwrap();
    fs::write(journal.join("head.json"), head_file).unwrap();
    assert!(is_left(other.remove_target("spot").unwrap_err()));
    one.set_journal_aside("bench 2").unwrap();
    other.remove_target("spot").unwrap();
    other.restore_target("spot", None).unwrap();
    // Ended by abandon, the same.
    one.begin_journal("bench 2", &left).unwrap();
    assert!(is_left(other.remove_target("spot").unwrap_err()));
    one.end_journal("bench 2").unwrap();
    other.remove_target("spot").unwrap();
}

#[test]
fn what_killed_programs_left_of_their_runs_is_swept_and_holds_nothing() {
    let (dir, one, other) = two();
    let folder = dir.path().join("data/under-way");
    let run = one.begin_run(&head("reposition", "spot")).unwrap();
    let id = run.id().to_owned();
    drop(run);
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
    // As a killed one leaves it: the file, without its lock.
    fs::write(folder.join(&id), "").unwrap();
    other.rename_target("spot", "new").unwrap();
    let run = other.begin_run(&head("reposition", "new")).unwrap();
    let there: Vec<_> = fs::read_dir(&folder).unwrap().flatten().collect();
    assert_eq!(there.len(), 1);
    assert_eq!(there[0].file_name().to_str(), Some(run.id()));
}

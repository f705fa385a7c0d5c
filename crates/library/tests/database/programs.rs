//! Several programs, other versions, and folders that take nothing.

use super::*;

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

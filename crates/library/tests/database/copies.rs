//! Check, backup, export, and a database made anew.

use super::*;

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
    // Its number is each library's own.
    let row = |library: &Database, name| {
        let mut row = library.target_row(name).unwrap();
        row.number = 0;
        row
    };
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

/// A library with a picture of each kind, and where its export has them.
fn with_pictures(dir: &Path, library: &Database) -> Vec<(PathBuf, Vec<u8>)> {
    keep(library, "spot", &label("17-B", "a note")).unwrap();
    keep(library, "plain", &Label::default()).unwrap();
    let mut run = library
        .begin_run(&common::head("reposition", "spot"))
        .unwrap();
    run.attach("arrival.jpg", b"what was seen").unwrap();
    let id = run.id().to_owned();
    run.end(&serde_json::json!({"verdict": "arrived"})).unwrap();
    let new = NewPicture {
        name: "gland",
        um_per_px: 0.25,
        size_px: [8, 6],
        user: "anna",
    };
    library.keep_picture(new, b"as it came", "tif").unwrap();
    let object = |name: &str| library.path().join("objects").join(&name[..2]).join(name);
    let open = rusqlite::Connection::open(library.file()).unwrap();
    let picture = |name: &str| {
        let of = "SELECT picture FROM targets WHERE name = ?1";
        let file: String = open.query_row(of, [name], |row| row.get(0)).unwrap();
        fs::read(object(&file)).unwrap()
    };
    vec![
        (dir.join("targets/spot.png"), picture("spot")),
        (dir.join("targets/plain.png"), picture("plain")),
        (
            dir.join("runs").join(id).join("arrival.jpg"),
            b"what was seen".into(),
        ),
        (dir.join("pictures/gland.tif"), b"as it came".into()),
    ]
}

#[test]
fn an_export_has_every_picture_byte_by_byte_and_names_what_is_damaged() {
    let (dir, library) = new();
    let out = dir.path().join("out");
    let pictures = with_pictures(&out, &library);
    let done = library.export(&out, &mut |_, _| {}).unwrap();
    assert_eq!(
        (done.targets, done.runs, done.pictures, done.left.len()),
        (2, 1, 4, 0)
    );
    for (file, bytes) in &pictures {
        assert!(&fs::read(file).unwrap() == bytes, "{}", file.display());
    }
    let said = fs::read_to_string(out.join("pictures/gland.json")).unwrap();
    let said: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(
        (&said["um_per_px"], &said["user"]),
        (&0.25.into(), &"anna".into())
    );
    assert!(!out.join("UNFINISHED.txt").exists());
    assert!(
        library.export(&out, &mut |_, _| {}).is_err(),
        "only an unfinished one goes on"
    );
    // Each of them damaged in turn: told by what it is, and all others are there.
    let named = [
        "the picture of 'spot'",
        "the picture of 'plain'",
        "arrival.jpg of the run '",
        "the picture 'gland' that was brought",
    ];
    for (k, (file, bytes)) in pictures.iter().enumerate() {
        let all = bytes_below(&library.path().join("objects"));
        let (object, _) = all.iter().find(|(_, there)| there == bytes).unwrap();
        fs::write(object, b"damaged").unwrap();
        let out = dir.path().join(format!("out-{k}"));
        let done = library.export(&out, &mut |_, _| {}).unwrap();
        fs::write(object, bytes).unwrap();
        let left: Vec<String> = done.left.iter().map(ToString::to_string).collect();
        assert_eq!((left.len(), done.pictures), (1, 3), "{left:?}");
        assert!(left[0].starts_with(named[k]), "{left:?}");
        let within = file.strip_prefix(dir.path().join("out")).unwrap();
        assert!(!out.join(within).exists(), "{left:?}");
    }
}

#[test]
fn an_export_that_ended_early_says_so_and_goes_on() {
    let (dir, library) = new();
    let out = dir.path().join("out");
    let pictures = with_pictures(&out, &library);
    // Something stands where a folder is to be, as a full disk would: nothing is told as done.
    fs::create_dir(&out).unwrap();
    fs::write(out.join("UNFINISHED.txt"), "").unwrap();
    fs::write(out.join("runs"), "in the way").unwrap();
    let said = library.export(&out, &mut |_, _| {}).unwrap_err();
    assert!(matches!(said, LibraryError::NotKept { .. }), "{said}");
    assert!(out.join("UNFINISHED.txt").exists());
    fs::remove_file(out.join("runs")).unwrap();
    // Killed anywhere on the way, and then something else is called otherwise and somebody changed a file.
    for at in 0..3 {
        let killed = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            library.export(&out, &mut |done, _| assert!(done < at, "killed"))
        }));
        assert!(killed.is_err() && out.join("UNFINISHED.txt").exists());
    }
    fs::write(&pictures[0].0, "half of it").unwrap();
    let old = out.join("targets/gone.target");
    fs::write(&old, "was renamed").unwrap();
    let done = library.export(&out, &mut |_, _| {}).unwrap();
    assert_eq!((done.targets, done.runs, done.pictures), (2, 1, 4));
    for (file, bytes) in &pictures {
        assert!(&fs::read(file).unwrap() == bytes, "{}", file.display());
    }
    let left: Vec<String> = done.left.iter().map(ToString::to_string).collect();
    assert_eq!(left.len(), 1, "{left:?}");
    assert!(left[0].contains("gone.target"), "{left:?}");
    assert!(old.exists() && !out.join("UNFINISHED.txt").exists());
}

#[test]
fn names_of_a_strange_library_lead_nowhere_in_an_export() {
    let (dir, library) = new();
    with_pictures(dir.path(), &library);
    let open = rusqlite::Connection::open(library.file()).unwrap();
    for (change, what) in [
        (
            "UPDATE targets SET name = '../../out-of-it' WHERE name = 'spot'",
            "the target '../../out-of-it'",
        ),
        (
            "UPDATE pictures SET name = '/tmp/elsewhere/x'",
            "the picture '/tmp/elsewhere/x' that was brought",
        ),
        ("UPDATE attachments SET name = '..'", ".. of the run"),
        ("UPDATE runs SET name = 'a/b'", "the run 'a/b'"),
    ] {
        open.execute(change, []).unwrap();
        let out = dir.path().join("deep/er/out");
        let done = library.export(&out, &mut |_, _| {}).unwrap();
        let left: Vec<String> = done.left.iter().map(ToString::to_string).collect();
        assert!(left.iter().any(|l| l.starts_with(what)), "{what}: {left:?}");
        assert!(!dir.path().join("deep/out-of-it.target").exists());
        assert!(!dir.path().join("out-of-it.target").exists());
        fs::remove_dir_all(dir.path().join("deep")).unwrap();
    }
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

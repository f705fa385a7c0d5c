//! What was measured, whose it is, and pictures that were brought.

use super::*;

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
    let newest = || library.calibration("lab", &objective, &[], [640, 480]);
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
            let kept = library
                .calibration(instrument, &objective, &[], [640, 480])
                .unwrap();
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
            match library.calibration(instrument, &objective, &[], [640, 480]) {
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

//! What the first version kept is still there.

use scopeservo_library::{Calibrations as _, Folder, Targets as _};
use scopeservo_scope::{Immersion, Objective, ObjectiveId};
use std::fs;
use std::path::Path;

fn library() -> (tempfile::TempDir, Folder) {
    let dir = tempfile::tempdir().unwrap();
    let stored = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/schema1");
    let put = |from: &str, to: &str| {
        let to = dir.path().join(to);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::copy(stored.join(from), to).unwrap();
    };
    put("old.json", "targets/old.json");
    put(
        "calibration.json",
        "calibrations/40x/000001_2026-11-26T03-53-46Z.json",
    );
    let folder = Folder::new(dir.path().into());
    (dir, folder)
}

#[test]
fn a_target_of_the_first_version_opens_and_its_name_is_taken() {
    let (_dir, library) = library();
    assert_eq!(library.target_names().unwrap(), ["old"]);
    let kept = library.target("old").unwrap();
    assert_eq!(kept.instrument, "test bench");
    assert_eq!(kept.target.objective, ObjectiveId("40x".into()));
    assert_eq!(kept.target.features.len(), 60);
    assert_eq!(kept.target.moved, Some(60));
    assert!(
        kept.target
            .picture
            .as_ref()
            .and_then(|p| p.image())
            .is_some()
    );
    assert_eq!(kept.target.taken, None);
    assert!(library.check_new_target("old").is_err());
}

#[test]
fn it_can_be_given_to_another_library_in_the_present_form() {
    let (dir, library) = library();
    let file = dir.path().join("old.target");
    library.export_target("old", &file).unwrap();
    assert!(
        library.export_target("old", &file).is_err(),
        "none is overwritten"
    );
    let other = Folder::new(dir.path().join("other"));
    let taken_in = other.import_target(&file, "again").unwrap();
    assert_eq!(taken_in.id.len(), 64);
    let (first, second) = (
        library.target("old").unwrap(),
        other.target("again").unwrap(),
    );
    assert_eq!(second.id, taken_in.id);
    assert_eq!(first.target.features, second.target.features);
    assert_eq!(first.target.picture, second.target.picture);
    assert_eq!(first.saved, second.saved);
    assert!(
        other.import_target(&file, "again").is_err(),
        "the name is taken"
    );
}

#[test]
fn a_calibration_of_the_first_version_counts() {
    let (_dir, library) = library();
    let objective = Objective {
        id: ObjectiveId("40x".into()),
        magnification: 400.0,
        numerical_aperture: 0.65,
        nominal_um_per_px: 0.51,
        immersion: Immersion::Air,
    };
    let kept = library
        .calibration("test bench", &objective, &[], [640, 480])
        .unwrap()
        .unwrap();
    assert!((kept.calibration.um_per_px() - 0.5114).abs() < 1e-3);
}

//! Calibrations and targets on disk. Nothing is overwritten: a new calibration lies beside the old ones, and a target's name is given
//! once. What is damaged is told, and does not keep the rest away.

use crate::error::CliError;
use crate::files::{self, make_folder, write_new};
use crate::kept::{
    KeptCalibration, KeptTarget, SCHEMA, check_name, file_name, judge, number_of, utc,
};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use scopeservo_scope::{
    Channels, Frame, Length, Objective, ObjectiveId, Samples, StagePose, Timestamp,
};
use scopeservo_servo::{Calibration, Target};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// The data folder.
pub(crate) struct Store {
    folder: PathBuf,
}

impl Store {
    pub(crate) fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    fn calibrations_of(&self, id: &ObjectiveId) -> PathBuf {
        self.folder.join("calibrations").join(file_name(&id.0))
    }

    /// The newest calibration of an objective. One that is damaged is none: an error tells which, and the others count all the same.
    pub(crate) fn calibration(
        &self,
        objective: &Objective,
    ) -> Result<Option<KeptCalibration>, CliError> {
        let files = entries(&self.calibrations_of(&objective.id))?.into_iter();
        // Numbered in the order in which they were made, whatever a clock said.
        let newest = files
            .filter(|p| is_json(p))
            .max_by_key(|p| (number_of(p), p.clone()));
        let Some(path) = newest else { return Ok(None) };
        let kept: KeptCalibration = read(&path)?;
        let what = match judge(&kept.calibration, objective) {
            Ok(()) => return Ok(Some(kept)),
            Err(what) => {
                format!("{what}. Move it away for the one before to count, or calibrate again")
            }
        };
        Err(CliError::Damaged { path, what })
    }

    /// Whether calibrations of these objectives could be kept, before anything is done for them.
    pub(crate) fn try_calibrations(&self, of: &[Objective]) -> Result<(), CliError> {
        self.try_folder(&self.folder.join("calibrations"))?;
        of.iter()
            .try_for_each(|objective| self.try_folder(&self.calibrations_of(&objective.id)))
    }

    /// The same for targets.
    pub(crate) fn try_targets(&self) -> Result<(), CliError> {
        self.try_folder(&self.targets())
    }

    fn try_folder(&self, folder: &Path) -> Result<(), CliError> {
        files::try_folder(folder).map_err(|source| CliError::CannotWrite {
            path: folder.into(),
            source,
            instead: "name another data_folder in the description of the instrument",
        })
    }

    /// Keeps a calibration beside the earlier ones. Returns its file.
    pub(crate) fn keep_calibration(
        &self,
        instrument: &str,
        calibration: &Calibration,
        focus_z: Option<Length>,
        residual_px: Option<f64>,
    ) -> Result<PathBuf, CliError> {
        let folder = self.calibrations_of(&calibration.objective);
        make_folder(&folder).map_err(CliError::not_kept(&folder))?;
        let made = utc(SystemTime::now());
        let kept = KeptCalibration {
            schema: SCHEMA,
            made: made.clone(),
            instrument: instrument.into(),
            calibration: calibration.clone(),
            focus_z_um: focus_z.map(Length::um),
            residual_px,
        };
        let bytes = to_json(&kept)?;
        loop {
            let last = entries(&folder)?.iter().map(|p| number_of(p)).max();
            let number = last.unwrap_or(0) + 1;
            let path = folder.join(format!("{number:06}_{}.json", made.replace(':', "-")));
            // Another process may make one at the same time: whichever comes second takes the next number.
            if write_new(&path, &bytes).map_err(CliError::not_kept(&path))? {
                return Ok(path);
            }
        }
    }

    fn targets(&self) -> PathBuf {
        self.folder.join("targets")
    }

    /// The file that makes a target exist. Its picture lies beside it.
    fn target_file(&self, name: &str) -> Result<PathBuf, CliError> {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if name.is_empty() || name.starts_with('.') || !name.chars().all(plain) {
            return Err(CliError::Usage(format!(
                "'{name}' is no name for a target: use letters, digits, '-', '_' and '.', like mitosis-3"
            )));
        }
        Ok(self.targets().join(format!("{name}.json")))
    }

    /// Refuses a name that is taken or is none, and a folder that takes no files, before anything is done for it.
    pub(crate) fn check_new_target(&self, name: &str) -> Result<(), CliError> {
        let path = self.target_file(name)?;
        check_name(name)?;
        self.try_targets()?;
        // A target must be found again where a file system is blind to case.
        let mut known = self.target_names()?.into_iter();
        match known.find(|known| known.eq_ignore_ascii_case(name)) {
            Some(known) => Err(taken(&known, &path.with_file_name(format!("{known}.json")))),
            None => Ok(()),
        }
    }

    /// Keeps a target under a new name, with its picture for people. Returns its file.
    pub(crate) fn keep_target(
        &self,
        name: &str,
        instrument: &str,
        stage: StagePose,
        target: Target,
        frame: &Frame,
    ) -> Result<PathBuf, CliError> {
        let path = self.target_file(name)?;
        let picture = path.with_extension("png");
        let kept = KeptTarget {
            schema: SCHEMA,
            saved: utc(SystemTime::now()),
            instrument: instrument.into(),
            stage,
            target,
        };
        let bytes = to_json(&kept)?;
        let (width, height) = (frame.width as u32, frame.height as u32);
        let mut png = Vec::new();
        PngEncoder::new(&mut png)
            .write_image(&frame.rgb8(), width, height, ExtendedColorType::Rgb8)
            .map_err(|e| CliError::Internal(format!("the target's picture: {e}")))?;
        make_folder(&self.targets()).map_err(CliError::not_kept(&self.targets()))?;
        // Another program may save one of that name at the same time: the picture must be that of whichever comes first.
        let _lock = files::lock(&self.targets());
        if path.exists() {
            return Err(taken(name, &path));
        }
        // A picture alone is what a killed program left. The file that makes the target exist comes last.
        files::replace(&picture, &png).map_err(CliError::not_kept(&picture))?;
        match write_new(&path, &bytes) {
            Ok(true) => Ok(path),
            Ok(false) => Err(taken(name, &path)),
            Err(error) => {
                // Of no use alone. It is no obstacle either, should it stay.
                let _ = fs::remove_file(&picture);
                Err(CliError::not_kept(&path)(error))
            }
        }
    }

    /// A saved target.
    pub(crate) fn target(&self, name: &str) -> Result<KeptTarget, CliError> {
        let path = self.target_file(name)?;
        if !path.exists() {
            let known = self.target_names()?;
            let there = match known.is_empty() {
                true => "none is saved yet: `scopeservo target save NAME`".into(),
                false => format!("there are {}", known.join(", ")),
            };
            return Err(CliError::Usage(format!(
                "there is no target '{name}'; {there}"
            )));
        }
        let kept: KeptTarget = read(&path)?;
        kept.target
            .features
            .check()
            .map_err(|e| CliError::Damaged {
                path,
                what: e.to_string(),
            })?;
        Ok(kept)
    }

    /// The picture of a saved target, for the report; a target is found again without it.
    pub(crate) fn target_picture(&self, name: &str) -> Option<Frame> {
        let path = self.target_file(name).ok()?.with_extension("png");
        let picture = image::open(path).ok()?.to_rgb8();
        Some(Frame {
            width: picture.width() as usize,
            height: picture.height() as usize,
            channels: Channels::Rgb,
            bit_depth: 8,
            samples: Samples::U8(picture.into_raw()),
            sequence: 0,
            exposure_start: Timestamp::default(),
            exposure: Duration::ZERO,
        })
    }

    /// The names of all targets.
    pub(crate) fn target_names(&self) -> Result<Vec<String>, CliError> {
        let files = entries(&self.targets())?.into_iter().filter(|p| is_json(p));
        Ok(files
            .filter_map(|p| Some(p.file_stem()?.to_string_lossy().into_owned()))
            .collect())
    }
}

fn is_json(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "json")
}

/// What lies in a folder, in order of names; nothing when there is no such folder.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, CliError> {
    let unreadable = |e: std::io::Error| CliError::Read {
        path: folder.into(),
        what: e.to_string(),
    };
    let listing = match fs::read_dir(folder) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        listing => listing.map_err(unreadable)?,
    };
    let mut all = Vec::new();
    for entry in listing {
        all.push(entry.map_err(unreadable)?.path());
    }
    all.sort();
    Ok(all)
}

fn read<T: DeserializeOwned>(path: &Path) -> Result<T, CliError> {
    let bad = |what: String| CliError::Read {
        path: path.into(),
        what,
    };
    let damaged = |e: serde_json::Error| CliError::Damaged {
        path: path.into(),
        what: format!("{e}. Move it away, or make it again"),
    };
    let text = fs::read(path).map_err(|e| bad(e.to_string()))?;
    let value: serde_json::Value = serde_json::from_slice(&text).map_err(damaged)?;
    match value.get("schema") {
        Some(schema) if schema != SCHEMA => Err(bad(format!(
            "it has schema {schema}, and this version reads {SCHEMA}"
        ))),
        _ => serde_json::from_value(value).map_err(damaged),
    }
}

fn taken(name: &str, path: &Path) -> CliError {
    CliError::Usage(format!(
        "there is a target '{name}' already ({}), and none is overwritten: give another name, or move its files away",
        path.display()
    ))
}

fn to_json(value: &impl Serialize) -> Result<Vec<u8>, CliError> {
    serde_json::to_vec_pretty(value)
        .map_err(|e| CliError::Internal(format!("a file could not be made: {e}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::Mat2;

    fn objective() -> Objective {
        Objective {
            id: ObjectiveId("Plan 40x/0.65".into()),
            magnification: 400.0,
            numerical_aperture: 0.65,
            nominal_um_per_px: 0.2,
        }
    }

    fn calibration(um_per_px: f64) -> Calibration {
        Calibration {
            schema: scopeservo_servo::CALIBRATION_SCHEMA,
            objective: objective().id,
            image_size_px: [640, 480],
            stage_from_pixel: Mat2::diagonal(um_per_px * 1e-6, um_per_px * 1e-6),
            rotation_centre_m: None,
            covariance: None,
            backlash_m: None,
            parcentric_offset_m: None,
            parfocal_offset_m: None,
        }
    }

    #[test]
    fn the_newest_calibration_counts_and_the_older_ones_stay() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::new(dir.path().join("data"));
        let newest = || store.calibration(&objective());
        assert_eq!(newest().unwrap(), None);
        let z = Some(Length::from_um(-12.5));
        // One from before files were numbered, and from a clock that was ahead; and one with a number that cannot be counted on from.
        let folder = store.calibrations_of(&objective().id);
        fs::create_dir_all(&folder).unwrap();
        for name in ["2099-01-01T00-00-00Z.json", "18446744073709551615_x.json"] {
            fs::write(folder.join(name), "{}").unwrap();
        }
        let files: Vec<PathBuf> = [0.19, 0.2, 0.21]
            .map(|um_per_px| {
                let calibration = calibration(um_per_px);
                let kept = store.keep_calibration("lab", &calibration, z, None);
                kept.unwrap()
            })
            .into();
        assert!(files.iter().all(|f| f.exists()));
        let kept = newest().unwrap().unwrap();
        assert_eq!(kept.calibration, calibration(0.21));
        assert!((kept.focus_z_um.unwrap() + 12.5).abs() < 1e-9);
        // What is damaged is none, and is named; the one before counts when it is moved away.
        for (text, said) in [
            ("{\"schema\":1,", "is damaged"),
            ("{}", "is damaged"),
            ("{\"schema\":7}", "schema 7"),
        ] {
            fs::write(&files[2], text).unwrap();
            let damaged = newest().unwrap_err().to_string();
            assert!(damaged.contains(said), "{damaged}");
            assert!(damaged.contains(files[2].to_str().unwrap()), "{damaged}");
        }
        fs::remove_file(&files[2]).unwrap();
        assert_eq!(newest().unwrap().unwrap().calibration, calibration(0.2));
    }

    /// A view without features: enough to be a file.
    fn view() -> (Target, Frame) {
        let target = Target {
            objective: objective().id,
            features: scopeservo_sift::Features {
                width: 4,
                height: 3,
                ..Default::default()
            },
            picture: None,
            periods_px: Vec::new(),
            moved: None,
        };
        let frame = Frame {
            width: 4,
            height: 3,
            channels: Channels::Gray,
            bit_depth: 8,
            samples: Samples::U8(vec![7; 12]),
            sequence: 0,
            exposure_start: Timestamp::default(),
            exposure: Duration::ZERO,
        };
        (target, frame)
    }

    fn keep(store: &Store, name: &str) -> Result<PathBuf, CliError> {
        let (target, frame) = view();
        store.keep_target(name, "lab", StagePose::default(), target, &frame)
    }

    /// Whenever a save is killed, the target is whole or not there, and its name is free as long as it is not there.
    #[test]
    fn a_killed_save_leaves_no_half_target_and_does_not_take_the_name() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::new(dir.path().into());
        let targets = store.targets();
        fs::create_dir(&targets).unwrap();
        // Killed between the files: the picture is there, and the file that makes the target exist is not.
        fs::write(targets.join("spot.png"), "half a picture").unwrap();
        assert!(store.target_names().unwrap().is_empty());
        store.check_new_target("spot").unwrap();
        let file = keep(&store, "spot").unwrap();
        assert_eq!(store.target_names().unwrap(), ["spot"]);
        assert_eq!(store.target("spot").unwrap().target, view().0);
        let picture = store.target_picture("spot").unwrap();
        assert_eq!((picture.width, picture.height), (4, 3));
        // Now it is taken, also for the picture, and where case does not count.
        let before = fs::read(&file).unwrap();
        for name in ["spot", "SPOT"] {
            assert!(store.check_new_target(name).is_err(), "{name}");
        }
        assert!(keep(&store, "spot").is_err());
        assert_eq!(fs::read(&file).unwrap(), before);
    }

    #[test]
    fn a_target_whose_picture_cannot_be_kept_is_not_there() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::new(dir.path().into());
        fs::create_dir_all(store.targets().join("spot.png")).unwrap();
        let error = keep(&store, "spot").unwrap_err();
        assert_eq!(error.code(), crate::error::Code::NotKept, "{error}");
        assert!(store.target_names().unwrap().is_empty());
    }

    #[test]
    fn names_of_targets_stay_in_their_folder() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::new(dir.path().join("data"));
        for bad in ["", ".", "../x", "a/b", "a\\b", "ä", "a b", ".hidden", "C:x"] {
            assert!(store.check_new_target(bad).is_err(), "{bad}");
            assert!(store.target(bad).is_err(), "{bad}");
        }
        assert!(store.check_new_target("mitosis-3.b_2").is_ok());
        let none = store.target("mitosis-3").unwrap_err().to_string();
        assert!(none.contains("target save"), "{none}");
    }
}

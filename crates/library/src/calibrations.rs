//! Calibrations: a new one lies beside the old ones, numbered in the order in which they were made; the newest counts.

use crate::LibraryError;
use crate::files::make_folder;
use crate::folder::{Folder, SCHEMA, entries, is_json, read, to_json, write_numbered};
use crate::names::{file_name, number_of, utc};
use scopeservo_scope::{AxisRange, Length, Objective, ObjectiveId};
use scopeservo_servo::{CalibrateOptions, Calibration};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// A calibration as it is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeptCalibration {
    /// Version of the file.
    pub schema: u32,
    /// When, UTC.
    pub made: String,
    /// The instrument's name; empty where an earlier version did not say.
    #[serde(default)]
    pub instrument: String,
    /// The calibration.
    pub calibration: Calibration,
    /// Where the objective was in focus, stage z.
    pub focus_z_um: Option<f64>,
    /// Root mean square residual of its views.
    pub residual_px: Option<f64>,
}

impl KeptCalibration {
    /// Whether it counts for this instrument: its own, or one of which nobody knows whose it is.
    pub fn is_of(&self, instrument: &str) -> bool {
        self.instrument == instrument || self.instrument.is_empty()
    }
}

/// Whether a calibration can be one of this objective on a stage that goes so far: by the rules that a new one must pass.
fn judge(
    calibration: &Calibration,
    objective: &Objective,
    ranges: &[AxisRange],
) -> Result<(), String> {
    let rules = CalibrateOptions::default();
    let [large, small] = calibration.stage_from_pixel.svd().s;
    let (measured, nominal) = (calibration.um_per_px(), objective.nominal_um_per_px);
    let factor = (measured / nominal).max(nominal / measured);
    if calibration.objective != objective.id {
        return Err(format!(
            "it is of {}, and lies with those of {}",
            calibration.objective, objective.id
        ));
    }
    let impossible = calibration.impossible();
    if let Some(what) = impossible.or_else(|| calibration.out_of_reach(ranges)) {
        return Err(what);
    }
    if factor > rules.nominal_factor {
        return Err(format!(
            "it gives {measured:.3} um per pixel where {nominal:.3} is engraved"
        ));
    }
    if large > rules.anisotropy * small {
        return Err(format!(
            "a pixel would be {:.2} times longer one way than the other",
            large / small
        ));
    }
    Ok(())
}

/// One of the calibrations of an objective, as it is kept.
#[derive(Debug)]
pub struct CalibrationFile {
    /// Where it lies.
    pub path: PathBuf,
    /// What it holds, or why that is no calibration.
    pub kept: Result<KeptCalibration, LibraryError>,
}

/// The calibrations of an instrument.
pub trait Calibrations {
    /// The newest calibration of an objective of this instrument, on a stage whose axes go so far: what another instrument with the same library
    /// measured counts for nothing. One that is damaged is none: an error tells which, what to do, and which older one could be used; other
    /// objectives are as they were.
    ///
    /// # Errors
    /// [`LibraryError::Read`] for a folder, [`LibraryError::DamagedCalibration`].
    fn calibration(
        &self,
        instrument: &str,
        objective: &Objective,
        ranges: &[AxisRange],
        image_size_px: [usize; 2],
    ) -> Result<Option<KeptCalibration>, LibraryError>;

    /// Where the newest calibration of an objective of this instrument lies.
    ///
    /// # Errors
    /// [`LibraryError::Read`].
    fn calibration_path(
        &self,
        instrument: &str,
        objective: &ObjectiveId,
    ) -> Result<Option<PathBuf>, LibraryError>;

    /// All calibrations that are kept, objective by objective, the oldest first: the newest of an instrument counts for it. One that is damaged does not keep the others
    /// away.
    ///
    /// # Errors
    /// [`LibraryError::Read`] for a folder.
    fn calibration_history(&self) -> Result<Vec<Vec<CalibrationFile>>, LibraryError>;

    /// Whether calibrations of these objectives could be kept, before anything is done for them.
    ///
    /// # Errors
    /// [`LibraryError::CannotWrite`].
    fn try_calibrations(&self, of: &[Objective]) -> Result<(), LibraryError>;

    /// Keeps a calibration beside the earlier ones. Returns where it lies.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    fn keep_calibration(
        &self,
        instrument: &str,
        calibration: &Calibration,
        focus_z: Option<Length>,
        residual_px: Option<f64>,
    ) -> Result<PathBuf, LibraryError>;
}

impl Folder {
    pub(crate) fn calibrations_of(&self, id: &ObjectiveId) -> PathBuf {
        self.path().join("calibrations").join(file_name(&id.0))
    }
}

/// The files of one objective, numbered in the order in which they were made, whatever a clock said.
pub(crate) fn in_order(folder: &Path) -> Result<Vec<PathBuf>, LibraryError> {
    let mut files = entries(folder)?;
    files.retain(|p| is_json(p));
    files.sort_by_key(|p| (number_of(p), p.clone()));
    Ok(files)
}

/// Without an instrument nobody knows what is engraved: what is impossible of any objective is damaged.
pub(crate) fn kept_in(
    path: PathBuf,
    kept: Result<KeptCalibration, LibraryError>,
) -> CalibrationFile {
    let kept = kept.and_then(|kept| match kept.calibration.impossible() {
        None => Ok(kept),
        Some(what) => Err(LibraryError::damaged(&path, what)),
    });
    CalibrationFile { path, kept }
}

/// What a file holds, where that can be a calibration of this objective; else what is wrong with it.
pub(crate) fn judged(
    kept: Result<KeptCalibration, LibraryError>,
    objective: &Objective,
    ranges: &[AxisRange],
) -> Result<KeptCalibration, String> {
    let kept = kept.map_err(|error| match error {
        LibraryError::Read { what, .. } => what,
        LibraryError::Damaged { what, .. } => what,
        error => error.to_string(),
    })?;
    judge(&kept.calibration, objective, ranges)?;
    Ok(kept)
}

/// The newest of files that can be a calibration of this objective of this instrument with images of this size, of which the last is the newest; an
/// error tells which could be used instead.
pub(crate) fn newest(
    files: Vec<PathBuf>,
    open: impl Fn(&Path) -> Result<KeptCalibration, LibraryError>,
    (instrument, image_size_px): (&str, [usize; 2]),
    objective: &Objective,
    ranges: &[AxisRange],
) -> Result<Option<KeptCalibration>, LibraryError> {
    // One that is damaged does not say whose it is, and one of another camera, or another mode of it, is of no use.
    let own = |path: &PathBuf| match open(path) {
        Ok(kept) if !kept.is_of(instrument) => None,
        Ok(kept) if kept.calibration.image_size_px != image_size_px => None,
        kept => Some(judged(kept, objective, ranges)),
    };
    let mut files = files.into_iter().rev();
    let Some((path, kept)) = files.find_map(|path| own(&path).map(|kept| (path, kept))) else {
        return Ok(None);
    };
    kept.map(Some)
        .map_err(|what| LibraryError::DamagedCalibration {
            path,
            what,
            objective: objective.id.0.clone(),
            before: files.find(|path| own(path).is_some_and(|kept| kept.is_ok())),
        })
}

/// Where the newest of files lies that is one of this instrument, or that is damaged.
pub(crate) fn newest_path(
    files: Vec<PathBuf>,
    open: impl Fn(&Path) -> Result<KeptCalibration, LibraryError>,
    instrument: &str,
) -> Option<PathBuf> {
    let own = |path: &PathBuf| open(path).map_or(true, |kept| kept.is_of(instrument));
    files.into_iter().rev().find(own)
}

/// A calibration from now on.
pub(crate) fn kept_now(
    instrument: &str,
    calibration: &Calibration,
    focus_z: Option<Length>,
    residual_px: Option<f64>,
) -> KeptCalibration {
    KeptCalibration {
        schema: SCHEMA,
        made: utc(SystemTime::now()),
        instrument: instrument.into(),
        calibration: calibration.clone(),
        focus_z_um: focus_z.map(Length::um),
        residual_px,
    }
}

impl Calibrations for Folder {
    fn calibration(
        &self,
        instrument: &str,
        objective: &Objective,
        ranges: &[AxisRange],
        image_size_px: [usize; 2],
    ) -> Result<Option<KeptCalibration>, LibraryError> {
        let files = in_order(&self.calibrations_of(&objective.id))?;
        newest(files, read, (instrument, image_size_px), objective, ranges)
    }

    fn calibration_path(
        &self,
        instrument: &str,
        objective: &ObjectiveId,
    ) -> Result<Option<PathBuf>, LibraryError> {
        let files = in_order(&self.calibrations_of(objective))?;
        Ok(newest_path(files, read, instrument))
    }

    fn calibration_history(&self) -> Result<Vec<Vec<CalibrationFile>>, LibraryError> {
        let folders = entries(&self.path().join("calibrations"))?.into_iter();
        let folders = folders.filter(|p| p.is_dir());
        let of = |folder: PathBuf| -> Result<Vec<CalibrationFile>, LibraryError> {
            let files = in_order(&folder)?.into_iter();
            Ok(files.map(|p| kept_in(p.clone(), read(&p))).collect())
        };
        let all: Vec<_> = folders.map(of).collect::<Result<_, _>>()?;
        Ok(all.into_iter().filter(|files| !files.is_empty()).collect())
    }

    fn try_calibrations(&self, of: &[Objective]) -> Result<(), LibraryError> {
        self.try_folder(&self.path().join("calibrations"))?;
        of.iter()
            .try_for_each(|objective| self.try_folder(&self.calibrations_of(&objective.id)))
    }

    fn keep_calibration(
        &self,
        instrument: &str,
        calibration: &Calibration,
        focus_z: Option<Length>,
        residual_px: Option<f64>,
    ) -> Result<PathBuf, LibraryError> {
        let folder = self.calibrations_of(&calibration.objective);
        make_folder(&folder).map_err(LibraryError::not_kept(&folder))?;
        let kept = kept_now(instrument, calibration, focus_z, residual_px);
        write_numbered(&folder, &kept.made, &to_json(&kept)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::Mat2;
    use scopeservo_scope::Immersion;
    use std::fs;

    fn objective() -> Objective {
        Objective {
            id: ObjectiveId("Plan 40x/0.65".into()),
            magnification: 400.0,
            numerical_aperture: 0.65,
            nominal_um_per_px: 0.2,
            immersion: Immersion::Air,
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
            backlash: None,
            scatter: None,
        }
    }

    #[test]
    fn the_newest_calibration_counts_and_the_older_ones_stay() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::new(dir.path().join("data"));
        let newest = || folder.calibration("lab", &objective(), &[], [640, 480]);
        assert_eq!(newest().unwrap(), None);
        let z = Some(Length::from_um(-12.5));
        // One from before files were numbered, and from a clock that was ahead; and one with a number that cannot be counted on from.
        let files = folder.calibrations_of(&objective().id);
        fs::create_dir_all(&files).unwrap();
        for name in ["2099-01-01T00-00-00Z.json", "18446744073709551615_x.json"] {
            fs::write(files.join(name), "{}").unwrap();
        }
        let files: Vec<PathBuf> = [0.19, 0.2, 0.21]
            .map(|um_per_px| {
                let calibration = calibration(um_per_px);
                let kept = folder.keep_calibration("lab", &calibration, z, None);
                kept.unwrap()
            })
            .into();
        assert!(files.iter().all(|f| f.exists()));
        let kept = newest().unwrap().unwrap();
        assert_eq!(kept.calibration, calibration(0.21));
        assert!((kept.focus_z_um.unwrap() + 12.5).abs() < 1e-9);
        // All of them are told, the oldest first, those that are none with the reason.
        let history = folder.calibration_history().unwrap();
        let [of_one] = history.as_slice() else {
            panic!("{history:?}");
        };
        let sizes: Vec<Option<f64>> = of_one
            .iter()
            .map(|f| f.kept.as_ref().ok().map(|k| k.calibration.um_per_px()))
            .collect();
        assert_eq!(of_one.len(), 5);
        assert!(sizes[0].is_none() && sizes[1].is_none(), "{sizes:?}");
        assert!((sizes[2].unwrap() - 0.19).abs() < 1e-9 && of_one[4].path == files[2]);
        // What is damaged is none, and is named; the one before counts when it is moved away.
        for (text, said) in [
            ("{\"schema\":1,", "is damaged"),
            ("{}", "is damaged"),
            ("", "is damaged"),
            ("{\"schema\":7}", "schema 7"),
        ] {
            fs::write(&files[2], text).unwrap();
            let damaged = newest().unwrap_err().to_string();
            assert!(damaged.contains(said), "{damaged}");
            assert!(damaged.contains(files[2].to_str().unwrap()), "{damaged}");
            // The older one that can be used is offered, and not one that is damaged as well.
            let cure = format!(
                "Move it away for the one before to count, {}, or calibrate Plan 40x/0.65 again",
                files[1].display()
            );
            assert!(damaged.ends_with(&cure), "{damaged}");
        }
        // One that can be read and is of another scale than is engraved.
        let off = folder.keep_calibration("lab", &calibration(0.4), z, None);
        let off = off.unwrap();
        let said = newest().unwrap_err().to_string();
        assert!(
            said.contains("0.400 um per pixel where 0.200 is engraved"),
            "{said}"
        );
        assert!(said.contains(files[1].to_str().unwrap()), "{said}");
        fs::remove_file(off).unwrap();
        fs::remove_file(&files[2]).unwrap();
        assert_eq!(newest().unwrap().unwrap().calibration, calibration(0.2));
        for older in &files[..2] {
            fs::write(older, "{}").unwrap();
        }
        let none = newest().unwrap_err().to_string();
        assert!(
            none.ends_with("Move it away, or calibrate Plan 40x/0.65 again"),
            "{none}"
        );
    }

    #[test]
    fn a_damaged_file_of_one_objective_hides_no_other() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::new(dir.path().into());
        let kept = folder.keep_calibration("lab", &calibration(0.2), None, None);
        kept.unwrap();
        for (stray, text) in [("10x", "{}"), ("notes", "no json"), ("CON", "")] {
            let stray = folder.calibrations_of(&ObjectiveId(stray.into()));
            fs::create_dir_all(&stray).unwrap();
            fs::write(stray.join("000009_x.json"), text).unwrap();
        }
        let newest = folder
            .calibration("lab", &objective(), &[], [640, 480])
            .unwrap()
            .unwrap();
        assert_eq!(newest.calibration, calibration(0.2));
        let all = folder.calibration_history().unwrap();
        let sound = all.iter().flatten().filter(|f| f.kept.is_ok()).count();
        assert_eq!((all.len(), sound), (4, 1));
    }

    #[test]
    fn a_damaged_calibration_is_none() {
        let objective = Objective {
            id: ObjectiveId("10x".into()),
            magnification: 100.0,
            numerical_aperture: 0.25,
            nominal_um_per_px: 0.5,
            immersion: Immersion::Air,
        };
        let sound = Calibration {
            schema: scopeservo_servo::CALIBRATION_SCHEMA,
            objective: objective.id.clone(),
            image_size_px: [640, 480],
            stage_from_pixel: Mat2([[-5.1e-7, 1e-8], [1e-8, 5.0e-7]]),
            rotation_centre_m: Some([-0.01, 0.2]),
            covariance: Some([[1e-20; 6]; 6]),
            backlash: None,
            scatter: None,
        };
        assert_eq!(judge(&sound, &objective, &[]), Ok(()));
        let scaled = |f: f64| Mat2(sound.stage_from_pixel.0.map(|row| row.map(|v| f * v)));
        for map in [
            Mat2::diagonal(0.0, 0.0),
            Mat2::diagonal(1e308, 1e308),
            Mat2::diagonal(1e-200, 1e-200),
            Mat2::diagonal(f64::NAN, 5e-7),
            scaled(1000.0),
            scaled(0.001),
            scaled(2.0),
            // The same area, sheared.
            Mat2::diagonal(5e-10, 5e-4),
        ] {
            let damaged = Calibration {
                stage_from_pixel: map,
                ..sound.clone()
            };
            assert!(judge(&damaged, &objective, &[]).is_err(), "{map:?}");
        }
        let mut damaged = sound.clone();
        damaged.rotation_centre_m = Some([1e308, 0.0]);
        assert!(judge(&damaged, &objective, &[]).is_err());
        damaged = sound.clone();
        damaged.covariance = Some([[-1.0; 6]; 6]);
        assert!(judge(&damaged, &objective, &[]).is_err());
        damaged = sound;
        damaged.objective = ObjectiveId("40x".into());
        assert!(judge(&damaged, &objective, &[]).is_err());
    }
}

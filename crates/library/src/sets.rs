//! Calibrations that are one instrument: what they owe each other lies beside them; each is kept by itself as well. A new set lies beside the old
//! ones, and the newest counts where its calibrations do.

use crate::LibraryError;
use crate::files::make_folder;
use crate::folder::{Folder, SCHEMA, entries, is_json, read, to_json, write_numbered};
use crate::names::{file_name, number_of, utc};
use scopeservo_servo::CalibrationSet;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// A set as it is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeptSet {
    /// Version of the file.
    pub schema: u32,
    /// When, UTC.
    pub made: String,
    /// The instrument's name.
    pub instrument: String,
    /// The set.
    pub set: CalibrationSet,
}

/// Sets of calibrations that are one instrument.
pub trait CalibrationSets {
    /// The newest set of an instrument.
    ///
    /// # Errors
    /// [`LibraryError::Read`], [`LibraryError::Damaged`] where the newest one is no set.
    fn calibration_set(&self, instrument: &str) -> Result<Option<KeptSet>, LibraryError>;

    /// Keeps a set beside the earlier ones. Returns where it lies.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    fn keep_calibration_set(
        &self,
        instrument: &str,
        set: &CalibrationSet,
    ) -> Result<PathBuf, LibraryError>;
}

impl KeptSet {
    /// It, where it can be one of a microscope.
    pub(crate) fn sound(path: &Path, kept: Self) -> Result<Self, LibraryError> {
        match kept.set.is_possible() {
            true => Ok(kept),
            false => Err(LibraryError::damaged(
                path,
                "its numbers cannot be those of a microscope",
            )),
        }
    }
}

impl Folder {
    pub(crate) fn sets_of(&self, instrument: &str) -> PathBuf {
        self.path()
            .join("calibration-sets")
            .join(file_name(instrument))
    }
}

impl CalibrationSets for Folder {
    fn calibration_set(&self, instrument: &str) -> Result<Option<KeptSet>, LibraryError> {
        let mut files = entries(&self.sets_of(instrument))?;
        files.retain(|p| is_json(p));
        files.sort_by_key(|p| (number_of(p), p.clone()));
        let Some(path) = files.pop() else {
            return Ok(None);
        };
        KeptSet::sound(&path, read(&path)?).map(Some)
    }

    fn keep_calibration_set(
        &self,
        instrument: &str,
        set: &CalibrationSet,
    ) -> Result<PathBuf, LibraryError> {
        let folder = self.sets_of(instrument);
        make_folder(&folder).map_err(LibraryError::not_kept(&folder))?;
        let made = utc(SystemTime::now());
        let kept = KeptSet {
            schema: SCHEMA,
            made: made.clone(),
            instrument: instrument.into(),
            set: set.clone(),
        };
        let bytes = to_json(&kept)?;
        write_numbered(&folder, &made, &bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_servo::SET_SCHEMA;

    fn set(chi_sq: f64) -> CalibrationSet {
        CalibrationSet {
            schema: SET_SCHEMA,
            calibrations: Vec::new(),
            covariance: vec![1e-14, 0.0, 0.0, 0.0, 1e-14, 0.0, 0.0, 0.0, 1e-10],
            parcentric: Vec::new(),
            linked: 0,
            chi_sq,
            freedom: 6,
        }
    }

    #[test]
    fn the_newest_set_counts_and_a_damaged_one_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let library = Folder::new(dir.path().into());
        assert_eq!(library.calibration_set("bench").unwrap(), None);
        for chi_sq in [1.0, 2.0] {
            library.keep_calibration_set("bench", &set(chi_sq)).unwrap();
        }
        let newest = library.calibration_set("bench").unwrap().unwrap();
        assert_eq!(newest.set, set(2.0));
        assert_eq!(library.calibration_set("another").unwrap(), None);
        let wrong = [
            CalibrationSet {
                covariance: vec![1.0],
                ..set(3.0)
            },
            CalibrationSet {
                schema: SET_SCHEMA + 1,
                ..set(3.0)
            },
        ];
        for wrong in wrong {
            library.keep_calibration_set("bench", &wrong).unwrap();
            let said = library.calibration_set("bench").unwrap_err().to_string();
            assert!(said.contains("cannot be those of a microscope"), "{said}");
        }
    }
}

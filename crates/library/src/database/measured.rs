//! What was measured of instruments: a row and a file each. The newest counts. One whose file somebody moved away does not: so an older one
//! comes to count again.

use crate::calibrations::{kept_in, kept_now, newest, newest_path};
use crate::cameras::{from_png, to_png};
use crate::database::bin::Gone;
use crate::database::measured_rows::{Kind, insert, size_word};
use crate::database::rows::within;
use crate::database::store::Database;
use crate::folder::{SCHEMA, parse, to_json};
use crate::names::utc;
use crate::nosepieces::newest_of_each;
use crate::{
    CalibrationFile, CalibrationSets, Calibrations, Cameras, KeptCalibration, KeptSet,
    KeptSwitching, LibraryError, Nosepieces,
};
use rusqlite::params;
use scopeservo_scope::{AxisRange, FlatField, Length, Objective, ObjectiveId};
use scopeservo_servo::{Calibration, CalibrationSet, SwitchingReport};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

impl Database {
    /// The files of a kind in the order in which they were kept, each with what it is of; of one instrument, or of all. Calibrations of which
    /// nobody knows whose they are count as any instrument's. Those that are not there were moved away.
    fn measured(
        &self,
        kind: Kind,
        instrument: Option<&str>,
        of: Option<&str>,
    ) -> Result<Vec<(String, String)>, LibraryError> {
        let all: Vec<(String, String)> = self.read(|c| {
            let mut all = c.prepare_cached(
                "SELECT of, file FROM measurements JOIN instruments ON instruments.id = instrument
                 WHERE kind = ?1 AND (?2 IS NULL OR instruments.name = ?2 OR (instruments.name = '' AND kind = 'calibration')) AND (?3 IS NULL OR of = ?3)
                 ORDER BY measurements.id",
            )?;
            let all = all.query_map(params![kind.word(), instrument, of], |row| Ok((row.get(0)?, row.get(1)?)))?;
            Ok(all.collect::<Result<_, _>>()?)
        })?;
        Ok(all
            .into_iter()
            .filter(|(_, file)| self.objects().has(file))
            .collect())
    }

    fn places(&self, measured: Vec<(String, String)>) -> Vec<PathBuf> {
        let files = measured.iter();
        files.map(|(_, file)| self.objects().place(file)).collect()
    }

    /// What a file of JSON in the objects says, where it is what was kept.
    fn said<T: DeserializeOwned>(&self, path: &Path) -> Result<T, LibraryError> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        parse(path, &self.objects().get(&name)?)
    }

    fn keep_measured(
        &self,
        kind: Kind,
        words: [&str; 3],
        bytes: &[u8],
        ending: &str,
    ) -> Result<PathBuf, LibraryError> {
        self.write(|change| {
            let file = self.objects().put(bytes, ending)?;
            insert(change, kind, words, &file)?;
            Ok(self.objects().place(&file.name))
        })
    }
}

impl Calibrations for Database {
    fn calibration(
        &self,
        instrument: &str,
        objective: &Objective,
        ranges: &[AxisRange],
        image_size_px: [usize; 2],
    ) -> Result<Option<KeptCalibration>, LibraryError> {
        let files = self.measured(Kind::Calibration, Some(instrument), Some(&objective.id.0))?;
        newest(
            self.places(files),
            |path| self.said(path),
            (instrument, image_size_px),
            objective,
            ranges,
        )
    }

    fn calibration_path(
        &self,
        instrument: &str,
        objective: &ObjectiveId,
    ) -> Result<Option<PathBuf>, LibraryError> {
        let files = self.measured(Kind::Calibration, Some(instrument), Some(&objective.0))?;
        Ok(newest_path(
            self.places(files),
            |path| self.said(path),
            instrument,
        ))
    }

    fn calibration_history(&self) -> Result<Vec<Vec<CalibrationFile>>, LibraryError> {
        let mut of_each: BTreeMap<String, Vec<CalibrationFile>> = BTreeMap::new();
        for (of, file) in self.measured(Kind::Calibration, None, None)? {
            let path = self.objects().place(&file);
            let kept = self.said(&path);
            of_each.entry(of).or_default().push(kept_in(path, kept));
        }
        Ok(of_each.into_values().collect())
    }

    fn try_calibrations(&self, _of: &[Objective]) -> Result<(), LibraryError> {
        self.try_room()
    }

    fn keep_calibration(
        &self,
        instrument: &str,
        calibration: &Calibration,
        focus_z: Option<Length>,
        residual_px: Option<f64>,
    ) -> Result<PathBuf, LibraryError> {
        let kept = kept_now(instrument, calibration, focus_z, residual_px);
        let words = [instrument, &calibration.objective.0, &kept.made];
        self.keep_measured(Kind::Calibration, words, &to_json(&kept)?, "json")
    }
}

impl CalibrationSets for Database {
    fn calibration_set(&self, instrument: &str) -> Result<Option<KeptSet>, LibraryError> {
        let files = self.measured(Kind::Set, Some(instrument), None)?;
        match self.places(files).pop() {
            Some(path) => KeptSet::sound(&path, self.said(&path)?).map(Some),
            None => Ok(None),
        }
    }

    fn keep_calibration_set(
        &self,
        instrument: &str,
        set: &CalibrationSet,
    ) -> Result<PathBuf, LibraryError> {
        let kept = KeptSet {
            schema: SCHEMA,
            made: utc(SystemTime::now()),
            instrument: instrument.into(),
            set: set.clone(),
        };
        self.keep_measured(
            Kind::Set,
            [instrument, "", &kept.made],
            &to_json(&kept)?,
            "json",
        )
    }
}

impl Nosepieces for Database {
    fn switchings(
        &self,
        instrument: &str,
    ) -> Result<Vec<Result<KeptSwitching, LibraryError>>, LibraryError> {
        let files = self.measured(Kind::Switching, Some(instrument), None)?;
        let all = self.places(files).into_iter();
        Ok(newest_of_each(all.map(|path| {
            self.said(&path)
                .and_then(|kept| KeptSwitching::sound(&path, kept))
        })))
    }

    fn keep_switching(
        &self,
        instrument: &str,
        switching: &SwitchingReport,
    ) -> Result<PathBuf, LibraryError> {
        let kept = KeptSwitching {
            schema: SCHEMA,
            made: utc(SystemTime::now()),
            instrument: instrument.into(),
            switching: switching.clone(),
        };
        let of = format!("{} to {}", switching.from, switching.to);
        self.keep_measured(
            Kind::Switching,
            [instrument, &of, &kept.made],
            &to_json(&kept)?,
            "json",
        )
    }
}

impl Cameras for Database {
    fn shadows(
        &self,
        instrument: &str,
        size_px: [usize; 2],
    ) -> Result<Option<FlatField>, LibraryError> {
        let files = self.measured(Kind::Shadows, Some(instrument), Some(&size_word(size_px)))?;
        let Some((_, file)) = files.last() else {
            return Ok(None);
        };
        let path = self.objects().place(file);
        let seen = from_png(&self.objects().get(file)?)
            .map_err(|what| LibraryError::damaged(&path, what))?;
        match [seen.width(), seen.height()] == size_px {
            true => Ok(Some(seen)),
            false => Err(LibraryError::damaged(&path, "it has another size")),
        }
    }

    fn keep_shadows(&self, instrument: &str, seen: &FlatField) -> Result<PathBuf, LibraryError> {
        let size = size_word([seen.width(), seen.height()]);
        let made = utc(SystemTime::now());
        let former = self.measured(Kind::Shadows, Some(instrument), Some(&size))?;
        let place = self.keep_measured(
            Kind::Shadows,
            [instrument, &size, &made],
            &to_png(seen)?,
            "png",
        )?;
        if !former.is_empty() {
            self.forget_shadows(instrument, &size)?;
        }
        Ok(place)
    }
}

impl Database {
    /// Every run sees them anew: but for the newest they are of no use.
    fn forget_shadows(&self, instrument: &str, size: &str) -> Result<(), LibraryError> {
        self.sweep(|connection| {
            let mut gone = Gone::default();
            within(connection, |change| {
                let mut files = change.prepare(
                    "DELETE FROM measurements WHERE kind = 'shadows' AND of = ?2
                         AND instrument = (SELECT id FROM instruments WHERE name = ?1)
                         AND id < (SELECT max(m.id) FROM measurements AS m
                                   WHERE m.kind = 'shadows' AND m.of = ?2 AND m.instrument = measurements.instrument)
                     RETURNING file",
                )?;
                let files = files.query_map([instrument, size], |row| row.get(0))?;
                gone.objects = files.collect::<Result<_, _>>()?;
                Ok(())
            })?;
            self.delete_files(connection, &gone)
        })
    }
}

//! What repeated switching between objectives has shown: a new report lies beside the old ones, and the newest of two objectives counts.

use crate::LibraryError;
use crate::files::make_folder;
use crate::folder::{Folder, SCHEMA, entries, is_json, read, to_json, write_numbered};
use crate::names::{file_name, number_of, utc};
use scopeservo_servo::SwitchingReport;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// A report as it is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeptSwitching {
    /// Version of the file.
    pub schema: u32,
    /// When, UTC.
    pub made: String,
    /// The instrument's name.
    pub instrument: String,
    /// The report.
    pub switching: SwitchingReport,
}

/// What is known of nosepieces.
pub trait Nosepieces {
    /// The newest report of each two objectives of an instrument. One that is damaged does not keep the others away.
    ///
    /// # Errors
    /// [`LibraryError::Read`] for the folder; inside, those of single files.
    fn switchings(
        &self,
        instrument: &str,
    ) -> Result<Vec<Result<KeptSwitching, LibraryError>>, LibraryError>;

    /// Keeps a report beside the earlier ones. Returns where it lies.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    fn keep_switching(
        &self,
        instrument: &str,
        switching: &SwitchingReport,
    ) -> Result<PathBuf, LibraryError>;
}

impl KeptSwitching {
    /// It, where it can be one of a nosepiece.
    pub(crate) fn sound(path: &Path, kept: Self) -> Result<Self, LibraryError> {
        match kept.switching.is_possible() {
            true => Ok(kept),
            false => Err(LibraryError::damaged(
                path,
                "its numbers cannot be those of a nosepiece",
            )),
        }
    }
}

/// The newest of each two objectives, and all that are damaged, of reports of which the last is the newest.
pub(crate) fn newest_of_each(
    all: impl Iterator<Item = Result<KeptSwitching, LibraryError>>,
) -> Vec<Result<KeptSwitching, LibraryError>> {
    let mut newest: Vec<Result<KeptSwitching, LibraryError>> = Vec::new();
    for kept in all {
        if let Ok(kept) = &kept {
            let pair = |k: &KeptSwitching| (k.switching.from.clone(), k.switching.to.clone());
            let is_newer = |old: &Result<KeptSwitching, LibraryError>| {
                old.as_ref().is_ok_and(|old| pair(old) == pair(kept))
            };
            newest.retain(|old| !is_newer(old));
        }
        newest.push(kept);
    }
    newest
}

impl Folder {
    pub(crate) fn switchings_of(&self, instrument: &str) -> PathBuf {
        self.path().join("nosepieces").join(file_name(instrument))
    }
}

impl Nosepieces for Folder {
    fn switchings(
        &self,
        instrument: &str,
    ) -> Result<Vec<Result<KeptSwitching, LibraryError>>, LibraryError> {
        let mut files = entries(&self.switchings_of(instrument))?;
        files.retain(|p| is_json(p));
        files.sort_by_key(|p| (number_of(p), p.clone()));
        let all = files.iter();
        Ok(newest_of_each(all.map(|path| {
            read(path).and_then(|kept| KeptSwitching::sound(path, kept))
        })))
    }

    fn keep_switching(
        &self,
        instrument: &str,
        switching: &SwitchingReport,
    ) -> Result<PathBuf, LibraryError> {
        let folder = self.switchings_of(instrument);
        make_folder(&folder).map_err(LibraryError::not_kept(&folder))?;
        let made = utc(SystemTime::now());
        let kept = KeptSwitching {
            schema: SCHEMA,
            made: made.clone(),
            instrument: instrument.into(),
            switching: switching.clone(),
        };
        let bytes = to_json(&kept)?;
        write_numbered(&folder, &made, &bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_scope::ObjectiveId;
    use scopeservo_servo::Known;

    fn report(to: &str, x_um: f64) -> SwitchingReport {
        let known = |value: f64| Known { value, sigma: 0.1 };
        SwitchingReport {
            from: ObjectiveId("10x".into()),
            to: ObjectiveId(to.into()),
            arrivals: [5, 5],
            offset_um: [known(x_um), known(2.0)],
            repeatability_um: [known(1.0); 2],
            repeatability_deg: known(0.01),
            focus: None,
        }
    }

    #[test]
    fn the_newest_report_of_two_objectives_counts_and_a_damaged_one_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let library = Folder::new(dir.path().into());
        assert!(library.switchings("bench").unwrap().is_empty());
        for (to, x_um) in [("40x", 1.0), ("20x", 5.0), ("40x", 3.0)] {
            library.keep_switching("bench", &report(to, x_um)).unwrap();
        }
        let all = library.switchings("bench").unwrap();
        let told: Vec<SwitchingReport> = all.into_iter().map(|k| k.unwrap().switching).collect();
        assert_eq!(told, [report("20x", 5.0), report("40x", 3.0)]);
        assert!(library.switchings("another").unwrap().is_empty());
        // Of another number than there can be, and no report at all.
        library
            .keep_switching("bench", &report("40x", 1e7))
            .unwrap();
        let folder = library.switchings_of("bench");
        std::fs::write(folder.join("000009_x.json"), "{}").unwrap();
        let all = library.switchings("bench").unwrap();
        assert_eq!(
            (all.len(), all.iter().filter(|k| k.is_err()).count()),
            (4, 2)
        );
    }
}

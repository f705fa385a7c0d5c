//! Calibrations and targets on disk. Nothing is overwritten: a new calibration lies beside the old ones, and a target's name is given
//! once.

use crate::error::CliError;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use scopeservo_scope::{Channels, Frame, Length, ObjectiveId, Samples, StagePose, Timestamp};
use scopeservo_servo::{Calibration, Target};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Version of the files.
const SCHEMA: u32 = 1;

/// A calibration as it is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct KeptCalibration {
    pub(crate) schema: u32,
    /// UTC.
    pub(crate) made: String,
    /// The instrument's name.
    pub(crate) instrument: String,
    pub(crate) calibration: Calibration,
    /// Where the objective was in focus, stage z.
    pub(crate) focus_z_um: Option<f64>,
    /// Root mean square residual of its views.
    pub(crate) residual_px: Option<f64>,
}

/// A target as it is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct KeptTarget {
    pub(crate) schema: u32,
    /// UTC.
    pub(crate) saved: String,
    /// The instrument's name.
    pub(crate) instrument: String,
    /// Where the stage was.
    pub(crate) stage: StagePose,
    pub(crate) target: Target,
}

/// The data folder.
pub(crate) struct Store {
    folder: PathBuf,
}

impl Store {
    pub(crate) fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    fn calibrations_of(&self, id: &ObjectiveId) -> PathBuf {
        self.folder.join("calibrations").join(file_name(&id.0))
    }

    /// The newest calibration of each objective.
    pub(crate) fn calibrations(&self) -> Result<BTreeMap<ObjectiveId, KeptCalibration>, CliError> {
        let mut all = BTreeMap::new();
        let folders = entries(&self.folder.join("calibrations"))?;
        for folder in folders.into_iter().filter(|f| f.is_dir()) {
            // Numbered in the order in which they were made, whatever a clock said.
            let files = entries(&folder)?.into_iter().filter(|p| is_json(p));
            if let Some(path) = files.max_by_key(|p| (number_of(p), p.clone())) {
                let kept: KeptCalibration = read(&path)?;
                all.insert(kept.calibration.objective.clone(), kept);
            }
        }
        Ok(all)
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
        make(&folder)?;
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
            if write_new(&path, &bytes)? {
                return Ok(path);
            }
        }
    }

    fn targets(&self) -> PathBuf {
        self.folder.join("targets")
    }

    fn target_file(&self, name: &str) -> Result<PathBuf, CliError> {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if name.is_empty() || name.starts_with('.') || !name.chars().all(plain) {
            return Err(CliError::Usage(format!(
                "'{name}' is no name for a target: use letters, digits, '-', '_' and '.', like mitosis-3"
            )));
        }
        Ok(self.targets().join(format!("{name}.json")))
    }

    /// Refuses a name that is taken or is none, before anything is done for it.
    pub(crate) fn check_new_target(&self, name: &str) -> Result<(), CliError> {
        let path = self.target_file(name)?;
        for path in [path.with_extension("png"), path] {
            if path.exists() {
                return Err(taken(name, &path));
            }
        }
        Ok(())
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
        self.check_new_target(name)?;
        let path = self.target_file(name)?;
        make(&self.targets())?;
        let kept = KeptTarget {
            schema: SCHEMA,
            saved: utc(SystemTime::now()),
            instrument: instrument.into(),
            stage,
            target,
        };
        let (width, height) = (frame.width as u32, frame.height as u32);
        let mut png = Vec::new();
        PngEncoder::new(&mut png)
            .write_image(&frame.rgb8(), width, height, ExtendedColorType::Rgb8)
            .map_err(|e| CliError::Internal(format!("the target's picture: {e}")))?;
        let picture = path.with_extension("png");
        // Another process may save one at the same time: the name belongs to whichever comes first.
        for (file, bytes) in [(&path, to_json(&kept)?), (&picture, png)] {
            if !write_new(file, &bytes)? {
                return Err(taken(name, file));
            }
        }
        Ok(path)
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
        kept.target.features.check().map_err(|e| CliError::Read {
            path,
            what: format!("it is damaged: {e}"),
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
    let text = fs::read(path).map_err(|e| bad(e.to_string()))?;
    let value: serde_json::Value =
        serde_json::from_slice(&text).map_err(|e| bad(format!("it is damaged: {e}")))?;
    if value["schema"] != SCHEMA {
        return Err(bad(format!(
            "it has schema {}, and this version reads {SCHEMA}",
            value["schema"]
        )));
    }
    serde_json::from_value(value).map_err(|e| bad(format!("it is damaged: {e}")))
}

fn make(folder: &Path) -> Result<(), CliError> {
    fs::create_dir_all(folder).map_err(|source| CliError::Write {
        path: folder.into(),
        source,
    })
}

fn taken(name: &str, path: &Path) -> CliError {
    CliError::Usage(format!(
        "there is a target '{name}' already ({}), and none is overwritten: give another name, or move its files away",
        path.display()
    ))
}

/// The number before a file's time; 0 for one without.
fn number_of(path: &Path) -> u64 {
    let stem = path.file_stem().and_then(|s| s.to_str());
    let number = stem.and_then(|s| s.split_once('_')).map(|(n, _)| n.parse());
    number.and_then(Result::ok).unwrap_or(0)
}

fn to_json(value: &impl Serialize) -> Result<Vec<u8>, CliError> {
    serde_json::to_vec_pretty(value)
        .map_err(|e| CliError::Internal(format!("a file could not be made: {e}")))
}

/// Writes a file whole or not at all, and never over another: `false` when there is one of that name.
fn write_new(path: &Path, bytes: &[u8]) -> Result<bool, CliError> {
    let failed = |source: std::io::Error| CliError::Write {
        path: path.into(),
        source,
    };
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut file = tempfile::Builder::new()
        .prefix(".scopeservo-")
        .tempfile_in(folder)
        .map_err(failed)?;
    file.write_all(bytes).map_err(failed)?;
    file.as_file().sync_all().map_err(failed)?;
    // For whoever may read the folder, as other files are.
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let mode = fs::Permissions::from_mode(0o644);
        file.as_file().set_permissions(mode).map_err(failed)?;
    }
    match file.persist_noclobber(path) {
        Ok(_) => Ok(true),
        Err(e) if e.error.kind() == std::io::ErrorKind::AlreadyExists => Ok(false),
        Err(e) => Err(failed(e.error)),
    }
}

/// A name as a file's: what is no letter or digit as its number.
fn file_name(name: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    name.chars()
        .map(|c| match plain(c) {
            true => c.to_string(),
            false => format!("%{:x}", u32::from(c)),
        })
        .collect()
}

/// A moment in UTC, to the second: 2026-11-24T20:15:00Z.
fn utc(at: SystemTime) -> String {
    let seconds = at.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    // Days since 0000-03-01, in eras of 400 years (Hinnant, "chrono-compatible low-level date algorithms").
    let z = days + 719_468;
    let (era, day_of_era) = (z / 146_097, z % 146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = (month_from_march + 2) % 12 + 1;
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    let (h, m, s) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("{year:04}-{month:02}-{day:02}T{h:02}:{m:02}:{s:02}Z")
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::Mat2;

    #[test]
    fn times_are_those_of_the_calendar() {
        for (seconds, text) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_399, "2000-02-28T23:59:59Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_709_251_199, "2024-02-29T23:59:59Z"),
            (1_795_551_300, "2026-11-24T20:15:00Z"),
            (4_107_542_400, "2100-03-01T00:00:00Z"),
        ] {
            assert_eq!(utc(UNIX_EPOCH + Duration::from_secs(seconds)), text);
        }
    }

    #[test]
    fn the_newest_calibration_counts_and_the_older_ones_stay() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::new(dir.path().join("data"));
        assert!(store.calibrations().unwrap().is_empty());
        let calibration = |scale: f64| Calibration {
            schema: scopeservo_servo::CALIBRATION_SCHEMA,
            objective: ObjectiveId("Plan 40x/0.65".into()),
            image_size_px: [640, 480],
            stage_from_pixel: Mat2::diagonal(scale, scale),
            rotation_centre_m: None,
            covariance: None,
            backlash_m: None,
            parcentric_offset_m: None,
            parfocal_offset_m: None,
        };
        let z = Some(Length::from_um(-12.5));
        // One from before files were numbered, and from a clock that was ahead.
        let folder = store.calibrations_of(&ObjectiveId("Plan 40x/0.65".into()));
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("2099-01-01T00-00-00Z.json"), "{}").unwrap();
        let files: Vec<PathBuf> = [1e-7, 2e-7, 3e-7]
            .map(|s| {
                store
                    .keep_calibration("lab", &calibration(s), z, None)
                    .unwrap()
            })
            .into();
        assert!(files.iter().all(|f| f.exists()));
        let newest = store.calibrations().unwrap();
        let kept = &newest[&ObjectiveId("Plan 40x/0.65".into())];
        assert_eq!(kept.calibration, calibration(3e-7));
        assert!((kept.focus_z_um.unwrap() + 12.5).abs() < 1e-9);
        fs::write(&files[2], "{\"schema\":1,").unwrap();
        let damaged = store.calibrations().unwrap_err().to_string();
        assert!(damaged.contains("damaged"), "{damaged}");
        fs::write(&files[2], "{\"schema\":7}").unwrap();
        let newer = store.calibrations().unwrap_err().to_string();
        assert!(newer.contains("schema 7"), "{newer}");
    }

    #[test]
    fn many_at_once_lose_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("name.json");
        let won = std::thread::scope(|s| {
            let all: Vec<_> = (0..8u8)
                .map(|k| {
                    let path = &path;
                    s.spawn(move || write_new(path, &[k; 1000]).unwrap().then_some(k))
                })
                .collect();
            let won = all.into_iter().filter_map(|t| t.join().unwrap());
            won.collect::<Vec<_>>()
        });
        assert_eq!(won.len(), 1);
        assert_eq!(fs::read(&path).unwrap(), vec![won[0]; 1000]);
        assert_eq!(entries(dir.path()).unwrap().len(), 1);
    }

    #[test]
    fn names_of_targets_stay_in_their_folder() {
        let store = Store::new("data".into());
        for bad in ["", ".", "../x", "a/b", "a\\b", "ä", "a b", ".hidden", "C:x"] {
            assert!(store.check_new_target(bad).is_err(), "{bad}");
        }
        assert!(store.check_new_target("mitosis-3.b_2").is_ok());
        let none = store.target("mitosis-3").unwrap_err().to_string();
        assert!(none.contains("target save"), "{none}");
    }
}

//! What a calibration and a target are on disk, what they may be called, and which calibration is one.

use crate::error::CliError;
use scopeservo_scope::{Objective, StagePose};
use scopeservo_servo::{CalibrateOptions, Calibration, Target};
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// Version of the files.
pub(crate) const SCHEMA: u32 = 1;

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

/// Whether a calibration can be one of this objective: by the rules that a new one must pass.
pub(crate) fn judge(calibration: &Calibration, objective: &Objective) -> Result<(), String> {
    let rules = CalibrateOptions::default();
    let [[a, b], [c, d]] = calibration.stage_from_pixel.0;
    let centre_m = calibration.rotation_centre_m.unwrap_or_default();
    let covariance = calibration.covariance.unwrap_or_default();
    let variances = covariance.iter().enumerate().map(|(i, row)| row[i]);
    let mut numbers = [a, b, c, d].into_iter().chain(centre_m);
    let [large, small] = calibration.stage_from_pixel.svd().s;
    let (measured, nominal) = (calibration.um_per_px(), objective.nominal_um_per_px);
    let factor = (measured / nominal).max(nominal / measured);
    if calibration.objective != objective.id {
        return Err(format!(
            "it is of {}, and lies with those of {}",
            calibration.objective, objective.id
        ));
    }
    if !numbers.all(|v| v.abs() < LARGEST_M) || !variances.into_iter().all(|v| v >= 0.0) {
        return Err("its numbers are those of no calibration".into());
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

/// No part of a microscope is farther from another, metres.
const LARGEST_M: f64 = 10.0;

/// Names that some systems give to devices, whatever follows a dot.
const DEVICES: [&str; 4] = ["CON", "PRN", "AUX", "NUL"];
/// With it a file's name stays within what every file system takes.
const LONGEST_NAME: usize = 100;

/// Refuses a name under which a target could not be found again: on another system, or by a command line.
pub(crate) fn check_name(name: &str) -> Result<(), CliError> {
    let stem = name.split('.').next().unwrap_or(name).to_ascii_uppercase();
    let port = |s: &str| {
        let number = s.strip_prefix("COM").or_else(|| s.strip_prefix("LPT"));
        number.is_some_and(|n| n.len() == 1 && n.chars().all(|c| c.is_ascii_digit()))
    };
    let why = if name.len() > LONGEST_NAME {
        format!("it has more than {LONGEST_NAME} characters")
    } else if name.starts_with('-') {
        "a command would take it for an option".into()
    } else if name.ends_with('.') {
        "some systems drop a dot at the end".into()
    } else if DEVICES.contains(&stem.as_str()) || port(&stem) {
        "some systems have a device of that name".into()
    } else {
        return Ok(());
    };
    Err(CliError::Usage(format!(
        "this target could not be found again everywhere under the name '{}': {why}. Give another, like mitosis-3",
        name.chars().take(LONGEST_NAME).collect::<String>()
    )))
}

/// The number before a file's time; 0 for one without, and for one that no counting comes to.
pub(crate) fn number_of(path: &Path) -> u64 {
    let stem = path.file_stem().and_then(|s| s.to_str());
    let number = stem.and_then(|s| s.split_once('_')).map(|(n, _)| n.parse());
    let counted = number.and_then(Result::ok).filter(|n| *n < 1_000_000_000);
    counted.unwrap_or(0)
}

/// A name as a file's: what is no letter or digit as its number.
pub(crate) fn file_name(name: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    name.chars()
        .map(|c| match plain(c) {
            true => c.to_string(),
            false => format!("%{:x}", u32::from(c)),
        })
        .collect()
}

/// A moment in UTC, to the second: 2026-11-24T20:15:00Z.
pub(crate) fn utc(at: SystemTime) -> String {
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
    use scopeservo_scope::ObjectiveId;
    use std::time::Duration;

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
    fn a_damaged_calibration_is_none() {
        let objective = Objective {
            id: ObjectiveId("10x".into()),
            magnification: 100.0,
            numerical_aperture: 0.25,
            nominal_um_per_px: 0.5,
        };
        let sound = Calibration {
            schema: scopeservo_servo::CALIBRATION_SCHEMA,
            objective: objective.id.clone(),
            image_size_px: [640, 480],
            stage_from_pixel: Mat2([[-5.1e-7, 1e-8], [1e-8, 5.0e-7]]),
            rotation_centre_m: Some([-0.01, 0.2]),
            covariance: Some([[1e-20; 6]; 6]),
            backlash_m: None,
            parcentric_offset_m: None,
            parfocal_offset_m: None,
        };
        assert_eq!(judge(&sound, &objective), Ok(()));
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
            assert!(judge(&damaged, &objective).is_err(), "{map:?}");
        }
        let mut damaged = sound.clone();
        damaged.rotation_centre_m = Some([1e308, 0.0]);
        assert!(judge(&damaged, &objective).is_err());
        damaged = sound.clone();
        damaged.covariance = Some([[-1.0; 6]; 6]);
        assert!(judge(&damaged, &objective).is_err());
        damaged = sound;
        damaged.objective = ObjectiveId("40x".into());
        assert!(judge(&damaged, &objective).is_err());
    }

    #[test]
    fn a_name_that_could_not_be_found_again_is_refused() {
        let long = "a".repeat(251);
        for bad in [
            "-rf", "--json", "a.", "CON", "con.", "nul.json", "com1", &long,
        ] {
            assert!(check_name(bad).is_err(), "{bad}");
        }
        for good in ["t1", "mitosis-3.b_2", "console", "COM10", "com"] {
            assert!(check_name(good).is_ok(), "{good}");
        }
    }

    #[test]
    fn a_number_that_no_counting_comes_to_is_none() {
        assert_eq!(number_of(Path::new("000042_2026.json")), 42);
        for none in ["2026-11-24.json", "18446744073709551615_x.json", "x_1.json"] {
            assert_eq!(number_of(Path::new(none)), 0, "{none}");
        }
    }
}

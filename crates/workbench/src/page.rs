//! What every page says of an instrument and of how it was made.

use crate::Workbench;
use scopeservo_library::{CalibrationFile, Calibrations as _, KeptCalibration, utc};
use scopeservo_report::{Context, Stored};
use std::time::SystemTime;

/// A moment as files have it, 2026-11-24T20:15:00Z, for people.
pub fn readable(utc: &str) -> String {
    let minute = utc.get(..16).map(|t| t.replace('T', " "));
    minute.map_or_else(|| utc.into(), |t| format!("{t} UTC"))
}

impl Workbench {
    /// The page of something that was done now. `command`: how somebody asked for it.
    pub fn page_context(&self, command: String) -> Context {
        Context {
            specimen: self.specimen(),
            instrument: self.config.name.clone(),
            simulated: self.is_simulated(),
            command,
            version: env!("CARGO_PKG_VERSION").into(),
            date: readable(&utc(SystemTime::now())),
            stored: self.stored(),
            ..Context::default()
        }
    }

    /// The calibrations of this instrument and camera that are kept, the newest of each objective. One that is damaged was told of before.
    fn stored(&self) -> Vec<Stored> {
        let info = self.scope.camera().info();
        let fits = |kept: &KeptCalibration| {
            kept.is_of(&self.config.name)
                && kept.calibration.image_size_px == [info.width, info.height]
        };
        let history = self.library.calibration_history().unwrap_or_default();
        let newest = |files: Vec<CalibrationFile>| {
            files
                .into_iter()
                .rev()
                .find_map(|CalibrationFile { path, kept }| {
                    let kept = kept.ok().filter(fits)?;
                    Some(Stored {
                        calibration: kept.calibration,
                        file: path.display().to_string(),
                        made: readable(&kept.made),
                    })
                })
        };
        history.into_iter().filter_map(newest).collect()
    }
}

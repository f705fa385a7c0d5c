//! Calibrations.

use crate::app::App;
use crate::error::ApiError;
use scopeservo_library::Calibrations as _;
use serde_json::{Value, json};

/// All of them, objective by objective, the newest first; in use is the newest that this instrument made.
pub(crate) fn calibrations(app: &App) -> Result<Value, ApiError> {
    let mut all = Vec::new();
    for files in app.bench.library.calibration_history()? {
        let mut is_newest = true;
        let own = &app.bench.config.name;
        for file in files.into_iter().rev() {
            all.push(match file.kept {
                Err(error) => json!({"damaged": error.to_string()}),
                Ok(kept) => {
                    let c = &kept.calibration;
                    let um_per_px = c.um_per_px();
                    let sigma = c.sigma_of(|c| Some(c.um_per_px()));
                    let angle = c.reading().map(|r| r.phi_rad.to_degrees());
                    let in_use = kept.is_of(own) && std::mem::replace(&mut is_newest, false);
                    json!({
                        "objective": c.objective,
                        "made": kept.made,
                        "instrument": kept.instrument,
                        "um_per_px": um_per_px,
                        "sigma_percent": sigma.map(|s| 100.0 * s / um_per_px),
                        "angle_deg": angle,
                        "expected_error_um": c.expected_error_um(),
                        "in_use": in_use,
                    })
                }
            });
        }
    }
    Ok(Value::Array(all))
}

//! From the fit to the calibration, and whether it can be one.

use super::Chain;
use crate::calibrate::joint::JointFit;
use crate::hand_eye::pose_sigma;
use crate::{Backlash, CALIBRATION_SCHEMA, Calibration, ServoError};
use scopeservo_registration::NotFound;
use scopeservo_scope::{Axis, Instrument};

/// Pairs of views that contradict all others may be so many of them, at most.
const LEFT_OUT: f64 = 0.2;
/// Views that must be found: those at the beginning of the path.
const NEEDED: usize = 4;
/// A rotation centre that is known no better is not known, m.
const UNKNOWN_M: f64 = 5e-3;

impl Chain {
    /// The calibration, and how far what is seen is from what the stage reported, px; refused where the views do not show it, and where
    /// it contradicts what is engraved or what the stage says of itself.
    pub(super) fn verdict(&self, scope: &Instrument) -> Result<(Calibration, f64), ServoError> {
        let turns = scope.gate().info().axis(Axis::Rz).is_some();
        let found = self.taken.iter().filter(|t| t.found).count();
        let fit = self.solve(scope).filter(|_| found >= NEEDED);
        let fit = fit.ok_or_else(|| self.too_few(found))?;
        let covariance = fit.optics_covariance(0);
        if turns && (4..6).any(|k| covariance[k][k].sqrt() > UNKNOWN_M) {
            return Err(self.too_few(found));
        }
        let optics = &fit.instrument.optics[0];
        let camera = scope.camera().info();
        let [x_m, y_m, rz_rad] = fit.instrument.backlash;
        let calibration = Calibration {
            schema: CALIBRATION_SCHEMA,
            objective: self.objective.id.clone(),
            image_size_px: [camera.width, camera.height],
            stage_from_pixel: optics.stage_from_pixel,
            rotation_centre_m: turns.then_some(optics.centre_m),
            covariance: Some(covariance),
            backlash: Some(Backlash {
                x_m,
                y_m,
                rz_rad,
                sigma: fit.backlash_sigma(),
            }),
            scatter: Some(fit.scatter.map(Option::unwrap_or_default)),
        };
        self.options.plausible(&calibration, &self.objective)?;
        let m_per_px = calibration.um_per_px() * 1e-6;
        let residual_px = scatter_m(&fit, fit.scatter.map(Option::unwrap_or_default)) / m_per_px;
        // One pixel is for what the data sheet does not name: vibration, drift, the slide's seat.
        let stated_px = scatter_m(&fit, pose_sigma(scope.gate().info())) / m_per_px;
        let allowed_px = 1.0 + self.options.residual_factor * stated_px;
        let [large, small] = optics.stage_from_pixel.svd().s;
        let left_out = fit.left_out.len() as f64 > LEFT_OUT * self.pairs.len() as f64;
        if residual_px > allowed_px || left_out || large > self.options.anisotropy * small {
            return Err(ServoError::CalibrationInconsistent {
                objective: self.objective.id.clone(),
                residual_px,
                allowed_px,
            });
        }
        Ok((calibration, residual_px))
    }

    fn too_few(&self, found: usize) -> ServoError {
        ServoError::CalibrationViews {
            objective: self.objective.id.clone(),
            measured: found.saturating_sub(1),
            needed: NEEDED - 1,
            last: self
                .last_reason
                .clone()
                .unwrap_or(NotFound::TooFewFeatures {
                    view: 0,
                    target: 0,
                    needed: NEEDED,
                }),
        }
    }
}

/// How far a view is displaced, per coordinate, by arrivals that scatter so, m, m, rad.
fn scatter_m(fit: &JointFit, sigma: [f64; 3]) -> f64 {
    let [x, y] = fit.instrument.optics[0].centre_m;
    let turned_m = f64::hypot(x, y) * sigma[2];
    ((sigma[0].powi(2) + sigma[1].powi(2) + turned_m.powi(2)) / 2.0).sqrt()
}

//! From the fit to the calibration, and whether it can be one.

use super::Chain;
use crate::calibrate::joint::{JointFit, Role};
use crate::calibrate::options::too_few;
use crate::hand_eye::pose_sigma;
use crate::{Backlash, CALIBRATION_SCHEMA, Calibration, ServoError};
use scopeservo_scope::{Axis, Instrument};

/// Pairs of views that contradict all others may be so many of them, at most.
const LEFT_OUT: f64 = 0.2;
/// Views that must be found: those at the beginning of the path.
const NEEDED: usize = 4;
/// A place whose views have fewer features than this, and none that is found again, is blank: noise has some, too.
const BLANK: usize = 60;
/// A rotation centre that is known no better is not known, m.
const UNKNOWN_M: f64 = 5e-3;

impl Chain {
    /// The calibration, and how far what is seen is from what the stage reported, px; refused where the views do not show it, and where
    /// it contradicts what is engraved or what the stage says of itself.
    pub(super) fn verdict(&self, scope: &Instrument) -> Result<(Calibration, f64), ServoError> {
        let turns = scope.gate().info().axis(Axis::Rz).is_some();
        let found = self.taken.iter().filter(|t| t.found).count();
        let fit = self.whole_fit(scope).filter(|_| found >= NEEDED);
        let fit = fit.ok_or_else(|| match found >= NEEDED {
            // Enough was found, and no calibration explains it.
            true => self.astray(scope, None),
            false => self.too_few(found),
        })?;
        let covariance = fit.optics_covariance(0);
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
        let m_per_px = calibration.um_per_px() * 1e-6;
        let centre_m = (4..6).map(|k| covariance[k][k].sqrt()).fold(0.0, f64::max);
        let unknown = || ServoError::CentreUnknown {
            objective: self.objective.id.clone(),
            sigma_mm: 1e3 * centre_m,
        };
        // Without room to turn nothing is known of it, and the views contradict nothing.
        if turns && centre_m > UNKNOWN_M && !self.has_turned() {
            return Err(unknown());
        }
        let stated_px = scatter_m(&fit, pose_sigma(scope.gate().info())) / m_per_px;
        if let Some(known) = self.known(scope) {
            self.still_obeys(scope, &known, &fit, &calibration, stated_px)?;
        }
        if turns && centre_m > UNKNOWN_M {
            return Err(unknown());
        }
        let residual_px = scatter_m(&fit, fit.scatter.map(Option::unwrap_or_default)) / m_per_px;
        if fit.left_out.len() as f64 > LEFT_OUT * self.pairs.len() as f64 {
            return Err(ServoError::CalibrationContradicted {
                objective: self.objective.id.clone(),
                left_out: fit.left_out.len(),
                pairs: self.pairs.len(),
            });
        }
        let seen = (residual_px, stated_px);
        let judged = self.options.judge(&calibration, &self.objective, seen);
        judged.map_err(|error| match error {
            // An objective does not change its scale on the way.
            ServoError::CalibrationImplausible { .. } if self.began_as_engraved() => {
                self.astray(scope, None)
            }
            error => error,
        })?;
        Ok((calibration, residual_px))
    }

    /// Whether any view was asked for that is turned.
    fn has_turned(&self) -> bool {
        let mut angles = self.taken.iter().map(|t| t.asked.theta_rad);
        let first = angles.next();
        angles.any(|angle| Some(angle) != first)
    }

    /// What all views say: known already, unless the path ended on one of which it learns nothing new.
    pub(super) fn whole_fit(&self, scope: &Instrument) -> Option<JointFit> {
        let whole = |fit: &&JointFit| fit.poses.len() == self.taken.len();
        let known = self.fit.as_ref().filter(whole).cloned();
        known.or_else(|| self.solve(scope))
    }

    /// Why the first moves could not be measured.
    fn too_few(&self, found: usize) -> ServoError {
        let first = self.taken.first().map(|t| t.asked.x_m[0]);
        if let (Some(last), Some(first), true) = (self.taken.last(), first, self.stayed)
            && matches!(last.role, Role::Corner { index: 0, .. })
        {
            return self.stands(Axis::X, (last.asked.x_m[0] - first).abs());
        }
        if self.most_features < BLANK {
            return ServoError::BlankView {
                objective: self.objective.id.clone(),
                features: self.most_features,
                needed: BLANK,
            };
        }
        let measured = found.saturating_sub(1);
        too_few(
            &self.objective,
            measured,
            NEEDED - 1,
            self.last_reason.as_ref(),
        )
    }
}

/// How far a view is displaced, per coordinate, by arrivals that scatter so, m, m, rad.
fn scatter_m(fit: &JointFit, sigma: [f64; 3]) -> f64 {
    let [x, y] = fit.instrument.optics[0].centre_m;
    let turned_m = f64::hypot(x, y) * sigma[2];
    ((sigma[0].powi(2) + sigma[1].powi(2) + turned_m.powi(2)) / 2.0).sqrt()
}

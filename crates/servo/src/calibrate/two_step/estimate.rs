//! From the observations to the calibration, and whether it can be one.

use super::plan::NEEDED;
use super::procedure::{TwoStep, no_reference};
use crate::hand_eye::{covariance, explained_px, pose_sigma, solve_hand_eye};
use crate::{CALIBRATION_SCHEMA, Calibration, ServoError};
use scopeservo_scope::Instrument;

impl TwoStep {
    /// The calibration and its residual, px; refused where it contradicts what is engraved or what the stage reported.
    pub(super) fn finish(&self, scope: &Instrument) -> Result<(Calibration, f64), ServoError> {
        let info = scope.gate().info();
        let reference = self.reference_pose.ok_or_else(no_reference)?;
        let (pixel_from_stage, eta, residual_px) = solve_hand_eye(
            info.kinematics,
            &reference,
            &self.translations,
            &self.rotations,
        )
        .ok_or_else(|| self.too_few(self.translations.len(), NEEDED))?;
        let stage_from_pixel = pixel_from_stage
            .inverse()
            .ok_or_else(|| self.too_few(self.translations.len(), NEEDED))?;
        let pose_sigma = pose_sigma(info);
        let camera = scope.camera().info();
        let calibration = Calibration {
            schema: CALIBRATION_SCHEMA,
            objective: self.objective.id.clone(),
            image_size_px: [camera.width, camera.height],
            stage_from_pixel,
            rotation_centre_m: eta,
            covariance: covariance(
                info.kinematics,
                &reference,
                &self.translations,
                &self.rotations,
                pose_sigma,
            ),
            backlash: None,
            scatter: None,
        };
        let explained_px = explained_px(&reference, &calibration, info.kinematics, pose_sigma);
        let seen = (residual_px, explained_px);
        self.options.judge(&calibration, &self.objective, seen)?;
        Ok((calibration, residual_px))
    }
}

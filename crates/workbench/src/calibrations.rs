//! The calibrations in use.

use crate::Workbench;
use crate::known::or_warn;
use scopeservo_library::{Calibrations as _, KeptCalibration, LibraryError};
use scopeservo_scope::Objective;
use scopeservo_servo::Calibration;

impl Workbench {
    /// The newest calibration of an objective, where it can be one of it on this stage.
    ///
    /// # Errors
    /// Those of [`scopeservo_library::Calibrations::calibration`].
    pub fn calibration_of(
        &self,
        objective: &Objective,
    ) -> Result<Option<KeptCalibration>, LibraryError> {
        let ranges = self.scope.gate().ranges();
        self.library.calibration(objective, ranges)
    }

    /// The calibrations that this instrument and camera made. One that is damaged is told, and measured again on the way.
    pub fn known_calibrations(&self, mut warn: impl FnMut(LibraryError)) -> Vec<Calibration> {
        let info = self.scope.camera().info();
        let size_px = [info.width, info.height];
        let objectives = self.scope.gate().objectives().iter();
        let kept = objectives.filter_map(|o| or_warn(self.calibration_of(o), &mut warn).flatten());
        // Of another instrument or camera, or another mode of it, it is of no use.
        kept.filter(|k| k.calibration.image_size_px == size_px && k.instrument == self.config.name)
            .map(|k| k.calibration)
            .collect()
    }
}

//! What a run is told before it begins.

use super::Reposition;
use crate::{Calibration, Parcentric, SwitchingReport};
use scopeservo_scope::ObjectiveId;

impl Reposition {
    /// The target was taken by another microscope, where a pixel has this size on the specimen.
    #[must_use]
    pub fn with_foreign_scale(mut self, um_per_px: f64) -> Self {
        self.foreign_um_per_px = Some(um_per_px);
        self
    }

    /// Takes calibrations that are known already: those objectives are not calibrated on the way.
    #[must_use]
    pub fn with_calibrations(
        mut self,
        known: impl IntoIterator<Item = (ObjectiveId, Calibration)>,
    ) -> Self {
        for (objective, calibration) in known {
            self.known.insert(objective.clone());
            self.calibrations.insert(objective, calibration);
        }
        self
    }

    /// Takes what is known of where objectives look beside each other.
    #[must_use]
    pub fn with_switchings(self, switchings: Vec<SwitchingReport>) -> Self {
        Self { switchings, ..self }
    }

    /// Takes where objectives look beside each other by calibrations that were made together; it counts while these are the ones in use.
    #[must_use]
    pub fn with_parcentric(self, parcentric: Vec<Parcentric>) -> Self {
        Self { parcentric, ..self }
    }
}

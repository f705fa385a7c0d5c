//! What the instrument is.

use crate::app::App;
use crate::error::ApiError;
use scopeservo_scope::{Axis, ObjectiveId};
use serde_json::{Value, json};

impl App {
    /// The size of a pixel with this objective, um: as calibrated, else as engraved.
    pub(crate) fn um_per_px(&self, id: &ObjectiveId) -> Option<f64> {
        let objective = self.bench.scope.objective(id).ok()?;
        let known = crate::lock(&self.calibrated);
        Some(
            known
                .get(id)
                .copied()
                .unwrap_or(objective.nominal_um_per_px),
        )
    }

    /// Reads which objectives are calibrated: asked when that may have changed, as it reads files.
    pub(crate) fn learn_calibrated(&self) {
        let known = self.bench.known_calibrations(|_| {}).into_iter();
        let known = known.map(|c| (c.objective.clone(), c.um_per_px()));
        *crate::lock(&self.calibrated) = known.collect();
        self.has_changed();
    }

    /// The instrument, for people and programs.
    pub(crate) fn described(&self) -> Result<Value, ApiError> {
        let scope = &self.bench.scope;
        let gate = scope.gate();
        let known = crate::lock(&self.calibrated).clone();
        let objectives = gate.objectives().iter().map(|o| {
            json!({
                "id": o.id,
                "magnification": o.magnification,
                "na": o.numerical_aperture,
                "immersion": o.immersion,
                "um_per_px": known.get(&o.id).copied().unwrap_or(o.nominal_um_per_px),
                "calibrated": known.contains_key(&o.id),
            })
        });
        let axes = gate.ranges().iter().map(|range| {
            let name = format!("{:?}", range.axis).to_lowercase();
            let shown = |si: f64| range.axis.to_display(si);
            json!({
                "axis": name,
                "unit": range.axis.display_unit(),
                "least": shown(range.min),
                "most": shown(range.max),
                "turns": range.axis == Axis::Rz,
            })
        });
        let nearer = gate.info().positive_z.nearer_by(1.0, 0.0) > 0.0;
        let info = scope.camera().info();
        Ok(json!({
            "name": self.bench.config.name,
            "simulated": self.bench.is_simulated(),
            "version": env!("CARGO_PKG_VERSION"),
            "objectives": objectives.collect::<Vec<_>>(),
            "axes": axes.collect::<Vec<_>>(),
            // Which way z goes towards the specimen.
            "nearer_z": if nearer { 1 } else { -1 },
            "camera": {"name": info.name, "width": info.width, "height": info.height},
            "has_light": scope.light().is_some(),
            "demo": self.demo.is_some(),
            "left": self.bench.waits()?,
        }))
    }
}

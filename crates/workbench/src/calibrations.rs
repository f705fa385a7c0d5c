//! The calibrations in use.

use crate::Workbench;
use crate::known::or_warn;
use scopeservo_library::{Calibrations as _, KeptCalibration, LibraryError};
use scopeservo_scope::Objective;
use scopeservo_servo::Calibration;

impl Workbench {
    /// The newest calibration of an objective that this instrument made with images of the camera's present size, where it can be one of it on this
    /// stage.
    ///
    /// # Errors
    /// Those of [`scopeservo_library::Calibrations::calibration`].
    pub fn calibration_of(
        &self,
        objective: &Objective,
    ) -> Result<Option<KeptCalibration>, LibraryError> {
        let (ranges, camera) = (self.scope.gate().ranges(), self.scope.camera().info());
        let size_px = [camera.width, camera.height];
        self.library
            .calibration(&self.config.name, objective, ranges, size_px)
    }

    /// The calibrations that this instrument and camera made. One that is damaged is told, and measured again on the way.
    pub fn known_calibrations(&self, mut warn: impl FnMut(LibraryError)) -> Vec<Calibration> {
        let objectives = self.scope.gate().objectives().iter();
        let kept = objectives.filter_map(|o| or_warn(self.calibration_of(o), &mut warn).flatten());
        let kept: Vec<_> = kept.collect();
        for nobodys in kept.iter().filter(|k| k.instrument.is_empty()) {
            warn(LibraryError::NobodysCalibration {
                objective: nobodys.calibration.objective.0.clone(),
                instrument: self.config.name.clone(),
            });
        }
        kept.into_iter().map(|k| k.calibration).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::Mat2;
    use scopeservo_scope::CancelToken;
    use scopeservo_setup::{Config, Consent};

    const TWIN: &str = "name = \"NAME\"
data_folder = \"data\"
[drivers.twin.twin]
seed = 3
objectives = [\"40x\"]
[devices]
stage = \"twin\"
camera = \"twin\"
nosepiece = \"twin\"
";

    /// Two instruments with one library, whose axes go the other way round.
    #[test]
    fn an_instrument_works_by_what_it_measured_itself_whoever_measured_last() {
        let dir = tempfile::tempdir().unwrap();
        let open = |name: &str| {
            let text = TWIN.replace("NAME", name);
            let config = Config::parse(&text, &dir.path().join("scopeservo.toml")).unwrap();
            let consent = Consent {
                home: false,
                ask: std::sync::Arc::new(|_, _| false),
                ask_immersion: std::sync::Arc::new(|_, _| false),
            };
            Workbench::open(config, &consent, CancelToken::new(), |e| panic!("{e}")).unwrap()
        };
        let keep = |bench: &Workbench, instrument: &str, um: f64| {
            let objective = &bench.scope.gate().objectives()[0];
            let info = bench.scope.camera().info();
            let um = um.signum() * objective.nominal_um_per_px * um.abs();
            let calibration = Calibration {
                schema: scopeservo_servo::CALIBRATION_SCHEMA,
                objective: objective.id.clone(),
                image_size_px: [info.width, info.height],
                stage_from_pixel: Mat2::diagonal(um * 1e-6, um * 1e-6),
                rotation_centre_m: None,
                covariance: None,
                backlash: None,
                scatter: None,
            };
            let library = &bench.library;
            let kept = library.keep_calibration(instrument, &calibration, None, None);
            kept.unwrap();
            calibration
        };
        let known = |bench: &Workbench| {
            let mut warnings = Vec::new();
            let known = bench.known_calibrations(|warning| warnings.push(warning.to_string()));
            (known, warnings)
        };
        let (left, right) = (open("left"), open("right"));
        let of_left = keep(&left, "left", 1.0);
        assert_eq!(known(&left), (vec![of_left.clone()], vec![]));
        assert_eq!(known(&right), (vec![], vec![]));
        let of_right = keep(&right, "right", -1.0);
        assert_eq!(known(&left), (vec![of_left], vec![]));
        assert_eq!(known(&right), (vec![of_right.clone()], vec![]));
        // One of which nobody knows whose it is counts as before, and that is told.
        let nobodys = keep(&left, "", 1.01);
        let (now, warnings) = known(&left);
        assert_eq!(now, [nobodys]);
        assert!(warnings[0].contains("does not say"), "{warnings:?}");
        let anew = keep(&right, "right", -1.02);
        assert_eq!(known(&right), (vec![anew.clone()], vec![]));
        // With pixels in twos, whose scale is none of this objective's now, it hides nothing and is not damaged.
        let binned = Calibration {
            image_size_px: anew.image_size_px.map(|side| side / 2),
            stage_from_pixel: Mat2([[0.0, 1.0], [1.0, 0.0]]) * Mat2::diagonal(2e-6, 2e-6),
            ..anew.clone()
        };
        let library = &right.library;
        library
            .keep_calibration("right", &binned, None, None)
            .unwrap();
        assert_eq!(known(&right), (vec![anew], vec![]));
    }
}

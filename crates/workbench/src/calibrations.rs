//! The calibrations in use.

use crate::Workbench;
use crate::known::or_warn;
use scopeservo_library::{Calibrations as _, KeptCalibration, KeptTarget, LibraryError};
use scopeservo_scope::{Axis, Objective, StagePose};
use scopeservo_servo::Calibration;
use scopeservo_station::jobs::SaveTargetJob;

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

/// A size of pixels that differs by more than this share is another mode of the camera, and no drift.
const OTHER_MODE: f64 = 0.05;

impl Workbench {
    /// Size of a pixel on the specimen, um, of a target that this instrument saved with another camera, or with pixels binned otherwise. `known`: the
    /// calibrations in use.
    pub fn other_mode_um_per_px(&self, kept: &KeptTarget, known: &[Calibration]) -> Option<f64> {
        let taken = kept.target.taken.as_ref()?;
        let camera = self.scope.camera().info();
        let same_size = [taken.frame.width, taken.frame.height] == [camera.width, camera.height];
        if same_size || kept.instrument != self.config.name {
            return None;
        }
        let id = &kept.target.objective;
        let engraved = || Some(self.scope.objective(id).ok()?.nominal_um_per_px);
        let calibrated = known.iter().find(|c| c.objective == *id);
        let now = calibrated.map(Calibration::um_per_px).or_else(engraved)?;
        // One with the same pixels is a crop.
        ((taken.um_per_px / now - 1.0).abs() > OTHER_MODE).then_some(taken.um_per_px)
    }

    /// Whether a target is the one that a job saved which a kill has ended before it said so.
    pub fn was_kept_by(&self, kept: &KeptTarget, job: &SaveTargetJob) -> bool {
        let same = |stage: &StagePose| {
            Axis::ALL.into_iter().all(|axis| {
                let both = (stage.si(axis), kept.stage.si(axis));
                match both {
                    (Some(a), Some(b)) => (a - b).abs() < 1e-12,
                    (a, b) => a == b,
                }
            })
        };
        kept.instrument == self.config.name && job.stage().is_some_and(same)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::Mat2;
    use scopeservo_scope::CancelToken;
    use scopeservo_servo::{Focus, FocusOptions, NoSink, SaveOptions, SaveTarget, run};
    use scopeservo_setup::{Config, Consent};
    use scopeservo_station::jobs::SaveTargetInput;

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

    #[test]
    fn a_target_of_another_mode_of_the_camera_keeps_its_own_scale_and_a_save_is_told_by_its_place()
    {
        let dir = tempfile::tempdir().unwrap();
        let text = TWIN.replace("NAME", "lab");
        let config = Config::parse(&text, &dir.path().join("scopeservo.toml")).unwrap();
        let consent = Consent {
            home: false,
            ask: std::sync::Arc::new(|_, _| false),
            ask_immersion: std::sync::Arc::new(|_, _| false),
        };
        let bench =
            Workbench::open(config, &consent, CancelToken::new(), |e| panic!("{e}")).unwrap();
        let scope = &bench.scope;
        let mut saves = SaveTarget::new(SaveOptions::default());
        let objective = &scope.gate().objectives()[0];
        let focus = Focus::new(objective.clone(), FocusOptions::default());
        run(&mut { focus }, scope, &mut NoSink).unwrap();
        let stage = scope.gate().position().unwrap();
        let kept = KeptTarget {
            id: String::new(),
            saved: String::new(),
            instrument: "lab".into(),
            stage,
            target: run(&mut saves, scope, &mut NoSink).unwrap(),
        };
        assert_eq!(bench.other_mode_um_per_px(&kept, &[]), None);
        // As it were with pixels in twos: half as many, twice as large.
        let mut binned = kept.clone();
        let taken = std::sync::Arc::make_mut(binned.target.taken.as_mut().unwrap());
        let frame = std::sync::Arc::make_mut(&mut taken.frame);
        (frame.width, frame.height) = (frame.width / 2, frame.height / 2);
        assert_eq!(bench.other_mode_um_per_px(&binned, &[]), None, "a crop");
        let taken = std::sync::Arc::make_mut(binned.target.taken.as_mut().unwrap());
        taken.um_per_px *= 2.0;
        let um_per_px = taken.um_per_px;
        assert_eq!(bench.other_mode_um_per_px(&binned, &[]), Some(um_per_px));
        let elsewhere = KeptTarget {
            instrument: "other".into(),
            ..binned
        };
        assert_eq!(bench.other_mode_um_per_px(&elsewhere, &[]), None);

        // A job that was killed at its last step, which has kept this one or another one of that name.
        let at = |stage: &StagePose| {
            let job = serde_json::to_value(SaveTargetJob::new(SaveTargetInput::default())).unwrap();
            let save = SaveTarget::new(SaveOptions::default());
            let mut job = job;
            job["state"] = serde_json::json!({"save": {"stage": stage, "save": save}});
            serde_json::from_value::<SaveTargetJob>(job).unwrap()
        };
        assert!(bench.was_kept_by(&kept, &at(&stage)));
        let beside = stage.with_si(Axis::X, stage.si(Axis::X).unwrap() + 1e-6);
        assert!(!bench.was_kept_by(&kept, &at(&beside)));
        assert!(!bench.was_kept_by(&elsewhere, &at(&stage)));
        let begins = SaveTargetJob::new(SaveTargetInput::default());
        assert!(!bench.was_kept_by(&kept, &begins));
    }
}

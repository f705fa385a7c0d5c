//! Kept targets, as this instrument sees them.

use crate::Workbench;
use scopeservo_library::KeptTarget;
use scopeservo_scope::{Axis, StagePose};
use scopeservo_servo::Calibration;
use scopeservo_station::jobs::SaveTargetJob;

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

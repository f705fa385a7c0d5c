//! Smears of few cells, and what is saved on them.

use crate::common::{Bench, bench, bench_over, options};
use scopeservo_scope::{Instrument, ObjectiveId};
use scopeservo_servo::{
    Attempt, Bring, Calibrate, Calibration, FocusOptions, NoSink, Outcome, Remark, Reposition,
    RepositionOptions, SaveOptions, SaveTarget, Target, Verdict, VisionOptions, run,
};
use scopeservo_twin::specimen::{Patch, Specimen, SpecimenError, Twice};
use scopeservo_twin::{Config, Sparse, SparseConfig, StageConfig, Truth};
use std::sync::{Arc, OnceLock};

/// The place that is saved.
pub(crate) const SAVED_UM: [f64; 2] = [0.0, 0.0];

pub(crate) fn config() -> Config {
    let mut config = Config::realistic().with_stage(StageConfig::xyz_theta());
    // Only where a few cells lie counts here.
    config.camera.dust.clear();
    config
}

/// Of all objectives, made on dense tissue.
pub(crate) fn calibrations() -> Vec<(ObjectiveId, Calibration)> {
    static KNOWN: OnceLock<Vec<(ObjectiveId, Calibration)>> = OnceLock::new();
    let make = || {
        let bench = bench(config());
        let all = bench.scope.gate().objectives().to_vec();
        let one = |objective: &scopeservo_scope::Objective| {
            bring(&bench.scope, &objective.id.0);
            let vision = VisionOptions::default();
            let mut calibrate = Calibrate::new(objective.clone(), options().calibrate, vision);
            let calibration = run(&mut calibrate, &bench.scope, &mut NoSink).unwrap();
            (objective.id.clone(), calibration)
        };
        all.iter().map(one).collect()
    };
    KNOWN.get_or_init(make).clone()
}

pub(crate) fn bring(scope: &Instrument, id: &str) {
    let focus = Some(FocusOptions::default());
    let id = ObjectiveId(id.into());
    let mut bring = Bring::new(id, focus, VisionOptions::default());
    run(&mut bring, scope, &mut NoSink).unwrap();
}

pub(crate) fn smear(seed: u64) -> Arc<dyn Specimen> {
    smear_of(75.0, seed)
}

pub(crate) fn smear_of(per_mm2: f64, seed: u64) -> Arc<dyn Specimen> {
    let config = SparseConfig {
        seed,
        per_mm2,
        ..SparseConfig::default()
    };
    Arc::new(Sparse::new(config).unwrap())
}

/// Saves the place with 40x; `None` where too little lies there.
pub(crate) fn save(bench: &Bench) -> Option<(Target, Truth)> {
    bench.twin.centre_specimen(SAVED_UM, 0.0);
    bring(&bench.scope, "40x");
    let mut save = SaveTarget::new(SaveOptions::default());
    let target = run(&mut save, &bench.scope, &mut NoSink).ok()?;
    Some((target, bench.twin.truth_now()))
}

pub(crate) fn back(target: Target) -> Reposition {
    let options = RepositionOptions::default();
    Reposition::new(target, options).with_calibrations(calibrations())
}

pub(crate) fn visited(outcome: &Outcome) -> Option<usize> {
    outcome.remarks.iter().find_map(|remark| match remark {
        Remark::Tried {
            attempt: Attempt::PlacesVisited { most, .. },
            ..
        } => Some(*most),
        _ => None,
    })
}

/// A smear of which the place is saved, and lies elsewhere now; the target and where it truly is.
pub(crate) fn put_back(seed: u64) -> Option<(Bench, Target, Truth)> {
    let bench = bench_over(config(), smear(seed), Vec::new());
    let (target, truth) = save(&bench)?;
    bench.twin.remount(SAVED_UM, [260.0, -170.0], 4.0, false);
    Some((bench, target, truth))
}

/// The same where the place is not found without a look.
pub(crate) fn hard() -> (Bench, Target, Truth) {
    static SEED: OnceLock<u64> = OnceLock::new();
    let needs_look = |seed: &u64| {
        put_back(*seed).is_some_and(|(bench, target, _)| {
            let outcome = run(&mut back(target), &bench.scope, &mut NoSink).unwrap();
            outcome.verdict == Verdict::Arrived && visited(&outcome).is_some()
        })
    };
    let seed = SEED.get_or_init(|| {
        (1..=10)
            .find(needs_look)
            .expect("a place that needs a look")
    });
    put_back(*seed).unwrap()
}

/// Shows one specimen to the lowest objective and another to the highest: what looks like the target from afar is none.
pub(crate) struct TwoFaced {
    pub(crate) afar: Arc<dyn Specimen>,
    pub(crate) near: Arc<dyn Specimen>,
}

impl Specimen for TwoFaced {
    fn finest_um(&self) -> f64 {
        self.afar.finest_um()
    }

    fn levels(&self) -> usize {
        self.afar.levels()
    }

    fn patch(
        &self,
        level: usize,
        x_um: [f64; 2],
        y_um: [f64; 2],
        margin: usize,
    ) -> Result<Patch, SpecimenError> {
        let spacing_um = self.finest_um() * (1u64 << level) as f64;
        let face = match spacing_um < 0.6 {
            true => &self.near,
            false => &self.afar,
        };
        face.patch(level, x_um, y_um, margin)
    }

    fn extent_um(&self) -> Option<[f64; 4]> {
        self.afar.extent_um()
    }

    fn describe(&self) -> String {
        self.afar.describe()
    }
}

/// A few cells that are there twice, both in view.
pub(crate) fn there_twice(seed: u64) -> Option<(Bench, Target)> {
    let size_um = [460.0, 440.0];
    let twice = Twice::new(smear(seed), SAVED_UM, [-480.0, 60.0], size_um);
    let bench = bench_over(config(), Arc::new(twice), Vec::new());
    let (target, _) = save(&bench)?;
    bench.twin.centre_specimen([-240.0, 30.0], 3.0);
    Some((bench, target))
}

//! A target of a few cells, which the lowest objective cannot tell from what is around it: a higher one looks where it may be.

mod common;

use common::{Bench, bench, bench_over, options};
use scopeservo_scope::{Axis, ObjectiveId};
use scopeservo_servo::{
    Attempt, Bring, Calibrate, Calibration, FocusOptions, NoSink, Outcome, Procedure, Progress,
    Reason, Remark, Reposition, RepositionOptions, SaveOptions, SaveTarget, Target, Verdict,
    VisionOptions, run,
};
use scopeservo_twin::specimen::{Patch, Specimen, SpecimenError, Twice};
use scopeservo_twin::{Config, Sparse, SparseConfig, Truth};
use std::sync::{Arc, OnceLock};

/// The place that is saved.
const SAVED_UM: [f64; 2] = [0.0, 0.0];

fn config() -> Config {
    let mut config = Config::realistic();
    // Only where a few cells lie counts here.
    config.camera.dust.clear();
    config
}

/// Of all objectives, made on dense tissue.
fn calibrations() -> Vec<(ObjectiveId, Calibration)> {
    static KNOWN: OnceLock<Vec<(ObjectiveId, Calibration)>> = OnceLock::new();
    let make = || {
        let bench = bench(config());
        let all = bench.scope.gate().objectives().to_vec();
        let one = |objective: &scopeservo_scope::Objective| {
            bring(&bench, &objective.id);
            let vision = VisionOptions::default();
            let mut calibrate = Calibrate::new(objective.clone(), options().calibrate, vision);
            let calibration = run(&mut calibrate, &bench.scope, &mut NoSink).unwrap();
            (objective.id.clone(), calibration)
        };
        all.iter().map(one).collect()
    };
    KNOWN.get_or_init(make).clone()
}

fn bring(bench: &Bench, id: &ObjectiveId) {
    let focus = Some(FocusOptions::default());
    let mut bring = Bring::new(id.clone(), focus, VisionOptions::default());
    run(&mut bring, &bench.scope, &mut NoSink).unwrap();
}

fn smear(seed: u64) -> Arc<dyn Specimen> {
    smear_of(75.0, seed)
}

fn smear_of(per_mm2: f64, seed: u64) -> Arc<dyn Specimen> {
    let config = SparseConfig {
        seed,
        per_mm2,
        ..SparseConfig::default()
    };
    Arc::new(Sparse::new(config).unwrap())
}

/// Saves the place with 40x; `None` where too little lies there.
fn save(bench: &Bench) -> Option<(Target, Truth)> {
    bench.twin.centre_specimen(SAVED_UM, 0.0);
    bring(bench, &ObjectiveId("40x".into()));
    let mut save = SaveTarget::new(SaveOptions::default());
    let target = run(&mut save, &bench.scope, &mut NoSink).ok()?;
    Some((target, bench.twin.truth_now()))
}

fn back(target: Target) -> Reposition {
    let options = RepositionOptions::default();
    Reposition::new(target, options).with_calibrations(calibrations())
}

fn visited(outcome: &Outcome) -> Option<usize> {
    outcome.remarks.iter().find_map(|remark| match remark {
        Remark::Tried {
            attempt: Attempt::PlacesVisited { most, .. },
            ..
        } => Some(*most),
        _ => None,
    })
}

#[test]
fn a_few_cells_are_found_where_they_may_be_by_a_look_with_a_higher_objective() {
    let (mut found, mut saved) = (0, 0);
    for seed in 1..=10 {
        if found == 3 {
            break;
        }
        let bench = bench_over(config(), smear(seed), Vec::new());
        let Some((target, truth)) = save(&bench) else {
            continue;
        };
        saved += 1;
        bench.twin.remount(SAVED_UM, [260.0, -170.0], 4.0, false);
        let outcome = run(&mut back(target), &bench.scope, &mut NoSink).unwrap();
        if outcome.verdict == Verdict::Arrived {
            let (um, deg) = bench.error_from(&truth);
            assert!(um <= 1.5 && deg <= 0.05, "{seed}: {um} um, {deg} deg");
            if let Some(most) = visited(&outcome) {
                assert!((1..=6).contains(&most), "{most}");
                assert!(outcome.message.contains("looked where it may be"));
                found += 1;
            }
        }
    }
    assert_eq!(found, 3, "of {saved}");
}

/// A smear of which the place is not found without a look, the target and where it truly is.
fn hard() -> (Bench, Target, Truth) {
    for seed in 1..=10 {
        let bench = bench_over(config(), smear(seed), Vec::new());
        let Some((target, truth)) = save(&bench) else {
            continue;
        };
        bench.twin.remount(SAVED_UM, [260.0, -170.0], 4.0, false);
        let outcome = run(&mut back(target.clone()), &bench.scope, &mut NoSink).unwrap();
        if outcome.verdict == Verdict::Arrived && visited(&outcome).is_some() {
            let bench = bench_over(config(), smear(seed), Vec::new());
            save(&bench);
            bench.twin.remount(SAVED_UM, [260.0, -170.0], 4.0, false);
            return (bench, target, truth);
        }
    }
    panic!("no place of ten needs a look");
}

#[test]
fn a_look_goes_on_after_a_kill_between_any_two_steps() {
    let (bench, target, truth) = hard();
    let target = Arc::new(target);
    let mut machine = back((*target).clone());
    let outcome = loop {
        let stored = serde_json::to_string(&machine).unwrap();
        let restored: Reposition = serde_json::from_str(&stored).unwrap();
        machine = restored.with_target(target.clone());
        if let Progress::Done(outcome) = machine.step(&bench.scope, &mut NoSink).unwrap() {
            break outcome;
        }
    };
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    assert!(visited(&outcome).is_some());
    let (um, deg) = bench.error_from(&truth);
    assert!(um <= 1.5 && deg <= 0.05, "{um} um, {deg} deg");
}

/// Shows one specimen to the lowest objective and another to the highest: what looks like the target from afar is none.
struct TwoFaced {
    afar: Arc<dyn Specimen>,
    near: Arc<dyn Specimen>,
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

#[test]
fn what_is_not_there_when_looked_at_leaves_stage_and_objective_as_the_lowest_saw_it() {
    let mut looked = 0;
    // Something else lies there, and nothing to focus on.
    for (seed, per_mm2) in [(1, 75.0), (5, 75.0), (1, 0.5)] {
        let there = bench_over(config(), smear(seed), Vec::new());
        let Some((target, _)) = save(&there) else {
            continue;
        };
        let specimen = TwoFaced {
            afar: smear(seed),
            near: smear_of(per_mm2, 100 + seed),
        };
        let bench = bench_over(config(), Arc::new(specimen), Vec::new());
        bring(&bench, &ObjectiveId("10x".into()));
        bench.twin.remount(SAVED_UM, [260.0, -170.0], 4.0, false);
        let began = bench.scope.gate().position().unwrap();
        let outcome = run(&mut back(target), &bench.scope, &mut NoSink).unwrap();
        let said = (outcome.verdict, outcome.reason);
        let told = (Verdict::NotFound, Reason::TargetNotInView);
        assert_eq!(said, told, "{seed}: {}", outcome.message);
        if visited(&outcome).is_none() {
            continue;
        }
        looked += 1;
        assert!(
            outcome.message.contains("not found at 100x"),
            "{}",
            outcome.message
        );
        let ended = bench.scope.gate().position().unwrap();
        for axis in [Axis::X, Axis::Y] {
            let off_um = 1e6 * (ended.si(axis).unwrap() - began.si(axis).unwrap());
            assert!(off_um.abs() <= 5.0, "{seed}: {axis:?} is {off_um} um off");
        }
        let active = bench.scope.gate().current_objective().unwrap();
        assert_eq!(active, Some(ObjectiveId("10x".into())), "{seed}");
    }
    assert!(looked >= 2, "{looked}");
}

#[test]
fn a_few_cells_that_are_there_twice_are_not_taken_for_one() {
    let mut looked = 0;
    for seed in 1..=3 {
        let size_um = [460.0, 440.0];
        let twice = Twice::new(smear(seed), SAVED_UM, [-480.0, 60.0], size_um);
        let bench = bench_over(config(), Arc::new(twice), Vec::new());
        let Some((target, _)) = save(&bench) else {
            continue;
        };
        // Both are in view.
        bench.twin.centre_specimen([-240.0, 30.0], 3.0);
        let outcome = run(&mut back(target), &bench.scope, &mut NoSink).unwrap();
        let said = (outcome.verdict, outcome.reason);
        let told = (Verdict::Ambiguous, Reason::Ambiguous);
        assert_eq!(said, told, "{seed}: {}", outcome.message);
        looked += usize::from(visited(&outcome).is_some());
    }
    assert!(looked >= 2, "{looked}");
}

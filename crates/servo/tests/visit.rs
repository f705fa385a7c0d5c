//! A target of a few cells, which the lowest objective cannot tell from what is around it: a higher one looks where it may be.

mod common;

use common::{Bench, Listener, bench, bench_over, options};
use scopeservo_scope::{Axis, ObjectiveId};
use scopeservo_servo::{
    Attempt, Bring, Calibrate, Calibration, ErrorKind, Event, FocusOptions, FrameRole, NoSink,
    Outcome, Procedure, Progress, Reason, Remark, Reposition, RepositionOptions, SaveOptions,
    SaveTarget, Target, Verdict, VisionOptions, run,
};
use scopeservo_twin::specimen::{Patch, Specimen, SpecimenError, Twice};
use scopeservo_twin::{Config, Sparse, SparseConfig, StageFault, Truth};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

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

/// A smear of which the place is saved, and lies elsewhere now; the target and where it truly is.
fn put_back(seed: u64) -> Option<(Bench, Target, Truth)> {
    let bench = bench_over(config(), smear(seed), Vec::new());
    let (target, truth) = save(&bench)?;
    bench.twin.remount(SAVED_UM, [260.0, -170.0], 4.0, false);
    Some((bench, target, truth))
}

/// The same where the place is not found without a look.
fn hard() -> (Bench, Target, Truth) {
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

/// Counts the looks at places, once they have begun.
#[derive(Default)]
struct Looks {
    begun: bool,
    looks: usize,
}

impl Looks {
    /// The number of the look that this is the frame of, from 1.
    fn of(&mut self, event: &Event) -> Option<usize> {
        match event {
            Event::Remarked {
                remark:
                    Remark::Tried {
                        attempt: Attempt::PlacesVisited { .. },
                        ..
                    },
                ..
            } => self.begun = true,
            Event::FrameGrabbed {
                role: FrameRole::Servo,
                ..
            } if self.begun => {
                self.looks += 1;
                return Some(self.looks);
            }
            _ => {}
        }
        None
    }
}

/// Goes back while the camera freezes after so many looks; what was said.
fn frozen_after(looks: usize, bench: &Bench, target: Target) -> Outcome {
    let mut counted = Looks::default();
    let mut frozen = false;
    let mut freeze = Listener(|event: &Event| {
        let look = counted.of(event);
        if !frozen && counted.begun && look.unwrap_or(0) >= looks {
            bench.twin.fault(StageFault::FrozenCamera(true));
            frozen = true;
        }
    });
    let outcome = run(&mut back(target), &bench.scope, &mut freeze).unwrap();
    assert!(frozen, "{}", outcome.message);
    outcome
}

#[test]
fn a_camera_that_freezes_while_places_are_looked_at_is_told() {
    let told = |outcome: &Outcome, looks: usize| {
        let said = (outcome.verdict, outcome.reason);
        let frozen = (Verdict::Refused, Reason::NothingMoves);
        assert_eq!(said, frozen, "{looks}: {}", outcome.message);
        assert!(outcome.message.contains("frozen"), "{}", outcome.message);
    };
    for looks in [0, 2] {
        let (bench, target, _) = hard();
        told(&frozen_after(looks, &bench, target), looks);
    }
    // What is seen at the first place is what the second one shows as well, and nothing says that it is there twice.
    let (bench, target) = there_twice(1).unwrap();
    told(&frozen_after(1, &bench, target), 1);
}

#[test]
fn a_stop_while_places_are_looked_at_stands_still_and_what_was_stopped_goes_on() {
    let (bench, target, truth) = hard();
    let target = Arc::new(target);
    let mut machine = back((*target).clone());
    let mut looks = Looks::default();
    let mut stops = 0;
    let outcome = loop {
        let stored = serde_json::to_string(&machine).unwrap();
        let job = bench.scope.job_token();
        let obeying = bench.scope.obey(&job).unwrap();
        let mut stop = Listener(|event: &Event| {
            // In the middle of a step: its frame is there, and what follows is refused.
            if looks.of(event).is_some() && stops < 3 {
                job.cancel();
            }
        });
        match machine.step(&bench.scope, &mut stop) {
            Ok(Progress::Done(outcome)) => break outcome,
            Ok(Progress::Continue) => {}
            Err(error) => {
                assert_eq!(error.kind(), ErrorKind::Interruption, "{error}");
                stops += 1;
                drop(obeying);
                let stands = bench.scope.gate().position().unwrap();
                bench.scope.clock().sleep(Duration::from_secs(2));
                assert_eq!(bench.scope.gate().position().unwrap(), stands);
                let restored: Reposition = serde_json::from_str(&stored).unwrap();
                machine = restored.with_target(target.clone());
            }
        }
    };
    assert!(stops > 0);
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    let (um, deg) = bench.error_from(&truth);
    assert!(um <= 1.5 && deg <= 0.05, "{um} um, {deg} deg");
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

/// A few cells that are there twice, both in view.
fn there_twice(seed: u64) -> Option<(Bench, Target)> {
    let size_um = [460.0, 440.0];
    let twice = Twice::new(smear(seed), SAVED_UM, [-480.0, 60.0], size_um);
    let bench = bench_over(config(), Arc::new(twice), Vec::new());
    let (target, _) = save(&bench)?;
    bench.twin.centre_specimen([-240.0, 30.0], 3.0);
    Some((bench, target))
}

#[test]
fn a_few_cells_that_are_there_twice_are_not_taken_for_one() {
    let mut looked = 0;
    for seed in 1..=3 {
        let Some((bench, target)) = there_twice(seed) else {
            continue;
        };
        let outcome = run(&mut back(target), &bench.scope, &mut NoSink).unwrap();
        let said = (outcome.verdict, outcome.reason);
        let told = (Verdict::Ambiguous, Reason::Ambiguous);
        assert_eq!(said, told, "{seed}: {}", outcome.message);
        looked += usize::from(visited(&outcome).is_some());
    }
    assert!(looked >= 2, "{looked}");
}

//! Runs that go on after a kill in the middle of a step, and a run that must not go on for ever.

mod common;

use common::{Bench, PLACE_UM, bench_over, bench_seeded, one_objective, options};
use scopeservo_scope::{Frame, Instrument, ObjectiveId};
use scopeservo_servo::{
    Bring, Calibrate, Calibration, Event, FocusOptions, FrameRole, Law, NoSink, Outcome, Phase,
    Procedure, Progress, Remark, Reposition, RepositionOptions, ServoOptions, Sink, Stamped,
    Switching, SwitchingOptions, Target, Verdict, VisionOptions, run,
};
use scopeservo_twin::specimen::{Blank, Patch, Specimen, SpecimenError, Tissue};
use scopeservo_twin::{Config, StageConfig};
use std::sync::Arc;

/// The events of one step.
#[derive(Default)]
struct Ear(Vec<Event>);

impl Sink for Ear {
    fn event(&mut self, stamped: Stamped) {
        self.0.push(stamped.event);
    }
    fn frame(&mut self, _: &Frame, _: FrameRole) {}
}

/// Steps a run to its end. Where `killed` says so of a step's events, the program was killed at the end of that step: all that it did is done, and what is
/// stored is from before it.
fn goes_on(
    mut machine: Reposition,
    target: &Target,
    scope: &Instrument,
    mut killed: impl FnMut(&[Event]) -> bool,
) -> Outcome {
    for _ in 0..3000 {
        let stored = serde_json::to_string(&machine).unwrap();
        let mut ear = Ear::default();
        if let Progress::Done(outcome) = machine.step(scope, &mut ear).unwrap() {
            return outcome;
        }
        if killed(&ear.0) {
            let again: Reposition = serde_json::from_str(&stored).unwrap();
            machine = again.with_target(target.clone());
        }
    }
    panic!("it goes on and on");
}

fn calibrated(scope: &Instrument) -> Vec<(ObjectiveId, Calibration)> {
    let vision = VisionOptions::default();
    let all = scope.gate().objectives().to_vec();
    let of = |objective: scopeservo_scope::Objective| {
        let focus = Some(FocusOptions::default());
        let mut bring = Bring::new(objective.id.clone(), focus, vision.clone());
        run(&mut bring, scope, &mut NoSink).unwrap();
        let id = objective.id.clone();
        let mut calibrate = Calibrate::new(objective, options().calibrate, vision.clone());
        (id, run(&mut calibrate, scope, &mut NoSink).unwrap())
    };
    all.into_iter().map(of).collect()
}

fn bring(scope: &Instrument, id: &str) {
    let focus = Some(FocusOptions::default());
    let mut bring = Bring::new(ObjectiveId(id.into()), focus, VisionOptions::default());
    run(&mut bring, scope, &mut NoSink).unwrap();
}

fn slowly(lambda: f64) -> RepositionOptions {
    RepositionOptions {
        servo: ServoOptions {
            law: Law::Proportional,
            lambda,
            ..options().servo
        },
        ..options()
    }
}

fn turntable() -> Bench {
    let config = one_objective().with_stage(StageConfig::xyz_theta());
    bench_over(config, Arc::new(Tissue::new(7)), Vec::new())
}

/// What the step before had promised is not held against where the killed one went.
#[test]
fn what_a_killed_step_did_is_not_taken_for_somebodys_hand() {
    let bench = turntable();
    let (target, truth) = bench.save();
    let known = calibrated(&bench.scope);
    for kill_at in [1, 2, 3] {
        bench.twin.remount(PLACE_UM, [90.0, -70.0], 2.0, false);
        let machine = Reposition::new(target.clone(), slowly(0.3)).with_calibrations(known.clone());
        let mut iterations = 0;
        let outcome = goes_on(machine, &target, &bench.scope, |events| {
            let seen = |e: &&Event| matches!(e, Event::Iteration { .. });
            iterations += events.iter().filter(seen).count();
            iterations == kill_at + 1 && events.iter().any(|e| seen(&e))
        });
        assert!(iterations > kill_at + 2);
        assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
        let (um, deg) = bench.error_from(&truth);
        assert!(um < 1.0 && deg < 0.02, "{um} {deg}");
        let wrong = |r: &&Remark| matches!(r, Remark::Contradicted { .. } | Remark::Drifted { .. });
        let told = outcome.remarks.iter().find(wrong);
        assert_eq!(told, None, "{kill_at}: {}", outcome.message);
    }
}

/// What lay in the middle of one objective's view is brought into the middle of the next one's once, however often that is begun.
#[test]
fn a_kill_after_the_centre_was_kept_does_not_move_it_again() {
    let mut config = Config::realistic().with_stage(StageConfig::xyz_theta());
    config.optics.remove(1);
    config.nosepiece.parcentric_um = 80.0;
    let aside = |bench: &Bench| {
        let eta = ["10x", "40x"].map(|id| {
            let id = ObjectiveId(id.into());
            bench.twin.true_calibration(&id).unwrap().eta_mm
        });
        1e3 * f64::hypot(eta[1][0] - eta[0][0], eta[1][1] - eta[0][1])
    };
    let bench = (0..200)
        .map(|seed| bench_seeded(config.clone(), seed))
        .find(|bench| (70.0..100.0).contains(&aside(bench)))
        .unwrap();
    let known = calibrated(&bench.scope);
    let three = SwitchingOptions {
        times: 3,
        ..SwitchingOptions::default()
    };
    let pair = [known[0].1.clone(), known[1].1.clone()];
    let told = run(&mut Switching::new(pair, three), &bench.scope, &mut NoSink).unwrap();
    bring(&bench.scope, "40x");
    let target = Target::save(&bench.scope, &VisionOptions::default(), &mut NoSink).unwrap();
    bench.twin.remount(PLACE_UM, [30.0, -20.0], 1.0, false);
    let machine = Reposition::new(target.clone(), slowly(0.7))
        .with_calibrations(known)
        .with_switchings(vec![told]);
    let (mut kills, mut first_um) = (0, None);
    let outcome = goes_on(machine, &target, &bench.scope, |events| {
        let begins = events.iter().any(|e| {
            matches!(e, Event::PhaseStarted { phase: Phase::Servo, objective } if objective.0 == "40x")
        });
        for event in events {
            if let Event::Iteration {
                objective, error, ..
            } = event
                && objective.0 == "40x"
            {
                first_um.get_or_insert(error.distance_um());
            }
        }
        kills += usize::from(begins);
        begins && kills <= 2
    });
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    assert!(
        kills > 2 && first_um.unwrap() < 20.0,
        "{kills} {first_um:?}"
    );
}

/// Whoever opens the camera anew exposes it as it is described.
#[test]
fn a_run_goes_on_with_the_exposure_that_it_had_adapted_and_leaves_the_camera_as_it_was() {
    let bench = turntable();
    let (target, truth) = bench.save();
    let known = calibrated(&bench.scope);
    bench.twin.remount(PLACE_UM, [38.0, -45.0], 3.0, false);
    let camera = bench.scope.camera();
    let dark = camera.exposure().unwrap().mul_f64(0.002);
    camera.set_exposure(dark).unwrap();
    let mut machine = Reposition::new(target.clone(), options()).with_calibrations(known);
    let mut adapted = false;
    while !adapted {
        let mut ear = Ear::default();
        let step = machine.step(&bench.scope, &mut ear).unwrap();
        assert!(matches!(step, Progress::Continue), "not adapted");
        adapted = camera.exposure().unwrap() > dark;
    }
    let stored = serde_json::to_string(&machine).unwrap();
    // A stop between two steps leaves the camera as it was.
    machine.leave(&bench.scope);
    assert_eq!(camera.exposure().unwrap(), dark);
    let again: Reposition = serde_json::from_str(&stored).unwrap();
    let again = again.with_target(target.clone());
    let outcome = goes_on(again, &target, &bench.scope, |_| false);
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    let (um, deg) = bench.error_from(&truth);
    assert!(um < 1.2 && deg < 0.02, "{um} {deg}");
    assert_eq!(camera.exposure().unwrap(), dark);
}

/// The step that adapts the exposure is killed before it is written down, and the camera keeps what it was told.
#[test]
fn a_run_that_is_killed_while_it_exposes_otherwise_leaves_the_camera_as_it_was() {
    let bench = turntable();
    let (target, truth) = bench.save();
    let known = calibrated(&bench.scope);
    bench.twin.remount(PLACE_UM, [38.0, -45.0], 3.0, false);
    let camera = bench.scope.camera();
    let dark = camera.exposure().unwrap().mul_f64(0.002);
    camera.set_exposure(dark).unwrap();
    let mut machine = Reposition::new(target.clone(), options()).with_calibrations(known);
    let mut kept = String::new();
    while camera.exposure().unwrap() == dark {
        kept = serde_json::to_string(&machine).unwrap();
        let step = machine.step(&bench.scope, &mut Ear::default()).unwrap();
        assert!(matches!(step, Progress::Continue), "not adapted");
    }
    let again: Reposition = serde_json::from_str(&kept).unwrap();
    let mut again = again.with_target(target).after_a_kill();
    let outcome = run(&mut again, &bench.scope, &mut Ear::default()).unwrap();
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    let (um, deg) = bench.error_from(&truth);
    assert!(um < 1.2 && deg < 0.02, "{um} {deg}");
    assert_eq!(camera.exposure().unwrap(), dark);
}

/// Tissue, of which the finest detail is not there.
struct OnlyAfar {
    tissue: Tissue,
    blank: Blank,
}

impl Specimen for OnlyAfar {
    fn finest_um(&self) -> f64 {
        self.tissue.finest_um()
    }
    fn levels(&self) -> usize {
        self.tissue.levels()
    }
    fn patch(
        &self,
        level: usize,
        x_um: [f64; 2],
        y_um: [f64; 2],
        margin: usize,
    ) -> Result<Patch, SpecimenError> {
        match level {
            0 => self.blank.patch(level, x_um, y_um, margin),
            _ => self.tissue.patch(level, x_um, y_um, margin),
        }
    }
    fn extent_um(&self) -> Option<[f64; 4]> {
        self.tissue.extent_um()
    }
    fn describe(&self) -> String {
        self.tissue.describe()
    }
}

/// The lowest objective is asked once what moves do, each thing is tried once, and then that is the answer.
#[test]
fn an_objective_that_shows_nothing_where_lower_ones_see_the_target_ends_a_run() {
    let config = Config::realistic().with_stage(StageConfig::xyz_theta());
    let there = bench_over(config.clone(), Arc::new(Tissue::new(7)), Vec::new());
    let known = calibrated(&there.scope);
    bring(&there.scope, "40x");
    let target = Target::save(&there.scope, &VisionOptions::default(), &mut NoSink).unwrap();
    for (shift_um, turn_deg) in [([60.0, -40.0], 10.0), ([250.0, 150.0], -120.0)] {
        let specimen = OnlyAfar {
            tissue: Tissue::new(7),
            blank: Blank,
        };
        let bench = bench_over(config.clone(), Arc::new(specimen), Vec::new());
        bring(&bench.scope, "10x");
        bench.twin.remount(PLACE_UM, shift_um, turn_deg, false);
        let mut brought = 0;
        let machine = Reposition::new(target.clone(), options()).with_calibrations(known.clone());
        let outcome = goes_on(machine, &target, &bench.scope, |events| {
            let is = |e: &&Event| matches!(e, Event::PhaseStarted { phase: Phase::Focus, objective } if objective.0 == "40x");
            brought += events.iter().filter(is).count();
            false
        });
        assert_ne!(outcome.verdict, Verdict::Arrived, "{turn_deg}");
        assert!(
            (2..=4).contains(&brought),
            "{turn_deg}: {brought} {}",
            outcome.message
        );
    }
}

//! The same while the camera freezes, somebody presses stop, nothing is in focus, or a place is out of reach.

use crate::common::{Bench, Listener, bench_over};
use crate::smear::{
    SAVED_UM, TwoFaced, back, bring, config, hard, save, smear, smear_of, there_twice, visited,
};
use scopeservo_scope::{
    Axis, AxisRange, CancelToken, Devices, Instrument, KnownBy, Limits, Motion, Nosepiece,
    Objective, ObjectiveId, Rules, ScopeError,
};
use scopeservo_servo::{
    Attempt, ErrorKind, Event, FrameRole, NoSink, Outcome, Procedure, Progress, Reason, Remark,
    Reposition, Target, Verdict, run,
};
use scopeservo_twin::StageFault;
use std::sync::{Arc, Mutex};
use std::time::Duration;

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

/// A nosepiece that is turned by hand, which nobody but an image confirms; with what was asked for.
struct Hearsay(Box<dyn Nosepiece>, Arc<Mutex<Vec<String>>>);

impl Nosepiece for Hearsay {
    fn objectives(&self) -> &[Objective] {
        self.0.objectives()
    }
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        self.0.current()
    }
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        self.1.lock().unwrap().push(to.0.clone());
        self.0.start_change(to)
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        self.0.poll()
    }
    fn stop(&self) -> Result<(), ScopeError> {
        self.0.stop()
    }
    fn known_by(&self) -> KnownBy {
        KnownBy::Report
    }
}

#[test]
fn where_nothing_is_in_focus_at_any_place_a_run_ends_though_only_images_tell_the_objective() {
    let there = bench_over(config(), smear(1), Vec::new());
    let (target, _) = save(&there).unwrap();
    // Hardly anything, and nothing at all.
    for per_mm2 in [0.5, 0.001] {
        let specimen = TwoFaced {
            afar: smear(1),
            near: smear_of(per_mm2, 101),
        };
        let bench = bench_over(config(), Arc::new(specimen), Vec::new());
        let asked = Arc::<Mutex<Vec<String>>>::default();
        let devices = Devices {
            nosepiece: Some(Box::new(Hearsay(bench.twin.nosepiece(), asked.clone()))),
            ..bench.twin.devices()
        };
        let scope = Instrument::new(devices, bench.twin.rules(), CancelToken::new()).unwrap();
        bring(&scope, "10x");
        bench.twin.remount(SAVED_UM, [260.0, -170.0], 4.0, false);
        let began = scope.gate().position().unwrap();
        asked.lock().unwrap().clear();
        let mut machine = back(target.clone());
        let mut steps = 0;
        let outcome = loop {
            match machine.step(&scope, &mut NoSink).unwrap() {
                Progress::Done(outcome) => break outcome,
                Progress::Continue => steps += 1,
            }
            assert!(steps < 3000, "it goes on and on");
        };
        let said = (outcome.verdict, outcome.reason);
        let told = (Verdict::NotFound, Reason::TargetNotInView);
        assert_eq!(said, told, "{}", outcome.message);
        assert!(visited(&outcome).is_some(), "{}", outcome.message);
        // Nobody is asked to turn it back for nothing.
        assert_eq!(*asked.lock().unwrap(), ["40x"], "{per_mm2}");
        let ended = scope.gate().position().unwrap();
        for axis in [Axis::X, Axis::Y] {
            let off_um = 1e6 * (ended.si(axis).unwrap() - began.si(axis).unwrap());
            assert!(
                off_um.abs() <= 5.0,
                "{per_mm2}: {axis:?} is {off_um} um off"
            );
        }
    }
}

/// One of the two is where the stage cannot go: the other one may not be the one that was saved.
#[test]
fn what_is_seen_once_is_not_taken_for_the_only_one_where_another_is_out_of_reach() {
    let mut looked = 0;
    for (seed, side) in [(1, -1.0), (1, 1.0), (2, 1.0)] {
        let Some((bench, target)) = there_twice(seed) else {
            continue;
        };
        let at = bench.scope.gate().position().unwrap().si(Axis::X).unwrap();
        let far = 5e-3;
        let ends = [at - far, at + 60e-6, at - 60e-6, at + far];
        let ends = if side > 0.0 { &ends[..2] } else { &ends[2..] };
        let range = AxisRange {
            axis: Axis::X,
            min: ends[0],
            max: ends[1],
        };
        let rules = Rules {
            limits: Limits {
                ranges: vec![range],
            },
            ..bench.twin.rules()
        };
        let scope = Instrument::new(bench.twin.devices(), rules, CancelToken::new()).unwrap();
        let outcome = run(&mut back(target), &scope, &mut NoSink).unwrap();
        assert_ne!(outcome.verdict, Verdict::Arrived, "{seed} {side}");
        if visited(&outcome).is_some() {
            let said = (outcome.verdict, outcome.reason);
            let told = (Verdict::Ambiguous, Reason::Ambiguous);
            assert_eq!(said, told, "{seed} {side}: {}", outcome.message);
            looked += 1;
        }
    }
    assert!(looked >= 2, "{looked}");
}

//! A nosepiece that somebody turns, and turns wrongly: an image shows it, and nothing leans on the wrong objective.

mod common;

use common::{Listener, PLACE_UM, options};
use scopeservo_scope::{
    Axis, CancelToken, Clock, Devices, Instrument, KnownBy, Motion, Nosepiece, Objective,
    ObjectiveId, Remedy, ScopeError, VirtualClock,
};
use scopeservo_servo::{
    Bring, Event, FocusOptions, Identify, NoSink, Phase, Reason, Reposition, ServoError, Target,
    Verdict, VisionOptions, run,
};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, StageConfig, StageFault, Twin};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

/// Somebody who says that the objective asked for is in, whatever was turned to.
#[derive(Clone)]
struct Somebody {
    real: Arc<dyn Nosepiece>,
    state: Arc<Mutex<Told>>,
}

#[derive(Default)]
struct Told {
    /// What will be turned to instead.
    mistakes: VecDeque<&'static str>,
    told: Option<ObjectiveId>,
    asked: Vec<String>,
    /// Will not turn it.
    refuses: bool,
}

impl Nosepiece for Somebody {
    fn objectives(&self) -> &[Objective] {
        self.real.objectives()
    }
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        Ok(self.state.lock().unwrap().told.clone())
    }
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        let mut state = self.state.lock().unwrap();
        state.asked.push(to.0.clone());
        if state.refuses {
            state.told = None;
            return Ok(());
        }
        let turned = match state.mistakes.pop_front() {
            Some(wrong) => ObjectiveId(wrong.into()),
            None => to.clone(),
        };
        state.told = Some(to.clone());
        self.real.start_change(&turned)
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        match self.state.lock().unwrap().refuses {
            true => Ok(Motion::Stopped),
            false => self.real.poll(),
        }
    }
    fn stop(&self) -> Result<(), ScopeError> {
        self.real.stop()
    }
    fn known_by(&self) -> KnownBy {
        KnownBy::Report
    }
}

struct Desk {
    twin: Twin,
    scope: Instrument,
    somebody: Somebody,
}

impl Desk {
    fn asked(&self) -> Vec<String> {
        std::mem::take(&mut self.somebody.state.lock().unwrap().asked)
    }
    fn will_turn_to(&self, wrong: &[&'static str]) {
        self.somebody.state.lock().unwrap().mistakes = wrong.iter().copied().collect();
    }
    fn bring(&self, id: &str) -> Result<(), ServoError> {
        let id = ObjectiveId(id.into());
        let focus = Some(FocusOptions::default());
        let mut bring = Bring::new(id, focus, VisionOptions::default());
        run(&mut bring, &self.scope, &mut NoSink).map(drop)
    }
}

fn desk(config: Config) -> Desk {
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let twin = Twin::new(config, Arc::new(Tissue::new(7)), 5, clock).unwrap();
    let somebody = Somebody {
        real: twin.nosepiece().into(),
        state: Arc::default(),
    };
    let devices = Devices {
        nosepiece: Some(Box::new(somebody.clone())),
        ..twin.devices()
    };
    let scope = Instrument::new(devices, twin.rules(), CancelToken::new()).unwrap();
    twin.centre_specimen(PLACE_UM, 0.0);
    Desk {
        twin,
        scope,
        somebody,
    }
}

#[test]
fn a_small_move_shows_which_objective_is_in() {
    for (told, real) in [
        ("10x", "10x"),
        ("10x", "20x"),
        ("10x", "40x"),
        ("20x", "10x"),
        ("20x", "20x"),
        ("40x", "10x"),
        ("40x", "20x"),
        ("40x", "40x"),
    ] {
        let mut config = Config::realistic();
        config.mount.mirrored = true;
        let desk = desk(config);
        // In focus, and then somebody says another name.
        desk.bring(real).unwrap();
        let before = desk.twin.truth_now();
        let id = |name: &str| ObjectiveId(name.into());
        let mut identify = Identify::new(id(told), VisionOptions::default());
        let identity = run(&mut identify, &desk.scope, &mut NoSink).unwrap();
        assert_eq!(identity.looks_like, Some(id(real)), "{told} {real}");
        assert_eq!(identity.as_told, told == real, "{told} {real}");
        let nominal = desk.scope.objective(&id(real)).unwrap().nominal_um_per_px;
        assert!((identity.um_per_px / nominal - 1.0).abs() < 0.15);
        let after = desk.twin.truth_now();
        let off = [0, 1].map(|k| after.centre_um[k] - before.centre_um[k]);
        assert!(f64::hypot(off[0], off[1]) < 2.0, "{off:?}");
    }
}

#[test]
fn whoever_turned_wrongly_is_asked_again_and_not_for_ever() {
    let desk = desk(Config::realistic());
    desk.will_turn_to(&["40x"]);
    desk.bring("10x").unwrap();
    assert_eq!(desk.asked(), ["10x", "10x"]);
    // Shown once, it is not asked for again.
    desk.bring("10x").unwrap();
    assert!(desk.asked().is_empty());
    desk.will_turn_to(&["10x", "20x", "10x", "10x"]);
    let wrong = desk.bring("40x").unwrap_err();
    assert_eq!(desk.asked(), ["40x"; 3]);
    let ServoError::WrongObjective { looks_like, .. } = &wrong else {
        panic!("{wrong}");
    };
    assert_eq!(looks_like, &Some(ObjectiveId("10x".into())));
    let said = wrong.to_string();
    assert!(
        said.contains("40x was asked for") && said.contains("as 10x has"),
        "{said}"
    );
}

#[test]
fn a_run_with_mistakes_by_hand_comes_back_and_says_what_it_saw() {
    let mut config = Config::realistic().with_stage(StageConfig::xyz_theta());
    config.optics.remove(1);
    let desk = desk(config);
    desk.bring("40x").unwrap();
    let target = Target::save(&desk.scope, &VisionOptions::default(), &mut NoSink).unwrap();
    let truth = desk.twin.truth_now();
    desk.twin.remount(PLACE_UM, [38.0, -24.0], 1.5, false);
    desk.asked();
    // The first to come is 40x, and it is in; then 10x, where 40x stays in by mistake, then 10x.
    desk.will_turn_to(&["40x"]);
    let (mut looks, mut identities) = (0, Vec::new());
    let mut sink = Listener(|event: &Event| match event {
        Event::PhaseStarted {
            phase: Phase::Identify,
            ..
        } => looks += 1,
        Event::Identified { identity, .. } => identities.push(identity.as_told),
        _ => {}
    });
    let mut reposition = Reposition::new(target.clone(), options());
    let outcome = run(&mut reposition, &desk.scope, &mut sink).unwrap();
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    let now = desk.twin.truth_now();
    let off = [0, 1].map(|k| now.centre_um[k] - truth.centre_um[k]);
    assert!(f64::hypot(off[0], off[1]) < 1.0, "{off:?}");
    assert_eq!(desk.asked(), ["10x", "10x", "40x"]);
    assert_eq!((looks, identities), (3, vec![false, true, true]));
    // Somebody who never gets it right: an answer, not an error.
    desk.will_turn_to(&["40x"; 9]);
    let outcome = run(
        &mut Reposition::new(target, options()),
        &desk.scope,
        &mut NoSink,
    )
    .unwrap();
    assert_eq!(outcome.verdict, Verdict::Refused);
    // With another objective in, the sweep may also find nothing where the right one would be in focus.
    assert!(
        [Reason::WrongObjective, Reason::NoFocus].contains(&outcome.reason),
        "{}",
        outcome.message
    );
}

#[test]
fn a_picture_that_stays_is_no_proof() {
    let mut config = Config::realistic();
    config.optics.truncate(1);
    let desk = desk(config);
    desk.bring("10x").unwrap();
    // A stage that reports motion and makes none.
    for axis in [Axis::X, Axis::Y] {
        let stuck = true;
        desk.twin.fault(StageFault::StuckAxis { axis, stuck });
    }
    let id = ObjectiveId("10x".into());
    let mut identify = Identify::new(id, VisionOptions::default());
    let stays = run(&mut identify, &desk.scope, &mut NoSink);
    assert!(
        matches!(stays, Err(ServoError::PictureStays { .. })),
        "{stays:?}"
    );
}

#[test]
fn a_change_that_somebody_ends_says_where_the_stage_stays_and_how_to_go_on() {
    let desk = desk(Config::realistic());
    desk.bring("10x").unwrap();
    let z_um = |desk: &Desk| desk.scope.gate().position().unwrap().z.unwrap().um();
    let before = z_um(&desk);
    desk.somebody.state.lock().unwrap().refuses = true;
    let ended = desk.bring("40x").unwrap_err();
    let said = ended.to_string();
    assert!(said.contains("40x was not brought into the beam"), "{said}");
    let ServoError::Scope(ended) = ended else {
        panic!("{said}");
    };
    let Some(Remedy::FocusNear {
        objective,
        z_um: near,
    }) = ended.remedy()
    else {
        panic!("{said}");
    };
    assert_eq!(objective, ObjectiveId("40x".into()));
    assert!((near - before).abs() < 0.1, "{near} {before}");
    assert!(z_um(&desk) < -1000.0, "{}", z_um(&desk));
    // And on.
    desk.somebody.state.lock().unwrap().refuses = false;
    let id = ObjectiveId("40x".into());
    desk.scope.select_objective(&id).unwrap();
    let near = scopeservo_scope::StagePose::default().with_si(Axis::Z, before * 1e-6);
    desk.scope.move_to(&near).unwrap();
    desk.bring("40x").unwrap();
}

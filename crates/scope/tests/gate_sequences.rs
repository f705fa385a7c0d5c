//! The motion gate through sequences of commands, faults and stops, against devices that write down every rule that is broken.

mod recorder;

use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use recorder::{
    AXES, CLAMP, CLAMP_Z, Devices, Fault, LIMIT, NARROW, OBJECTIVES, RETRACTED, SLACK, TRAVEL,
    Ticking, id, pose, rules, z,
};
use scopeservo_scope::{
    Axis, CancelToken, ChangeRule, ErrorKind, GateEvent, Length, MotionGate, Nosepiece,
    ObjectiveId, ScopeError, Stage, StagePose, VirtualClock,
};
use std::sync::{Arc, Mutex, mpsc};
use std::time::Duration;

#[derive(Debug, Clone)]
enum Command {
    Move([Option<f64>; 3]),
    Change(&'static str),
    /// Somebody makes the specimen ready for an objective, and agrees.
    Agree(&'static str),
    Stop,
    Wait(u32),
    /// Waits until the stage says that it stands, and asks whether it arrived.
    Arrive,
    Fault(Fault),
}

fn place() -> impl Strategy<Value = Option<f64>> {
    // Where the rules have their edges, and what is no number.
    let edges = vec![
        LIMIT, -LIMIT, RETRACTED, NARROW, CLAMP[0], CLAMP[1], CLAMP_Z, 0.0, 5e-3,
    ];
    let odd = vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX];
    prop_oneof![
        2 => Just(None),
        6 => (-1.2 * TRAVEL..1.2 * TRAVEL).prop_map(Some),
        4 => prop::sample::select(edges).prop_map(Some),
        1 => prop::sample::select(odd).prop_map(Some),
    ]
}

fn command() -> impl Strategy<Value = Command> {
    let faults = vec![
        Fault::Poll,
        Fault::Position,
        Fault::Start,
        Fault::NosepiecePoll,
        Fault::NosepieceCurrent,
    ];
    let lasting = vec![
        Fault::Wall(0, [-1e-3, 1e-3]),
        Fault::Wall(2, [-1.0, -4e-3]),
        Fault::Lifts(3e-3),
        Fault::Lifts(-3e-3),
        Fault::Says(0, 1e-3),
        Fault::Says(2, -2e-3),
        Fault::Says(1, 1e300),
        Fault::Says(2, f64::NAN),
        Fault::Deaf(true),
        Fault::Mended,
        Fault::Mended,
        Fault::Mended,
    ];
    prop_oneof![
        8 => [place(), place(), place()].prop_map(Command::Move),
        2 => Just(Command::Move([None, None, Some(RETRACTED)])),
        5 => prop::sample::select(vec!["10x", "40x", "60x", "100x"]).prop_map(Command::Change),
        2 => prop::sample::select(vec!["10x", "40x", "60x", "100x"]).prop_map(Command::Agree),
        2 => Just(Command::Stop),
        6 => (1u32..9).prop_map(Command::Wait),
        4 => Just(Command::Arrive),
        2 => prop::sample::select(faults).prop_map(Command::Fault),
        2 => prop::sample::select(lasting).prop_map(Command::Fault),
    ]
}

/// What the gate says of an arrival, against what the stage says.
fn arrive(gate: &MotionGate, devices: &Devices) {
    while devices.world().way.is_some() {
        devices.world().tick();
    }
    let stops = devices.world().stops;
    let answer = gate.arrived();
    let mut world = devices.world();
    match answer {
        Ok(at) => {
            let said = world.said();
            assert_eq!(at, pose(said));
            if let Some(asked) = world.asked {
                let near = |k: usize| asked[k].is_none_or(|goal| (said[k] - goal).abs() < SLACK);
                let there = (0..3).all(near);
                if !there && !world.stopped {
                    world
                        .broken
                        .push(format!("sent to {asked:?}, arrived at {said:?}"));
                }
            }
        }
        Err(error) => {
            assert_eq!(error.kind(), ErrorKind::Fault, "{error}");
            assert!(world.stops > stops, "{error}: it was not told to stop");
        }
    }
}

/// Carries out a command. What is refused must not have begun anything.
fn obey(gate: &MotionGate, devices: &Devices, command: &Command) {
    let before = devices.world().begun;
    let answer = match command {
        Command::Move(to) => {
            let to = (0..3).fold(StagePose::default(), |pose, k| match to[k] {
                Some(v) => pose.with_si(AXES[k], v),
                None => pose,
            });
            gate.start_move(&to)
        }
        Command::Change(to) => gate.start_change(&id(to)),
        Command::Agree(to) => {
            if let Ok(Some(change)) = gate.immersion_change(&id(to)) {
                devices.world().medium = change.to;
                gate.agree_to_immersion(&change);
            }
            return;
        }
        Command::Stop => {
            gate.stop().unwrap();
            let world = devices.world();
            assert!(world.way.is_none() || world.deaf);
            assert!(world.turning.is_none());
            return;
        }
        Command::Arrive => return arrive(gate, devices),
        Command::Wait(ticks) => return (0..*ticks).for_each(|_| devices.world().tick()),
        Command::Fault(fault) => {
            let mut world = devices.world();
            if !fault.lasts(&mut world) {
                world.fault = Some(*fault);
            }
            return;
        }
    };
    if answer.is_err() {
        assert_eq!(devices.world().begun, before, "{answer:?}");
    }
}

#[test]
fn no_sequence_of_commands_and_faults_breaks_a_rule() {
    let cases = std::env::var("SCOPESERVO_GATE_CASES");
    let cases = cases.ok().and_then(|n| n.parse().ok()).unwrap_or(100_000);
    // Others with `SCOPESERVO_GATE_SEED`.
    let seed = std::env::var("SCOPESERVO_GATE_SEED");
    let seed: u64 = seed.ok().and_then(|n| n.parse().ok()).unwrap_or(1);
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    let config = Config {
        cases,
        failure_persistence: None,
        ..Config::default()
    };
    let rng = TestRng::from_seed(RngAlgorithm::ChaCha, &bytes);
    let mut runner = TestRunner::new_with_rng(config, rng);
    let sequences = prop::collection::vec(command(), 1..40);
    let answer = runner.run(&sequences, |commands| {
        let devices = Devices::new();
        let gate = devices.gate(rules());
        for command in &commands {
            obey(&gate, &devices, command);
            let world = devices.world();
            prop_assert!(world.broken.is_empty(), "{:?}", world.broken);
        }
        Ok(())
    });
    answer.unwrap();
}

#[test]
fn the_recorder_would_notice() {
    // The same devices without the gate: each rule can be broken, and is written down.
    let devices = Devices::new();
    let stage: &dyn Stage = &devices;
    let settle = || (0..8).for_each(|_| devices.world().tick());
    stage.start_move(&pose([9e-3, 0.0, 0.0])).unwrap();
    Nosepiece::start_change(&devices, &id("40x")).unwrap();
    settle();
    stage.start_move(&pose([5e-3, 5e-3, 0.0])).unwrap();
    settle();
    stage.start_move(&pose([0.0, 0.0, 5e-3])).unwrap();
    settle();
    Nosepiece::start_change(&devices, &id("60x")).unwrap();
    let broken = devices.world().broken.join("; ");
    for rule in [
        "x at",
        "in the clamp",
        "moves while it turns",
        "turns at",
        "a step",
        "own limits",
        "comes into air",
    ] {
        assert!(broken.contains(rule), "{rule}: {broken}");
    }
    // And what begins where a fault has taken the stage, by what it says.
    for (fault, rule) in [
        (Fault::Says(0, 1e300), "where no stage is"),
        (Fault::Says(0, f64::NAN), "where no stage is"),
        (Fault::Says(2, 13.1e-3), "which is outside"),
    ] {
        let devices = Devices::new();
        assert!(fault.lasts(&mut devices.world()));
        let sideways = StagePose::default().with_si(Axis::Y, 1e-3);
        Stage::start_move(&devices, &sideways).unwrap();
        Nosepiece::start_change(&devices, &id("40x")).unwrap();
        let broken = devices.world().broken.join("; ");
        assert!(broken.contains(rule), "{rule}: {broken}");
    }
    let turns = Devices::new();
    assert!(Fault::Says(2, 1e-3).lasts(&mut turns.world()));
    Nosepiece::start_change(&turns, &id("40x")).unwrap();
    let broken = turns.world().broken.join("; ");
    assert!(broken.contains("as it says"), "{broken}");
}

#[test]
fn threads_that_ask_and_stop_at_once_neither_break_rules_nor_hang() {
    let devices = Devices::new();
    let gate = Arc::new(devices.gate(rules()));
    let (done, ended) = mpsc::channel();
    for thread in 0..6u64 {
        let (gate, devices, done) = (gate.clone(), devices.clone(), done.clone());
        std::thread::spawn(move || {
            let mut state = thread + 1;
            for _ in 0..20_000 {
                // Xorshift.
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                let at = |k: u64| ((state >> (8 * k)) % 200) as f64 * 1e-4 - 1e-2;
                match state % 5 {
                    0 => drop(gate.start_move(&pose([at(0), at(1), at(2)]))),
                    1 => drop(gate.start_move(&z(RETRACTED))),
                    2 => drop(gate.start_change(&id(OBJECTIVES[(state >> 9) as usize % 2]))),
                    3 => gate.stop().unwrap(),
                    _ => devices.world().tick(),
                }
            }
            done.send(()).unwrap();
        });
    }
    for _ in 0..6 {
        ended
            .recv_timeout(Duration::from_secs(120))
            .expect("no thread hangs");
    }
    let world = devices.world();
    assert!(world.broken.is_empty(), "{:?}", world.broken);
    assert!(world.begun > 100, "{}", world.begun);
}

#[test]
fn nothing_begins_after_a_cancel() {
    let devices = Devices::new();
    let cancel = CancelToken::new();
    let clock = Arc::new(VirtualClock::new());
    let scope = devices.instrument(rules(), clock, cancel.clone());
    let gate = scope.gate();
    gate.start_move(&z(-6e-3)).unwrap();
    (0..8).for_each(|_| devices.world().tick());
    let begun = devices.world().begun;
    cancel.cancel();
    for answer in [gate.start_move(&z(-7e-3)), gate.start_change(&id("40x"))] {
        assert!(
            matches!(answer, Err(ScopeError::Interrupted { .. })),
            "{answer:?}"
        );
    }
    assert_eq!(devices.world().begun, begun);
}

#[test]
fn a_piece_of_work_that_was_stopped_leaves_the_instrument_to_the_next() {
    let devices = Devices::new();
    let cancel = CancelToken::new();
    let clock = Arc::new(Ticking {
        clock: VirtualClock::new(),
        devices: devices.clone(),
    });
    let scope = devices.instrument(rules(), clock, cancel.clone());
    let told = Arc::new(std::sync::Mutex::new(Vec::new()));
    let ear = told.clone();
    scope
        .gate()
        .observe(Some(Arc::new(move |e| ear.lock().unwrap().push(e))));
    let interrupted = |to: f64| {
        let answer = scope.move_to(&z(to));
        assert!(
            matches!(answer, Err(ScopeError::Interrupted { at: Some(_) })),
            "{answer:?}"
        );
    };
    let first = scope.job_token();
    let work = scope.obey(&first).unwrap();
    scope.move_to(&z(-6e-3)).unwrap();
    assert!(matches!(
        scope.obey(&scope.job_token()).err(),
        Some(ScopeError::Busy { .. })
    ));
    first.cancel();
    interrupted(-5e-3);
    drop(work);
    let second = scope.job_token();
    let work = scope.obey(&second).unwrap();
    scope.move_to(&z(-5e-3)).unwrap();
    cancel.cancel();
    assert!(second.is_cancelled());
    interrupted(-4e-3);
    drop(work);
    interrupted(-4e-3);
    // Every command was told, and nothing began after a stop.
    let told = told.lock().unwrap();
    let moves: Vec<&GateEvent> = told
        .iter()
        .filter(|e| !matches!(e, GateEvent::Stopped { .. }))
        .collect();
    let begun = |e: &GateEvent| matches!(e, GateEvent::MoveBegan { .. });
    // Asked, begun, arrived.
    assert!(
        moves.len() == 6 && begun(moves[1]) && begun(moves[4]),
        "{moves:?}"
    );
    assert!(matches!(moves[5], GateEvent::Arrived { at } if at.si(Axis::Z) == Some(-5e-3)));
}

#[test]
fn after_a_change_it_comes_back_in_allowed_steps_and_short_of_an_unknown_focus() {
    let devices = Devices::new();
    let mut rules = rules();
    rules.change = ChangeRule::Retracted {
        z: -7e-3,
        margin: 1e-3,
    };
    let clock = Arc::new(Ticking {
        clock: VirtualClock::new(),
        devices: devices.clone(),
    });
    let scope = devices.instrument(rules, clock, CancelToken::new());
    scope.move_to(&z(1e-3)).unwrap();
    let height = || scope.gate().position().unwrap().si(Axis::Z).unwrap();
    // 8 mm back where 6 are allowed at a time, and a millimetre short: 40x was never in focus.
    let told: Arc<Mutex<Vec<GateEvent>>> = Arc::default();
    let ear = told.clone();
    scope
        .gate()
        .observe(Some(Arc::new(move |e| ear.lock().unwrap().push(e))));
    scope.select_objective(&id("40x")).unwrap();
    assert!(height().abs() < 1e-9, "{}", height());
    // All of it is told: away, the change, and back.
    let told = std::mem::take(&mut *told.lock().unwrap());
    let change = |e: &GateEvent| matches!(e, GateEvent::ChangeBegan { to } if *to == id("40x"));
    let at = told.iter().position(change).unwrap();
    assert_eq!(told[at + 1], GateEvent::Changed { to: id("40x") });
    let arrived = |e: &&GateEvent| matches!(e, GateEvent::Arrived { .. });
    let moves = [&told[..at], &told[at..]].map(|part| part.iter().filter(arrived).count());
    assert!(moves[0] >= 1 && moves[1] >= 1, "{told:?}");
    // Where both were in focus the difference counts.
    scope.focus_found(&id("10x"), Length::from_um(200.0));
    scope.focus_found(&id("40x"), Length::from_um(-300.0));
    scope.move_to(&z(-0.4e-3)).unwrap();
    scope.select_objective(&id("10x")).unwrap();
    assert!((height() - 0.1e-3).abs() < 1e-9, "{}", height());
    // Nearer to the specimen than focus, which costs the one nothing, the other one does not come.
    scope.move_to(&z(0.9e-3)).unwrap();
    scope.select_objective(&id("40x")).unwrap();
    assert!((height() + 0.3e-3).abs() < 1e-9, "{}", height());
    assert!(
        devices.world().broken.is_empty(),
        "{:?}",
        devices.world().broken
    );
}

/// 10x is focused on a slide that is 200 um thicker, 40x was focused on the one before.
#[test]
fn a_thicker_slide_that_one_objective_was_focused_on_lifts_the_others() {
    let devices = Devices::new();
    let clock = Arc::new(VirtualClock::new());
    let scope = devices.instrument(rules(), clock, CancelToken::new());
    let side = scope.gate().info().positive_z;
    let found = |name: &str, um: f64| scope.focus_found(&id(name), Length::from_um(um));
    let at = |name: &str| scope.focus_positions()[&id(name)].m();
    let up = |um: f64| side.away(0.0, um * 1e-6) * 1e6;
    found("10x", 0.0);
    found("40x", up(5.0));
    found("10x", up(200.0));
    assert!((at("40x") - up(205.0) * 1e-6).abs() < 1e-12);
    // Nearer again: nobody knows where 40x is now, and it stays as far.
    found("10x", up(-50.0));
    assert!((at("40x") - up(205.0) * 1e-6).abs() < 1e-12);
    // What scatters lifts nothing, however often.
    found("40x", up(-45.0));
    (0..100).for_each(|k| found("10x", up(if k % 2 == 0 { -45.0 } else { -50.0 })));
    assert!((at("40x") - up(-45.0) * 1e-6).abs() < 1e-12);
}

#[test]
fn what_an_earlier_session_knew_of_heights_counts_from_the_objective_that_was_focused_last() {
    let devices = Devices::new();
    let clock = Arc::new(VirtualClock::new());
    let scope = devices.instrument(rules(), clock, CancelToken::new());
    let (ten, forty, sixty) = (id("10x"), id("40x"), id("60x"));
    scope.parfocal_known([&ten, &forty], Length::from_um(30.0));
    scope.parfocal_known([&ten, &sixty], Length::from_um(-50.0));
    let predicted = |id: &ObjectiveId| scope.predicted_focus(id).map(|z| z.um().round());
    // Nothing was focused: a difference says no height.
    assert_eq!(predicted(&forty), None);
    scope.focus_found(&ten, Length::from_um(400.0));
    assert_eq!(
        (predicted(&forty), predicted(&sixty)),
        (Some(430.0), Some(350.0))
    );
    // Another specimen: what is focused last counts, whatever was known before.
    scope.focus_found(&forty, Length::from_um(1000.0));
    assert_eq!(
        (predicted(&ten), predicted(&sixty)),
        (Some(970.0), Some(920.0))
    );
    assert_eq!(predicted(&id("100x")), None);
    scope.forget_focus(&forty);
    assert_eq!(predicted(&ten), None);
}

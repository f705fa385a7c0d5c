//! The motion gate against devices that write down every rule that is broken, whatever is asked and whatever fails.

use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use scopeservo_scope::{
    Axis, AxisInfo, AxisRange, CancelToken, ChangeRule, Clock, ErrorKind, GateEvent, Instrument,
    Kinematics, KnownBy, LargestStep, Length, Limits, Motion, MotionGate, Nosepiece, Objective,
    ObjectiveId, PositiveZ, Rules, ScopeError, Stage, StageInfo, StagePose, Timestamp,
    VirtualClock, Workspace, Zone,
};
use std::collections::BTreeMap;
use std::sync::mpsc;
use std::sync::{Arc, Mutex};
use std::time::Duration;

const AXES: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];
const TRAVEL: f64 = 1e-2;
const LIMIT: f64 = 8e-3;
/// Of the strongest objective, along z.
const NARROW: f64 = 2e-3;
/// Of the strongest objective, along x.
const NARROW_X: f64 = 3e-3;
const RETRACTED: f64 = -5e-3;
const STEP: f64 = 6e-3;
const CLAMP: [f64; 2] = [4e-3, 6e-3];
const CLAMP_Z: f64 = -3e-3;
/// By this much a place that is reported may miss.
const SLACK: f64 = 1.1e-6;
const OBJECTIVES: [&str; 2] = ["10x", "40x"];

/// A move: from where, to where, and how far on the way each axis is. They go at speeds of their own.
struct Way {
    from: [f64; 3],
    to: [f64; 3],
    done: [f64; 3],
}

/// What really happens. It knows nothing of the gate.
struct World {
    at: [f64; 3],
    way: Option<Way>,
    stopped: bool,
    objective: Option<usize>,
    turning: Option<(usize, u32)>,
    /// The height at which the last turn began.
    turned_at: Option<f64>,
    fault: Option<Fault>,
    /// An obstacle beyond which an axis does not go.
    wall: Option<(usize, [f64; 2])>,
    /// What moves along x or y lifts z by this.
    lifts: f64,
    /// What it says of an axis is off by this.
    says: Option<(usize, f64)>,
    /// It takes stops, and goes on.
    deaf: bool,
    /// The devices have broken rules by themselves: from now on only what is begun is judged.
    excused: bool,
    broken: Vec<String>,
    /// The goals of the last move.
    asked: Option<[Option<f64>; 3]>,
    begun: u32,
    stops: u32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    Poll,
    Position,
    Start,
    NosepiecePoll,
    NosepieceCurrent,
    /// From now on.
    Wall(usize, [f64; 2]),
    Lifts(f64),
    Says(usize, f64),
    Deaf(bool),
    /// Nothing is wrong any more, where it stands.
    Mended,
}

impl Fault {
    /// What breaks for longer than one call.
    fn lasts(self, world: &mut World) -> bool {
        match self {
            Fault::Wall(axis, between) => world.wall = Some((axis, between)),
            Fault::Lifts(by) => (world.lifts, world.excused) = (by, true),
            Fault::Says(axis, by) => (world.says, world.excused) = (Some((axis, by)), true),
            Fault::Deaf(deaf) => world.deaf = deaf,
            Fault::Mended => {
                (world.wall, world.lifts, world.says, world.deaf) = (None, 0.0, None, false)
            }
            _ => return false,
        }
        true
    }
}

impl World {
    fn new() -> Self {
        Self {
            at: [0.0, 0.0, RETRACTED],
            way: None,
            stopped: false,
            objective: Some(0),
            turning: None,
            turned_at: None,
            fault: None,
            wall: None,
            lifts: 0.0,
            says: None,
            deaf: false,
            excused: false,
            broken: Vec::new(),
            asked: None,
            begun: 0,
            stops: 0,
        }
    }

    /// Where the stage says it is.
    fn said(&self) -> [f64; 3] {
        let mut said = self.at;
        if let Some((axis, by)) = self.says {
            said[axis] += by;
        }
        said
    }

    /// Judges what begins, by what the devices say: a move to a goal, or a turn.
    fn judge(&mut self, goal: Option<[f64; 3]>) {
        let from = self.said();
        let tops = match self.objective {
            Some(0) => [LIMIT; 3],
            _ => [NARROW_X, LIMIT, NARROW],
        };
        let outside = |at: [f64; 3], slack: f64| -> Vec<usize> {
            let out = |k: &usize| !(at[*k] <= tops[*k] + slack && at[*k] >= -LIMIT - slack);
            (0..3).filter(out).collect()
        };
        let in_clamp = |at: [f64; 3]| {
            let over = |v: f64| (CLAMP[0]..=CLAMP[1]).contains(&v);
            over(at[0]) && over(at[1]) && at[2] > CLAMP_Z + SLACK
        };
        let possible = from.iter().all(|v| v.abs() <= TRAVEL + SLACK);
        if !possible {
            self.broken
                .push(format!("something begins at {from:?}, where no stage is"));
        }
        let out = outside(from, SLACK);
        let Some(goal) = goal else {
            if !out.is_empty() || in_clamp(from) || from[2] > RETRACTED + SLACK {
                self.broken
                    .push(format!("it turns at {from:?}, as it says"));
            }
            return;
        };
        let moved: Vec<usize> = (0..3).filter(|&k| goal[k] != from[k]).collect();
        let nearer = |k: &usize| out.contains(k) && goal[*k].abs() < from[*k].abs();
        let retreat = moved == [2] && goal[2] < from[2];
        let beyond = outside(goal, 0.0);
        if beyond.iter().any(|k| moved.contains(k) && !nearer(k)) {
            self.broken
                .push(format!("from {from:?} to {goal:?}, which is outside"));
        }
        let too_near = from[2] > tops[2] + SLACK || in_clamp(from);
        let back = outside(goal, SLACK).is_empty() || moved.iter().all(nearer);
        if !retreat && (too_near || !out.is_empty() && !back) {
            self.broken
                .push(format!("from {from:?}, which is outside, to {goal:?}"));
        }
    }

    fn look(&mut self) {
        if self.turning.is_some() && self.way.is_some() {
            self.broken.push("moves while it turns".into());
        }
        if self.excused {
            return;
        }
        let [x, y, z] = self.at;
        for (axis, v) in AXES.iter().zip(self.at) {
            if v.abs() > LIMIT + 1e-12 {
                self.broken.push(format!("{axis} at {v}"));
            }
        }
        let in_clamp = |v: f64| (CLAMP[0]..=CLAMP[1]).contains(&v);
        if in_clamp(x) && in_clamp(y) && z > CLAMP_Z + 1e-12 {
            self.broken.push(format!("in the clamp at {:?}", self.at));
        }
        if self.objective == Some(1) && (z > NARROW + 1e-12 || x > NARROW_X + 1e-12) {
            self.broken
                .push(format!("40x outside its own limits at {:?}", self.at));
        }
        if self.turning.is_some() && z > RETRACTED + SLACK {
            self.broken.push(format!("turns at z = {z}"));
        }
    }

    fn tick(&mut self) {
        if let Some(way) = &mut self.way {
            for (k, speed) in [0.3, 0.5, 0.2].into_iter().enumerate() {
                way.done[k] += speed;
                self.at[k] = match way.done[k] < 1.0 {
                    true => way.from[k] + (way.to[k] - way.from[k]) * way.done[k],
                    false => way.to[k],
                };
            }
            if way.done.iter().all(|&done| done >= 1.0) {
                self.way = None;
            }
        }
        if let Some((to, left)) = self.turning {
            self.turning = (left > 1).then_some((to, left - 1));
            if left <= 1 {
                self.objective = Some(to);
            }
        }
        self.look();
    }

    fn fails(&mut self, fault: Fault) -> Result<(), ScopeError> {
        if self.fault == Some(fault) {
            self.fault = None;
            return Err(ScopeError::Device {
                device: "stage",
                detail: format!("{fault:?}"),
            });
        }
        Ok(())
    }
}

#[derive(Clone)]
struct Devices {
    world: Arc<Mutex<World>>,
    info: StageInfo,
    objectives: Vec<Objective>,
}

impl Devices {
    fn new() -> Self {
        let axis = |&axis: &Axis| AxisInfo {
            axis,
            min: -TRAVEL,
            max: TRAVEL,
            repeatability: 0.0,
            arrival_tolerance: None,
        };
        let objective = |id: &&str| Objective {
            id: ObjectiveId((*id).into()),
            magnification: 100.0,
            numerical_aperture: 0.25,
            nominal_um_per_px: 1.0,
        };
        Self {
            world: Arc::new(Mutex::new(World::new())),
            info: StageInfo {
                name: "recorder".into(),
                axes: AXES.iter().map(axis).collect(),
                kinematics: Kinematics::SpecimenXyOnTop,
                positive_z: PositiveZ::Closer,
            },
            objectives: OBJECTIVES.iter().map(objective).collect(),
        }
    }

    fn gate(&self, rules: Rules) -> MotionGate {
        MotionGate::new(Box::new(self.clone()), Box::new(self.clone()), rules).unwrap()
    }

    fn instrument(&self, rules: Rules, clock: Arc<dyn Clock>, cancel: CancelToken) -> Instrument {
        let devices = scopeservo_scope::Devices {
            stage: Some(Box::new(self.clone())),
            nosepiece: Some(Box::new(self.clone())),
            ..scopeservo_scope::Devices::none(clock)
        };
        Instrument::new(devices, rules, cancel).unwrap()
    }

    fn world(&self) -> std::sync::MutexGuard<'_, World> {
        self.world.lock().unwrap()
    }
}

impl Stage for Devices {
    fn info(&self) -> &StageInfo {
        &self.info
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        let mut world = self.world();
        world.fails(Fault::Position)?;
        Ok(pose(world.said()))
    }
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        let mut world = self.world();
        world.fails(Fault::Start)?;
        if world.way.is_some() {
            world.broken.push("a move on top of a move".into());
        }
        let said = world.said();
        let asked = [0, 1, 2].map(|k| to.si(AXES[k]).unwrap_or(said[k]));
        world.judge(Some(asked));
        let retreat = asked[0] == said[0] && asked[1] == said[1] && asked[2] <= said[2];
        for k in 0..3 {
            if (asked[k] - said[k]).abs() > STEP && !(retreat && k == 2) {
                world
                    .broken
                    .push(format!("a step from {said:?} to {asked:?}"));
            }
        }
        let from = world.at;
        let mut goal = [0, 1, 2].map(|k| from[k] + (asked[k] - said[k]));
        if let Some((axis, [low, high])) = world.wall {
            goal[axis] = goal[axis].clamp(low.min(from[axis]), high.max(from[axis]));
        }
        if goal[0] != from[0] || goal[1] != from[1] {
            goal[2] += world.lifts;
        }
        world.way = Some(Way {
            from,
            to: goal,
            done: [0.0; 3],
        });
        world.asked = Some(AXES.map(|axis| to.si(axis)));
        world.stopped = false;
        world.begun += 1;
        world.look();
        Ok(())
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        let mut world = self.world();
        world.fails(Fault::Poll)?;
        Ok(match (&world.way, world.stopped) {
            (Some(_), _) => Motion::Moving,
            (None, true) => Motion::Stopped,
            (None, false) => Motion::Settled,
        })
    }
    fn stop(&self) -> Result<(), ScopeError> {
        let mut world = self.world();
        world.stops += 1;
        if world.deaf {
            return Ok(());
        }
        world.stopped |= world.way.take().is_some();
        Ok(())
    }
}

impl Nosepiece for Devices {
    fn objectives(&self) -> &[Objective] {
        &self.objectives
    }
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        let mut world = self.world();
        world.fails(Fault::NosepieceCurrent)?;
        Ok(world.objective.map(|k| self.objectives[k].id.clone()))
    }
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        let mut world = self.world();
        let Some(index) = OBJECTIVES.iter().position(|id| *id == to.0) else {
            world.broken.push("an unknown objective".into());
            return Ok(());
        };
        if world.turning.is_some() {
            world.broken.push("a change on top of a change".into());
        }
        world.judge(None);
        world.turned_at = Some(world.at[2]);
        world.objective = None;
        world.turning = Some((index, 3));
        world.begun += 1;
        world.look();
        Ok(())
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        let mut world = self.world();
        world.fails(Fault::NosepiecePoll)?;
        Ok(match (world.turning, world.objective) {
            (Some(_), _) => Motion::Moving,
            (None, Some(_)) => Motion::Settled,
            (None, None) => Motion::Stopped,
        })
    }
    fn stop(&self) -> Result<(), ScopeError> {
        self.world().turning = None;
        Ok(())
    }
}

fn pose(at: [f64; 3]) -> StagePose {
    (0..3).fold(StagePose::default(), |pose, k| pose.with_si(AXES[k], at[k]))
}

fn z(at: f64) -> StagePose {
    StagePose::default().with_si(Axis::Z, at)
}

fn id(name: &str) -> ObjectiveId {
    ObjectiveId(name.into())
}

fn rules() -> Rules {
    let range = |axis, min, max| AxisRange { axis, min, max };
    Rules {
        limits: Limits {
            ranges: AXES.map(|axis| range(axis, -LIMIT, LIMIT)).into(),
        },
        objective_limits: BTreeMap::from([(
            id("40x"),
            Limits {
                ranges: vec![
                    range(Axis::Z, -LIMIT, NARROW),
                    range(Axis::X, -LIMIT, NARROW_X),
                ],
            },
        )]),
        largest_steps: AXES.map(|axis| LargestStep { axis, step: STEP }).into(),
        workspace: Workspace::Box,
        zones: vec![Zone {
            name: "the clamp".into(),
            x: CLAMP,
            y: CLAMP,
            closest_z: CLAMP_Z,
            objectives: Vec::new(),
        }],
        change: ChangeRule::Retracted {
            z: RETRACTED,
            margin: 0.0,
        },
    }
}

#[derive(Debug, Clone)]
enum Command {
    Move([Option<f64>; 3]),
    Change(&'static str),
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
        4 => prop::sample::select(vec!["10x", "40x", "100x"]).prop_map(Command::Change),
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
    let mut runner = TestRunner::new(Config {
        cases,
        failure_persistence: None,
        ..Config::default()
    });
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
    let broken = devices.world().broken.join("; ");
    for rule in [
        "x at",
        "in the clamp",
        "moves while it turns",
        "turns at",
        "a step",
        "own limits",
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
fn each_refusal_says_which_rule_and_what_to_do() {
    let devices = Devices::new();
    let gate = devices.gate(rules());
    let settle = || (0..8).for_each(|_| devices.world().tick());
    let go = |at: [f64; 3]| {
        gate.start_move(&pose(at)).unwrap();
        settle();
    };
    let said = |to: [f64; 3]| gate.start_move(&pose(to)).unwrap_err();
    let far = said([9e-3, 0.0, 0.0]);
    assert!(
        matches!(far, ScopeError::OutsideLimits { axis: Axis::X, .. }),
        "{far}"
    );
    let long = said([7e-3, 0.0, -5e-3]);
    assert!(
        matches!(long, ScopeError::StepTooLarge { axis: Axis::X, .. }),
        "{long}"
    );
    assert_eq!(
        said([f64::NAN, 0.0, 0.0]).to_string(),
        ScopeError::NotFinite { axis: Axis::X }.to_string()
    );
    let turn = StagePose::default().with_si(Axis::Rz, 0.0);
    let missing = gate.start_move(&turn);
    assert_eq!(missing, Err(ScopeError::NoSuchAxis { axis: Axis::Rz }));

    go([0.0, 5e-3, -4e-3]);
    let close = said([5e-3, 5e-3, -2e-3]);
    assert!(
        matches!(&close, ScopeError::TooClose { zone, .. } if zone == "the clamp"),
        "{close}"
    );
    // Across the clamp and down behind it: the axes do not go in step, so the way counts.
    go([3e-3, 5e-3, -4e-3]);
    let across = said([7e-3, 5e-3, 0.0]);
    assert!(matches!(across, ScopeError::TooClose { .. }), "{across}");
    go([7e-3, 5e-3, -4e-3]);

    let low = gate.start_change(&id("40x")).unwrap_err();
    assert!(low.to_string().contains("Retract first"), "{low}");
    go([7e-3, 5e-3, RETRACTED]);
    // The objective that comes may not be where this one may.
    let there = gate.start_change(&id("40x")).unwrap_err();
    assert!(
        matches!(there, ScopeError::OutsideLimits { axis: Axis::X, .. }),
        "{there}"
    );
    go([2e-3, 5e-3, RETRACTED]);
    let unknown = gate.start_change(&id("100x")).unwrap_err();
    assert!(unknown.to_string().contains("10x, 40x"), "{unknown}");
    gate.start_change(&id("40x")).unwrap();
    let device = "nosepiece";
    assert_eq!(said([2e-3, 5e-3, RETRACTED]), ScopeError::Busy { device });
    settle();
    go([2e-3, 5e-3, 0.5e-3]);
    let narrow = said([2e-3, 5e-3, 3e-3]);
    assert!(
        matches!(narrow, ScopeError::OutsideLimits { axis: Axis::Z, .. }),
        "{narrow}"
    );
    // A retreat may be longer than a step, and nothing else.
    gate.start_move(&z(-LIMIT)).unwrap();
    let device = "stage";
    assert_eq!(said([2e-3, 5e-3, 0.0]), ScopeError::Busy { device });
    assert!(
        devices.world().broken.is_empty(),
        "{:?}",
        devices.world().broken
    );
}

#[test]
fn what_fails_to_begin_is_stopped_and_what_is_refused_is_left_alone() {
    let devices = Devices::new();
    let gate = devices.gate(rules());
    gate.start_move(&pose([9e-3, 0.0, 0.0])).unwrap_err();
    assert_eq!(devices.world().stops, 0);
    devices.world().fault = Some(Fault::Start);
    let fault = gate.start_move(&z(-6e-3)).unwrap_err();
    assert!(matches!(fault, ScopeError::Device { .. }), "{fault}");
    assert_eq!(devices.world().stops, 1);
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
    scope.select_objective(&id("10x")).unwrap();
    assert!((height() - 0.5e-3).abs() < 1e-9, "{}", height());
    assert!(
        devices.world().broken.is_empty(),
        "{:?}",
        devices.world().broken
    );
}

#[test]
fn a_cheap_focus_drive_retreats_farther_and_never_turns_short_of_the_height() {
    const RULE: f64 = -100e-6;
    let rules = |z: f64| Rules {
        change: ChangeRule::Retracted { z, margin: 0.0 },
        ..Rules::travel_only(ChangeRule::Anywhere)
    };
    let mut devices = Devices::new();
    devices.info.axes[2].repeatability = 25e-6;
    devices.world().at[2] = 0.0;
    let clock = Arc::new(Ticking {
        clock: VirtualClock::new(),
        devices: devices.clone(),
    });
    let scope = devices.instrument(rules(RULE), clock, CancelToken::new());
    // Its scatter is wider than what is to be retracted: that is no reason to turn here.
    let refused = scope.gate().start_change(&id("40x"));
    assert!(
        matches!(refused, Err(ScopeError::NotRetracted { .. })),
        "{refused:?}"
    );
    devices.world().excused = true;
    scope.select_objective(&id("40x")).unwrap();
    let turned = devices.world().turned_at;
    assert!((turned.unwrap() + 200e-6).abs() < 1e-9, "{turned:?}");
    // A micrometre short counts, and no more, whatever z scatters.
    for (at, turns) in [(RULE + 1.1e-6, false), (RULE + 0.9e-6, true)] {
        devices.world().at[2] = at;
        let answer = scope.gate().start_change(&id("10x"));
        assert_eq!(answer.is_ok(), turns, "{at}: {answer:?}");
    }
    // No room beyond the height for that.
    let room = MotionGate::new(
        Box::new(devices.clone()),
        Box::new(devices.clone()),
        rules(-TRAVEL + 50e-6),
    );
    let said = room.err().unwrap().to_string();
    assert!(said.contains("100.0 um beyond"), "{said}");
    devices.info.axes[2].repeatability = 600e-6;
    let said = MotionGate::new(Box::new(devices.clone()), Box::new(devices), rules(RULE));
    let said = said.err().unwrap().to_string();
    assert!(said.contains("repeatability of z is 600 um"), "{said}");
}

/// A clock that lets the world go on while somebody sleeps.
struct Ticking {
    clock: VirtualClock,
    devices: Devices,
}

impl Clock for Ticking {
    fn now(&self) -> Timestamp {
        self.clock.now()
    }
    fn sleep(&self, duration: Duration) {
        self.clock.sleep(duration);
        self.devices.world().tick();
    }
}

#[test]
fn an_ellipsoid_gives_each_axis_what_the_others_leave() {
    let devices = Devices::new();
    let gate = devices.gate(Rules {
        workspace: Workspace::Ellipsoid,
        ..Rules::travel_only(ChangeRule::Anywhere)
    });
    // z is at 5 mm of 10: a quarter is used.
    let x = |at| StagePose::default().with_si(Axis::X, at);
    gate.check(&x(8.6e-3)).unwrap();
    let most = gate.check(&x(8.7e-3));
    assert!(
        matches!(most, Err(ScopeError::OutsideWorkspace { share }) if share > 1.0 && share < 1.01),
        "{most:?}"
    );
    gate.check(&pose([9.9e-3, 0.0, 0.0])).unwrap();
}

/// The same devices where somebody says which objective is in.
struct Hearsay(Devices);

impl Nosepiece for Hearsay {
    fn objectives(&self) -> &[Objective] {
        self.0.objectives()
    }
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        self.0.current()
    }
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        self.0.start_change(to)
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        Nosepiece::poll(&self.0)
    }
    fn stop(&self) -> Result<(), ScopeError> {
        Nosepiece::stop(&self.0)
    }
    fn known_by(&self) -> KnownBy {
        KnownBy::Report
    }
}

#[test]
fn until_a_picture_shows_the_objective_the_rules_of_all_hold() {
    let devices = Devices::new();
    let hearsay = Hearsay(devices.clone());
    let gate = MotionGate::new(Box::new(devices.clone()), Box::new(hearsay), rules()).unwrap();
    assert_eq!(gate.current_objective(), Ok(Some(id("10x"))));
    // Beyond what 40x may, within what 10x may.
    let beyond = StagePose::default().with_si(Axis::X, NARROW_X + 1e-4);
    assert!(matches!(
        gate.check(&beyond),
        Err(ScopeError::OutsideLimits { .. })
    ));
    gate.confirm_objective();
    assert_eq!(gate.check(&beyond), Ok(()));
    // Shown to be another one, it is unknown until somebody was asked again, also for the same.
    assert!(gate.contradict_objective());
    assert_eq!(gate.current_objective(), Ok(None));
    assert!(gate.check(&beyond).is_err());
    gate.start_change(&id("10x")).unwrap();
    (0..3).for_each(|_| devices.world().tick());
    assert_eq!(gate.poll_nosepiece(), Ok(Motion::Settled));
    assert_eq!(gate.current_objective(), Ok(Some(id("10x"))));
    assert!(gate.objective_is_reported());
}

#[test]
fn rules_that_make_no_sense_are_refused() {
    type Breakage = fn(&mut Rules);
    let nonsense: [(&str, Breakage); 7] = [
        ("no room", |r| r.limits.ranges[0].min = 9e-3),
        ("finite", |r| r.limits.ranges[0].max = f64::NAN),
        ("no objective here", |r| {
            r.objective_limits.insert(id("63x"), Limits::default());
        }),
        ("largest step", |r| r.largest_steps[0].step = 0.0),
        ("zone 'the clamp'", |r| r.zones[0].x = [1.0, 0.0]),
        ("leave out the height", |r| {
            let limits = r.objective_limits.get_mut(&id("40x")).unwrap();
            limits.ranges[0].min = -4e-3;
        }),
        ("outside the limits of z", |r| {
            r.objective_limits.clear();
            r.change = ChangeRule::Retracted {
                z: -9e-3,
                margin: 0.0,
            };
        }),
    ];
    for (word, f) in nonsense {
        let devices = Devices::new();
        let mut rules = rules();
        f(&mut rules);
        let answer = MotionGate::new(Box::new(devices.clone()), Box::new(devices), rules);
        let said = answer.err().expect(word).to_string();
        assert!(said.contains(word), "{word}: {said}");
    }
}

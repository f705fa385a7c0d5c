//! Our own drivers as the rest of the program uses them: the conformance suite, and the motion gate with random commands and
//! faults, against the emulators.

mod common;

use common::{Random, pose, tcp};
use scopeservo_drivers::emulator::gcode::{Board, EmulatedBoard, GcodeEmulator};
use scopeservo_drivers::emulator::gcs2::{Controller, EmulatedStage, Gcs2Emulator, Obeys};
use scopeservo_drivers::emulator::sangaboard::{EmulatedSanga, Sanga, SangaEmulator};
use scopeservo_drivers::emulator::{Fault, Server};
use scopeservo_drivers::gcode::{GcodeAxis, GcodeSettings, GcodeStage};
use scopeservo_drivers::gcs2::{Gcs2Settings, Gcs2Stage};
use scopeservo_drivers::sangaboard::{SangaAxis, SangaSettings, SangaStage};
use scopeservo_scope::{
    Axis, AxisRange, CancelToken, ChangeRule, Devices, ErrorKind, Immersion, Instrument,
    Kinematics, Limits, Motion, MotionGate, Nosepiece, Objective, ObjectiveId, PositiveZ, Rules,
    ScopeError, Stage, StagePose, SystemClock, conformance,
};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// A nosepiece that takes a millisecond and tells when it turns.
#[derive(Clone)]
struct Turret {
    objectives: Vec<Objective>,
    state: Arc<Mutex<Turn>>,
}

/// The active objective, and the one on its way with the time of its arrival.
type Turn = (Option<usize>, Option<(usize, Instant)>);

impl Turret {
    fn new() -> Self {
        let objective = |id: &str| Objective {
            id: ObjectiveId(id.into()),
            magnification: 100.0,
            numerical_aperture: 0.25,
            nominal_um_per_px: 1.0,
            immersion: Immersion::Air,
        };
        Self {
            objectives: ["10x", "40x"].map(objective).into(),
            state: Arc::new(Mutex::new((Some(0), None))),
        }
    }

    fn now(&self) -> (Option<usize>, bool) {
        let mut state = self.state.lock().unwrap();
        if let Some((to, end)) = state.1
            && Instant::now() >= end
        {
            *state = (Some(to), None);
        }
        (state.0, state.1.is_some())
    }
}

impl Nosepiece for Turret {
    fn objectives(&self) -> &[Objective] {
        &self.objectives
    }
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        Ok(self.now().0.map(|k| self.objectives[k].id.clone()))
    }
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        let index = self.objectives.iter().position(|o| o.id == *to).unwrap();
        let end = Instant::now() + Duration::from_millis(1);
        *self.state.lock().unwrap() = (None, Some((index, end)));
        Ok(())
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        Ok(match self.now() {
            (_, true) => Motion::Moving,
            (Some(_), _) => Motion::Settled,
            (None, false) => Motion::Stopped,
        })
    }
    fn stop(&self) -> Result<(), ScopeError> {
        self.state.lock().unwrap().1 = None;
        Ok(())
    }
}

/// The suite for a stage, and its plug pulled and put back.
fn conforms<D: Send>(emulator: &Server<D>, connect: impl Fn() -> Box<dyn Stage>) {
    let open = |nosepiece: Option<Box<dyn Nosepiece>>| {
        let rules = Rules::travel_only(ChangeRule::Anywhere);
        let devices = Devices {
            stage: Some(connect()),
            nosepiece,
            ..Devices::none(Arc::new(SystemClock::new()))
        };
        Arc::new(Instrument::new(devices, rules, CancelToken::new()).unwrap())
    };
    // The emulated turret hangs on no plug.
    let alone = || open(None);
    let mut checks = conformance::check_stage(&open(Some(Box::new(Turret::new()))));
    let (replug, _) = conformance::check_replug(
        alone(),
        || emulator.set_fault(Fault::Disconnect),
        || {
            emulator.set_fault(Fault::None);
            Ok(alone())
        },
    );
    checks.extend(replug);
    for check in checks {
        assert_eq!(check.outcome, Ok(()), "{}", check.name);
    }
}

fn gcs2() -> Gcs2Settings {
    Gcs2Settings::hexapod(Kinematics::MovesMicroscope, PositiveZ::Closer, 0.1, 0.0001)
}

#[test]
fn gcs2_passes_the_conformance_suite() {
    let emulator = Gcs2Emulator::serve(EmulatedStage::hexapod()).unwrap();
    conforms(&emulator, || {
        Box::new(Gcs2Stage::connect(tcp(&emulator.address()), &gcs2()).unwrap())
    });
}

#[test]
fn gcode_passes_the_conformance_suite() {
    let emulator = GcodeEmulator::serve(EmulatedBoard::new()).unwrap();
    let axis = |axis, letter| GcodeAxis {
        axis,
        letter,
        min_um: 0.0,
        max_um: 20_000.0,
        steps_per_mm: 400.0,
        repeatability_um: 2.5,
        arrival_tolerance_um: None,
    };
    let mut settings: GcodeSettings = serde_json::from_value(serde_json::json!({
        "kinematics": "specimen_xy_on_top",
        "positive_z": "closer",
        "boot_ms": 0,
        "axes": [],
        "speed_um_per_s": 10_000.0,
        "needs_homing": false,
    }))
    .unwrap();
    settings.axes = vec![axis(Axis::X, 'X'), axis(Axis::Y, 'Y')];
    conforms(&emulator, || {
        Box::new(GcodeStage::connect(tcp(&emulator.address()), &settings).unwrap())
    });
}

#[test]
fn the_sangaboard_passes_the_conformance_suite() {
    let emulator = SangaEmulator::serve(EmulatedSanga::new()).unwrap();
    let motor = serde_json::json!({
        "um_per_step": 0.1, "min_um": -5000.0, "max_um": 5000.0, "repeatability_um": 0.5
    });
    let settings: SangaSettings = serde_json::from_value(serde_json::json!({
        "kinematics": "specimen_xy_on_top",
        "positive_z": "closer",
        "boot_ms": 0,
        "x": motor, "y": motor, "z": motor,
    }))
    .unwrap();
    conforms(&emulator, || {
        Box::new(SangaStage::connect(tcp(&emulator.address()), &settings).unwrap())
    });
}

// Random commands and faults: a thousand sequences for each emulator, or as many as one asks for:
//
//     SCOPESERVO_EMULATOR_SEQUENCES=100000 cargo test --release -p scopeservo-drivers --test gate break_no_rule -- --nocapture
//
// The same seed gives the same commands; where they find the device depends on how fast the machine is.

const AXES: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];
const LIMIT_MM: f64 = 2.0;
const RETRACTED_MM: f64 = -1.0;
/// Where a retreat goes: beyond that by more than z scatters.
const RETREAT_MM: f64 = -1.001;
/// The gate's own slack of 1 um and half a step of a stepper.
const SLACK_MM: f64 = 1.1e-3;
/// Fast enough that much happens: no move takes longer than some hundredths of a second.
const MM_PER_S: f64 = 200.0;
const STEPS_PER_MM: f64 = 10_000.0;
const STEP_UM: f64 = 1e3 / STEPS_PER_MM;
const COMMANDS: u64 = 10;
/// So many sequences on one emulator; then the next, with the next seed.
const SEQUENCES_PER_SEED: u64 = 25;
/// They mostly wait.
const THREADS: usize = 8;
/// A command that takes longer hangs.
const PATIENCE: Duration = Duration::from_secs(5);

/// What really happens.
struct Truth {
    mm: [f64; 3],
    moves: bool,
}

/// An emulated device as these tests use it.
trait Emulated: Send + Sized + 'static {
    /// How many faults of its own it has.
    const FAULTS: usize;
    fn serve() -> std::io::Result<Server<Self>>;
    fn connect(emulator: &Server<Self>) -> Result<Box<dyn Stage>, ScopeError>;
    fn truth(emulator: &Server<Self>) -> Truth;
    /// From now on moves of x take z along by so much, which the device says.
    fn take_along(emulator: &Server<Self>, mm: f64);
    /// Lets something go wrong with the device. Says whether the driver may have to give the connection up for it.
    fn fail(emulator: &Server<Self>, fault: usize) -> bool;
}

impl Emulated for Controller {
    const FAULTS: usize = 10;
    fn take_along(emulator: &Gcs2Emulator, mm: f64) {
        emulator.take_along(mm);
    }
    fn serve() -> std::io::Result<Gcs2Emulator> {
        let mut stage = EmulatedStage::hexapod();
        stage.velocity = MM_PER_S;
        Gcs2Emulator::serve(stage)
    }
    fn connect(emulator: &Gcs2Emulator) -> Result<Box<dyn Stage>, ScopeError> {
        let mut settings = gcs2();
        // Shorter than a move, so that a stop passed over is repeated.
        settings.stop_timeout_ms = 10;
        settings.settle_timeout_ms = 10;
        let stage = Gcs2Stage::connect(tcp(&emulator.address()), &settings)?;
        Ok(Box::new(stage))
    }
    fn truth(emulator: &Gcs2Emulator) -> Truth {
        let at = emulator.truth();
        Truth {
            mm: [at[0], at[1], at[2]],
            moves: emulator.moves(),
        }
    }
    fn fail(emulator: &Gcs2Emulator, fault: usize) -> bool {
        match fault {
            0 => emulator.set_error(1024),
            1 => emulator.stop_by_hand(),
            2..5 => emulator.set_never_on_target(fault == 2),
            5 => emulator.set_obeys(Obeys::OnlyLines),
            8 => emulator.block_first_axis([-0.5, 0.5]),
            9 => emulator.block_first_axis([f64::NEG_INFINITY, f64::INFINITY]),
            _ => emulator.set_obeys(Obeys::All),
        }
        false
    }
}

impl Emulated for Board {
    const FAULTS: usize = 9;
    fn take_along(emulator: &GcodeEmulator, mm: f64) {
        emulator.take_along(mm);
    }
    fn serve() -> std::io::Result<GcodeEmulator> {
        let mut board = EmulatedBoard::new();
        board.steps_per_mm = [STEPS_PER_MM; 3];
        GcodeEmulator::serve(board)
    }
    fn connect(emulator: &GcodeEmulator) -> Result<Box<dyn Stage>, ScopeError> {
        let axis = |(axis, letter)| GcodeAxis {
            axis,
            letter,
            min_um: -20_000.0,
            max_um: 20_000.0,
            steps_per_mm: STEPS_PER_MM,
            repeatability_um: STEP_UM,
            arrival_tolerance_um: None,
        };
        let settings = GcodeSettings {
            kinematics: Some(Kinematics::SpecimenXyOnTop),
            positive_z: Some(PositiveZ::Closer),
            nosepiece: None,
            axes: AXES.into_iter().zip(['X', 'Y', 'Z']).map(axis).collect(),
            speed_um_per_s: 1e3 * MM_PER_S,
            needs_homing: false,
            allow_queued_stop: false,
            checksums: true,
            boot_ms: 0,
            reply_timeout_ms: 1000,
            busy_timeout_ms: 5000,
            homing_timeout_ms: 5000,
            stop_timeout_ms: 1000,
            stall_timeout_ms: 10,
        };
        let connect = || GcodeStage::connect(tcp(&emulator.address()), &settings);
        // What it still had to say to the driver before, and lines still damaged, may end the first connections.
        let stage = connect().or_else(|_| connect()).or_else(|_| connect())?;
        Ok(Box::new(stage))
    }
    fn truth(emulator: &GcodeEmulator) -> Truth {
        Truth {
            mm: emulator.truth(),
            moves: emulator.moves(),
        }
    }
    fn fail(emulator: &GcodeEmulator, fault: usize) -> bool {
        match fault {
            0 => emulator.say(" T:21.00 /0.00 @:0"),
            1 => emulator.say("echo:busy: processing"),
            2 => emulator.say("start"),
            3 => emulator.say("Error:Printer halted. kill() called!"),
            // A line is sent four times.
            4 => emulator.damage_lines(4),
            5 => emulator.damage_lines(2),
            _ => emulator.block(),
        }
        (2..=4).contains(&fault)
    }
}

impl Emulated for Sanga {
    const FAULTS: usize = 1;
    fn take_along(emulator: &SangaEmulator, mm: f64) {
        emulator.take_along((mm * STEPS_PER_MM) as i32);
    }
    fn serve() -> std::io::Result<SangaEmulator> {
        let mut board = EmulatedSanga::new();
        board.step_us = 1e6 / (STEPS_PER_MM * MM_PER_S);
        SangaEmulator::serve(board)
    }
    fn connect(emulator: &SangaEmulator) -> Result<Box<dyn Stage>, ScopeError> {
        let motor = |um_per_step| {
            Some(SangaAxis {
                um_per_step,
                min_um: -5000.0,
                max_um: 5000.0,
                repeatability_um: STEP_UM,
                arrival_tolerance_um: None,
            })
        };
        let settings = SangaSettings {
            kinematics: Kinematics::SpecimenXyOnTop,
            positive_z: PositiveZ::Closer,
            x: motor(STEP_UM),
            y: motor(-STEP_UM),
            z: motor(STEP_UM),
            boot_ms: 0,
            reply_timeout_ms: 1000,
            stop_timeout_ms: 1000,
        };
        let stage = SangaStage::connect(tcp(&emulator.address()), &settings)?;
        Ok(Box::new(stage))
    }
    fn truth(emulator: &SangaEmulator) -> Truth {
        Truth {
            mm: emulator
                .truth()
                .map(|steps| f64::from(steps) / STEPS_PER_MM),
            moves: emulator.moves(),
        }
    }
    fn fail(emulator: &SangaEmulator, _: usize) -> bool {
        emulator.block();
        false
    }
}

/// mm, up to a third beyond the limits.
fn place(random: &mut Random) -> f64 {
    (random.below(10_001) as f64 / 5000.0 - 1.0) * 1.3 * LIMIT_MM
}

/// What the gate may be asked.
#[derive(Debug, Clone, Copy)]
enum Wish {
    /// mm.
    Move([Option<f64>; 3]),
    Retract,
    Change(&'static str),
    Stop,
    /// Has the stage arrived, if it says that it has settled?
    Arrive,
}

impl Wish {
    fn any(random: &mut Random) -> Self {
        match random.below(13) {
            0..5 => Self::Move([(); 3].map(|()| (random.below(3) > 0).then(|| place(random)))),
            5..7 => Self::Retract,
            7..11 => Self::Change(random.of(&["10x", "40x"])),
            11 => Self::Stop,
            _ => Self::Arrive,
        }
    }

    fn ask(self, gate: &MotionGate) -> Result<(), ScopeError> {
        match self {
            Self::Move(mm) => {
                let set = AXES.into_iter().zip(mm);
                let to = set.fold(StagePose::default(), |to, (axis, mm)| match mm {
                    Some(mm) => to.with_si(axis, mm * 1e-3),
                    None => to,
                });
                gate.start_move(&to)
            }
            Self::Retract => gate.start_move(&pose(Axis::Z, RETREAT_MM * 1e-3)),
            Self::Arrive => match gate.poll()? {
                Motion::Settled => gate.arrived().map(drop),
                _ => Ok(()),
            },
            Self::Change(id) => gate.start_change(&ObjectiveId(id.into())),
            Self::Stop => gate.stop(),
        }
    }
}

#[derive(Debug, Clone, Copy)]
enum Command {
    Ask(Wish),
    /// From two threads.
    AtOnce(Wish, Wish),
    Wait(Duration),
    /// One of the device's own faults.
    Fail(usize),
    /// A fault of the link, after so many answers.
    Lose(u32, Fault),
    /// Moves of x take z along by so much, or no more.
    TakeAlong(f64),
    /// The driver ends, wherever the stage is, and another begins.
    Restart,
}

impl Command {
    fn any(random: &mut Random, faults: usize) -> Self {
        match random.below(33) {
            32 => Self::TakeAlong(random.of(&[0.0, 0.0, 0.7, -0.7])),
            0..17 => Self::Ask(Wish::any(random)),
            17..20 => Self::AtOnce(Wish::any(random), Wish::any(random)),
            20..28 => Self::Wait(Duration::from_micros(random.below(10_000) as u64)),
            28..30 => Self::Fail(random.below(faults)),
            30 => {
                let quick = [Fault::Disconnect, Fault::Garbage, Fault::EndlessLine];
                // These are noticed only when an answer is overdue.
                let slow = [Fault::Silence, Fault::Half, Fault::EndlessLines];
                let fault = match random.below(50) {
                    0 => random.of(&slow),
                    _ => random.of(&quick),
                };
                Self::Lose(random.below(12) as u32, fault)
            }
            _ => Self::Restart,
        }
    }
}

#[derive(Debug, Default)]
struct Tally {
    sequences: u64,
    moves: u64,
    turns: u64,
    faults: u64,
    lost: u64,
    lost_moving: u64,
    found_moving: u64,
    outside: u64,
    longest: Duration,
}

impl Tally {
    fn add(&mut self, other: &Self) {
        self.sequences += other.sequences;
        self.moves += other.moves;
        self.turns += other.turns;
        self.faults += other.faults;
        self.lost += other.lost;
        self.lost_moving += other.lost_moving;
        self.found_moving += other.found_moving;
        self.outside += other.outside;
        self.longest = self.longest.max(other.longest);
    }
}

fn gated<D: Emulated>(emulator: &Server<D>, turret: &Turret) -> MotionGate {
    let range = |axis| AxisRange {
        axis,
        min: -LIMIT_MM * 1e-3,
        max: LIMIT_MM * 1e-3,
    };
    let rules = Rules {
        limits: Limits {
            ranges: AXES.map(range).into(),
        },
        ..Rules::travel_only(ChangeRule::Retracted {
            z: RETRACTED_MM * 1e-3,
            margin: 0.0,
        })
    };
    emulator.set_fault(Fault::None);
    let driver = D::connect(emulator).unwrap();
    MotionGate::new(driver, Box::new(turret.clone()), rules).unwrap()
}

/// The command under way, and since when.
struct Watch(Mutex<(Instant, String)>);

impl Watch {
    fn begins(&self, what: String) {
        *self.0.lock().unwrap() = (Instant::now(), what);
    }
    fn check(&self) {
        let (since, what) = &*self.0.lock().unwrap();
        let took = since.elapsed();
        assert!(took < PATIENCE, "{what} has not ended after {took:?}");
    }
}

/// Whether a move may begin where z stands outside, and only z: straight away from the specimen, or back.
fn may_begin(from_mm: &[f64; 3], goal_mm: &[Option<f64>; 3]) -> bool {
    let moved = |k: usize| goal_mm[k].is_some_and(|mm| mm != from_mm[k]);
    let goes_back = goal_mm[2].is_some_and(|mm| mm.abs() < from_mm[2].abs());
    let too_near = from_mm[2] > 0.0;
    goes_back && !(too_near && (moved(0) || moved(1)))
}

/// Sequences of commands on one emulator.
fn drive<D: Emulated>(seed: u64, sequences: u64, watch: &Watch) -> Tally {
    let mut random = Random(seed);
    let turret = Turret::new();
    let emulator = D::serve().unwrap();
    let mut gate = gated(&emulator, &turret);
    let mut tally = Tally::default();
    let (mut may_lose, mut excused) = (false, false);
    for nth in 0..sequences * COMMANDS {
        let command = Command::any(&mut random, D::FAULTS);
        let what = format!("seed {seed}, command {nth}, {command:?}");
        watch.begins(what.clone());
        let before = D::truth(&emulator);
        let start = Instant::now();
        let answers = match command {
            Command::Ask(wish) => vec![(wish, wish.ask(&gate))],
            Command::AtOnce(a, b) => thread::scope(|s| {
                let other = s.spawn(|| b.ask(&gate));
                vec![(a, a.ask(&gate)), (b, other.join().unwrap())]
            }),
            Command::Wait(time) => {
                thread::sleep(time);
                Vec::new()
            }
            Command::Fail(fault) => {
                may_lose |= D::fail(&emulator, fault);
                tally.faults += 1;
                Vec::new()
            }
            Command::Lose(after, fault) => {
                emulator.set_fault_after(after, fault);
                may_lose = true;
                tally.faults += 1;
                Vec::new()
            }
            Command::TakeAlong(mm) => {
                D::take_along(&emulator, mm);
                excused |= mm != 0.0;
                tally.faults += 1;
                Vec::new()
            }
            Command::Restart => Vec::new(),
        };
        let (turning, truth) = (turret.now().1, D::truth(&emulator));
        // What took z along may have taken it past its limit. Then what is begun is judged, until it is back.
        let within = |mm: &[f64; 3], slack: f64| mm.iter().all(|mm| mm.abs() <= LIMIT_MM + slack);
        assert!(
            within(&truth.mm, 1e-6) || excused,
            "{what}: at {:?} mm",
            truth.mm
        );
        if let [(Wish::Move(goal), Ok(()))] = &answers[..]
            && !within(&before.mm, SLACK_MM)
        {
            tally.outside += 1;
            assert!(
                may_begin(&before.mm, goal),
                "{what}: from {:?} mm",
                before.mm
            );
        }
        // The turret was asked before the truth: what turned then may have ended, never begun.
        let begun = matches!(answers[..], [(Wish::Change(_), Ok(()))]);
        if turning || begun {
            assert!(
                within(&truth.mm, SLACK_MM),
                "{what}: it turns at {:?} mm",
                truth.mm
            );
            let z = truth.mm[2];
            assert!(z <= RETRACTED_MM + SLACK_MM, "{what}: it turns at {z} mm");
            assert!(!truth.moves, "{what}: it turns and moves");
        }
        let count = |which: fn(&Wish) -> bool| {
            let began = answers.iter().filter(|(wish, a)| which(wish) && a.is_ok());
            began.count() as u64
        };
        let moves = count(|wish| matches!(wish, Wish::Move(_) | Wish::Retract));
        let turns = count(|wish| matches!(wish, Wish::Change(_)));
        let stops = count(|wish| matches!(wish, Wish::Stop));
        let fails = |e: &ScopeError| e.kind() != ErrorKind::Refused;
        let failed = answers.iter().any(|(_, a)| a.as_ref().is_err_and(fails));
        let lost = failed && gate.poll().is_err();
        assert!(!lost || may_lose, "{what}: {answers:?}");
        // Stopped, and nothing began beside it.
        if !lost && (failed || stops > 0) && moves + turns == 0 {
            assert!(!truth.moves, "{what}: it moves on, {answers:?}");
            assert!(!turning, "{what}: it turns on, {answers:?}");
        }
        if lost || matches!(command, Command::Restart) {
            drop(gate);
            gate = gated(&emulator, &turret);
            may_lose = false;
            tally.lost += u64::from(lost);
            tally.lost_moving += u64::from(lost && truth.moves);
            tally.found_moving += u64::from(D::truth(&emulator).moves);
        }
        tally.moves += moves;
        tally.turns += turns;
        tally.longest = tally.longest.max(start.elapsed());
    }
    tally.sequences = sequences;
    tally
}

#[expect(clippy::print_stdout, reason = "the test reports what it did")]
fn break_no_rule<D: Emulated>() {
    let sequences = std::env::var("SCOPESERVO_EMULATOR_SEQUENCES");
    let sequences: u64 = sequences.map_or(1000, |n| n.parse().unwrap());
    let start = Instant::now();
    let next = Arc::new(AtomicU64::new(0));
    let worker = |_| {
        let watch = Arc::new(Watch(Mutex::new((start, "the first connection".into()))));
        let (watched, next) = (watch.clone(), next.clone());
        let thread = thread::spawn(move || {
            let mut tally = Tally::default();
            loop {
                let seed = next.fetch_add(1, Ordering::SeqCst);
                match sequences.saturating_sub(seed * SEQUENCES_PER_SEED) {
                    0 => return tally,
                    left => tally.add(&drive::<D>(seed, left.min(SEQUENCES_PER_SEED), &watch)),
                }
            }
        });
        (watched, thread)
    };
    let mut workers: Vec<_> = (0..THREADS).map(worker).collect();
    let mut tally = Tally::default();
    while !workers.is_empty() {
        thread::sleep(Duration::from_millis(20));
        for (_, ended) in workers.extract_if(.., |(_, thread)| thread.is_finished()) {
            match ended.join() {
                Ok(part) => tally.add(&part),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        workers.iter().for_each(|(watch, _)| watch.check());
    }
    println!("{tally:?} in {:.1} s", start.elapsed().as_secs_f64());
    // Something must have happened for this to mean anything.
    assert_eq!(tally.sequences, sequences);
    let most = [tally.moves, tally.turns, tally.lost, tally.lost_moving];
    for (happened, least) in most.into_iter().zip([2, 8, 10, 100]) {
        assert!(happened > sequences / least, "{tally:?}");
    }
}

#[test]
fn random_commands_and_faults_break_no_rule_on_the_emulated_hexapod() {
    break_no_rule::<Controller>();
}

#[test]
fn random_commands_and_faults_break_no_rule_on_the_emulated_board_with_g_code() {
    break_no_rule::<Board>();
}

#[test]
fn random_commands_and_faults_break_no_rule_on_the_emulated_sangaboard() {
    break_no_rule::<Sanga>();
}

//! Our own drivers as the rest of the program uses them: the conformance suite, and the motion gate with random commands and
//! faults, against the emulators.

mod common;

use common::tcp;
use scopeservo_drivers::emulator::gcode::{EmulatedBoard, GcodeEmulator};
use scopeservo_drivers::emulator::gcs2::{EmulatedStage, Gcs2Emulator};
use scopeservo_drivers::emulator::sangaboard::{EmulatedSanga, SangaEmulator};
use scopeservo_drivers::gcode::{GcodeAxis, GcodeSettings, GcodeStage};
use scopeservo_drivers::gcs2::{Gcs2Settings, Gcs2Stage};
use scopeservo_drivers::sangaboard::{SangaSettings, SangaStage};
use scopeservo_scope::{
    Axis, AxisRange, Camera, CameraInfo, CancelToken, ChangeRule, Channels, Frame, Instrument,
    Kinematics, Limits, Motion, MotionGate, Nosepiece, Objective, ObjectiveId, PositiveZ, Rules,
    ScopeError, Stage, StagePose, SystemClock, conformance,
};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Stands where a stage driver has no camera.
struct NoCamera(CameraInfo);

impl Camera for NoCamera {
    fn info(&self) -> &CameraInfo {
        &self.0
    }
    fn exposure(&self) -> Result<Duration, ScopeError> {
        Ok(Duration::ZERO)
    }
    fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError> {
        Ok(exposure)
    }
    fn grab(&self) -> Result<Frame, ScopeError> {
        Err(ScopeError::Busy { device: "camera" })
    }
}

/// A nosepiece that takes 3 ms and tells when it turns.
#[derive(Clone)]
struct Turret {
    objectives: Vec<Objective>,
    state: Arc<Mutex<Turn>>,
}

/// The objective in the beam, and the one on its way with the time of its arrival.
type Turn = (Option<usize>, Option<(usize, Instant)>);

impl Turret {
    fn new() -> Self {
        let objective = |id: &str| Objective {
            id: ObjectiveId(id.into()),
            magnification: 100.0,
            numerical_aperture: 0.25,
            nominal_um_per_px: 1.0,
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
        let end = Instant::now() + Duration::from_millis(3);
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

fn conforms(stage: Box<dyn Stage>) {
    let rules = Rules::travel_only(ChangeRule::Anywhere);
    let gate = MotionGate::new(stage, Box::new(Turret::new()), rules).unwrap();
    let camera = NoCamera(CameraInfo {
        name: "none".into(),
        width: 1,
        height: 1,
        channels: Channels::Gray,
        bit_depth: 8,
        min_exposure: Duration::ZERO,
        max_exposure: Duration::ZERO,
    });
    let clock = Arc::new(SystemClock::new());
    let scope = Instrument::new(gate, Box::new(camera), clock, CancelToken::new());
    for check in conformance::check_stage(&scope) {
        assert_eq!(check.outcome, Ok(()), "{}", check.name);
    }
}

fn gcs2() -> Gcs2Settings {
    Gcs2Settings::hexapod(Kinematics::MovesMicroscope, PositiveZ::Closer, 0.1, 0.0001)
}

#[test]
fn gcs2_passes_the_conformance_suite() {
    let emulator = Gcs2Emulator::serve(EmulatedStage::hexapod()).unwrap();
    conforms(Box::new(
        Gcs2Stage::connect(tcp(&emulator.address()), &gcs2()).unwrap(),
    ));
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
    };
    let mut settings: GcodeSettings = serde_json::from_value(serde_json::json!({
        "kinematics": "specimen_xy_on_top",
        "positive_z": "closer",
        "axes": [],
        "speed_um_per_s": 10_000.0,
        "needs_homing": false,
    }))
    .unwrap();
    settings.axes = vec![axis(Axis::X, 'X'), axis(Axis::Y, 'Y')];
    conforms(Box::new(
        GcodeStage::connect(tcp(&emulator.address()), &settings).unwrap(),
    ));
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
        "x": motor, "y": motor, "z": motor,
    }))
    .unwrap();
    conforms(Box::new(
        SangaStage::connect(tcp(&emulator.address()), &settings).unwrap(),
    ));
}

const LIMIT_MM: f64 = 2.0;
const RETRACTED_MM: f64 = -1.0;

/// xorshift: enough for choosing commands.
struct Random(u64);

impl Random {
    fn below(&mut self, n: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) % n
    }
    /// Metres, up to a third beyond the limits.
    fn place(&mut self) -> f64 {
        (self.below(10_001) as f64 / 5000.0 - 1.0) * 1.3 * LIMIT_MM * 1e-3
    }
}

#[test]
fn random_commands_and_faults_through_the_gate_break_no_rule_on_the_emulated_hexapod() {
    let sequences = std::env::var("SCOPESERVO_EMULATOR_SEQUENCES");
    let sequences = sequences.ok().and_then(|n| n.parse().ok()).unwrap_or(400);
    let mut stage = EmulatedStage::hexapod();
    // Fast enough that much happens.
    stage.velocity = 200.0;
    let emulator = Gcs2Emulator::serve(stage).unwrap();
    let driver = Gcs2Stage::connect(tcp(&emulator.address()), &gcs2()).unwrap();
    let turret = Turret::new();
    let range = |axis| AxisRange {
        axis,
        min: -LIMIT_MM * 1e-3,
        max: LIMIT_MM * 1e-3,
    };
    let rules = Rules {
        limits: Limits {
            ranges: [Axis::X, Axis::Y, Axis::Z].map(range).into(),
        },
        ..Rules::travel_only(ChangeRule::Retracted {
            z: RETRACTED_MM * 1e-3,
            margin: 0.0,
        })
    };
    let gate = MotionGate::new(Box::new(driver), Box::new(turret.clone()), rules).unwrap();
    let mut random = Random(7);
    let (mut begun, mut turned) = (0u32, 0u32);
    for sequence in 0..sequences {
        for _ in 0..10 {
            match random.below(12) {
                0..4 => {
                    let to = [Axis::X, Axis::Y, Axis::Z]
                        .into_iter()
                        .fold(StagePose::default(), |to, axis| {
                            to.with_si(axis, random.place())
                        });
                    begun += u32::from(gate.start_move(&to).is_ok());
                }
                4..6 => {
                    let up = StagePose::default().with_si(Axis::Z, RETRACTED_MM * 1e-3);
                    begun += u32::from(gate.start_move(&up).is_ok());
                }
                6..9 => {
                    let id = ["10x", "40x"][random.below(2) as usize];
                    turned += u32::from(gate.start_change(&ObjectiveId(id.into())).is_ok());
                }
                9 => gate.stop().unwrap(),
                10 => match random.below(2) {
                    0 => emulator.set_error(1024),
                    _ => emulator.stop_by_hand(),
                },
                _ => std::thread::sleep(Duration::from_millis(random.below(8))),
            }
            let (turning, truth) = (turret.now().1, emulator.truth());
            for (mm, axis) in truth.iter().zip(["x", "y", "z"]) {
                assert!(mm.abs() <= LIMIT_MM + 1e-6, "{sequence}: {axis} at {mm} mm");
            }
            // The turret was asked before the truth: what turned then may have ended, never begun.
            assert!(
                !turning || truth[2] <= RETRACTED_MM + 2e-3,
                "{sequence}: it turns at {} mm",
                truth[2]
            );
        }
    }
    assert!(
        begun > sequences / 2 && turned > sequences / 20,
        "{begun} {turned}"
    );
}

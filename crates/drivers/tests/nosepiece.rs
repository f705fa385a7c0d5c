//! Nosepieces on axes of the controllers that drive the stage, and on a board of their own, behind the motion gate.

mod common;

use common::tcp;
use scopeservo_drivers::emulator::gcode::{EmulatedBoard, GcodeEmulator};
use scopeservo_drivers::emulator::gcs2::{EmulatedStage, Gcs2Emulator};
use scopeservo_drivers::gcode::{GcodeSettings, GcodeStage};
use scopeservo_drivers::gcs2::{Gcs2Nosepiece, Gcs2Settings, Gcs2Stage};
use scopeservo_drivers::turret::TurretPlace;
use scopeservo_scope::{
    Axis, AxisInfo, ChangeRule, Immersion, Kinematics, KnownBy, Motion, MotionGate, Nosepiece,
    ObjectiveId, PositiveZ, Rules, ScopeError, Stage, StagePose,
};
use std::sync::Arc;
use std::time::{Duration, Instant};

fn places() -> Vec<TurretPlace> {
    [("10x", 0.0), ("20x", 60.0), ("40x", 120.0)]
        .map(|(id, at_deg)| TurretPlace {
            id: id.into(),
            immersion: Immersion::Air,
            magnification: 100.0,
            numerical_aperture: 0.3,
            um_per_px: 1.0,
            at_deg,
        })
        .into()
}

fn gate<T: Stage + 'static>(stage: Arc<T>, nosepiece: Box<dyn Nosepiece>) -> MotionGate {
    let rules = Rules::travel_only(ChangeRule::Retracted {
        z: -1e-3,
        margin: 0.0,
    });
    MotionGate::new(Box::new(stage), nosepiece, rules).unwrap()
}

fn z(um: f64) -> StagePose {
    StagePose::default().with_si(Axis::Z, um * 1e-6)
}

fn id(name: &str) -> ObjectiveId {
    ObjectiveId(name.into())
}

fn settled(poll: impl Fn() -> Result<Motion, ScopeError>) -> Motion {
    let start = Instant::now();
    loop {
        let motion = poll().unwrap();
        if motion != Motion::Moving || start.elapsed() > Duration::from_secs(5) {
            return motion;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn hexapod(referenced: bool) -> Gcs2Emulator {
    let mut stage = EmulatedStage::hexapod_and(&[("A", 180.0)]);
    stage.referenced = referenced;
    stage.velocity = 300.0;
    Gcs2Emulator::serve(stage).unwrap()
}

#[test]
fn a_nosepiece_is_turned_in_what_its_axis_is_counted_in() {
    let turn = std::f64::consts::PI * 1e3;
    let mut stage = EmulatedStage::hexapod_and(&[("A", turn)]);
    stage.velocity = 3e3;
    stage.axes[6].unit = b"MRAD".to_vec();
    let emulator = Gcs2Emulator::serve(stage).unwrap();
    let nosepiece = gcs2(&emulator).unwrap().nosepiece().unwrap();
    for place in places() {
        nosepiece.start_change(&id(&place.id)).unwrap();
        assert_eq!(settled(|| nosepiece.poll()), Motion::Settled);
        assert_eq!(nosepiece.current().unwrap(), Some(id(&place.id)));
        let mrad = place.at_deg.to_radians() * 1e3;
        assert!((emulator.truth()[6] - mrad).abs() < 1e-3);
    }
    let mut stage = EmulatedStage::hexapod_and(&[("A", 180.0)]);
    stage.axes[6].unit = b"MM".to_vec();
    let shifts = gcs2(&Gcs2Emulator::serve(stage).unwrap()).err().unwrap();
    assert!(shifts.to_string().contains("so it shifts"), "{shifts}");
}

fn gcs2(emulator: &Gcs2Emulator) -> Result<Arc<Gcs2Stage>, ScopeError> {
    let mut settings =
        Gcs2Settings::hexapod(Kinematics::MovesMicroscope, PositiveZ::Closer, 0.1, 0.0001);
    settings.nosepiece = Some(Gcs2Nosepiece {
        name: "A".into(),
        arrival_tolerance_deg: 0.1,
        objectives: places(),
    });
    Gcs2Stage::connect(tcp(&emulator.address()), &settings).map(Arc::new)
}

fn board(more: &str) -> GcodeSettings {
    let text = format!(
        r#"{{"boot_ms": 0, "stop_timeout_ms": 500, "stall_timeout_ms": 300, {more} "nosepiece": {{
            "letter": "A", "steps_per_deg": 20, "speed_deg_per_s": 300, "needs_homing": true, "arrival_tolerance_deg": 0.1,
            "objectives": []
        }}}}"#
    );
    let mut settings: GcodeSettings = serde_json::from_str(&text).unwrap();
    settings.nosepiece.as_mut().unwrap().objectives = places();
    settings
}

fn whole_board() -> GcodeSettings {
    board(
        r#""kinematics": "moves_microscope", "positive_z": "closer", "speed_um_per_s": 20000, "needs_homing": false,
        "axes": [{"axis": "z", "letter": "Z", "min_um": -5000, "max_um": 5000, "steps_per_mm": 400, "repeatability_um": 2.5}],"#,
    )
}

fn turning_board() -> GcodeEmulator {
    GcodeEmulator::serve(EmulatedBoard {
        steps_per_deg: Some(20.0),
        homing_ms: 60,
        ..EmulatedBoard::new()
    })
    .unwrap()
}

/// Everything through the gate: refused unless retracted, found on the first change, never with the stage at the same time.
fn changes(gate: &MotionGate, turned_deg: impl Fn() -> f64, homed: bool) {
    let refused = gate.start_change(&id("40x"));
    assert!(
        matches!(refused, Err(ScopeError::NotRetracted { .. })),
        "{refused:?}"
    );
    gate.start_move(&z(-1000.0)).unwrap();
    let early = gate.start_change(&id("40x"));
    assert!(matches!(early, Err(ScopeError::Busy { .. })), "{early:?}");
    assert_eq!(settled(|| gate.poll()), Motion::Settled);
    if !homed {
        assert_eq!(gate.current_objective(), Ok(None));
    }
    gate.start_change(&id("40x")).unwrap();
    // From the first moment on, also while it finds its reference, the stage stays where it is.
    let meanwhile = gate.start_move(&z(-500.0));
    assert!(
        matches!(meanwhile, Err(ScopeError::Busy { .. })),
        "{meanwhile:?}"
    );
    assert_eq!(settled(|| gate.poll_nosepiece()), Motion::Settled);
    assert!((turned_deg() - 120.0).abs() < 0.06, "{}", turned_deg());
    assert_eq!(gate.current_objective(), Ok(Some(id("40x"))));
    gate.start_move(&z(-500.0)).unwrap();
    assert_eq!(settled(|| gate.poll()), Motion::Settled);
    assert_eq!(gate.current_objective(), Ok(Some(id("40x"))));
    gate.start_move(&z(-1000.0)).unwrap();
    assert_eq!(settled(|| gate.poll()), Motion::Settled);
    // Stopped on the way there is no active objective, and another change is allowed.
    gate.start_change(&id("10x")).unwrap();
    std::thread::sleep(Duration::from_millis(30));
    gate.stop().unwrap();
    let stopped = turned_deg();
    assert!((1.0..119.0).contains(&stopped), "{stopped}");
    assert_eq!(gate.poll_nosepiece(), Ok(Motion::Stopped));
    assert_eq!(gate.current_objective(), Ok(None));
    std::thread::sleep(Duration::from_millis(30));
    assert!((turned_deg() - stopped).abs() < 1e-9);
    gate.start_change(&id("20x")).unwrap();
    assert_eq!(settled(|| gate.poll_nosepiece()), Motion::Settled);
    assert_eq!(gate.current_objective(), Ok(Some(id("20x"))));
}

#[test]
fn a_gcs2_controller_turns_a_nosepiece_too() {
    let emulator = hexapod(true);
    let stage = gcs2(&emulator).unwrap();
    let nosepiece = stage.nosepiece().unwrap();
    assert_eq!(nosepiece.known_by(), KnownBy::Sensor);
    let gate = gate(stage, Box::new(nosepiece));
    changes(&gate, || emulator.truth()[6], true);
    assert!((emulator.truth()[2] + 1.0).abs() < 1e-9);
}

#[test]
fn a_gcs2_nosepiece_finds_its_reference_with_the_first_change_and_the_stage_stays() {
    let emulator = hexapod(false);
    let stage = gcs2(&emulator).unwrap();
    stage.start_homing().unwrap();
    assert_eq!(settled(|| stage.poll()), Motion::Settled);
    let nosepiece = stage.nosepiece().unwrap();
    let gate = gate(stage, Box::new(nosepiece));
    changes(&gate, || emulator.truth()[6], false);
    assert!((emulator.truth()[2] + 1.0).abs() < 1e-9);
    let heard = emulator.heard();
    assert_eq!(heard.iter().filter(|l| *l == "FRF A").count(), 1);
}

#[test]
fn places_outside_the_travel_of_the_axis_are_refused_on_connecting() {
    let mut stage = EmulatedStage::hexapod_and(&[("A", 90.0)]);
    stage.velocity = 300.0;
    let emulator = Gcs2Emulator::serve(stage).unwrap();
    let error = gcs2(&emulator).err().unwrap().to_string();
    assert!(error.contains("40x stands at 120 deg"), "{error}");
    let without = Gcs2Emulator::serve(EmulatedStage::hexapod()).unwrap();
    let error = gcs2(&without).err().unwrap().to_string();
    assert!(error.contains("no axis A"), "{error}");
}

#[test]
fn a_gcode_board_turns_a_nosepiece_beside_its_stage() {
    let emulator = turning_board();
    let stage = GcodeStage::connect(tcp(&emulator.address()), &whole_board()).unwrap();
    let stage = Arc::new(stage);
    let nosepiece = stage.nosepiece().unwrap();
    let axes: Vec<&AxisInfo> = stage.info().axes.iter().collect();
    assert_eq!(axes.len(), 1);
    let gate = gate(stage, Box::new(nosepiece));
    changes(&gate, || emulator.turned_deg(), false);
    assert!((emulator.truth()[2] + 1.0).abs() < 1e-9);
    let heard = emulator.heard();
    assert!(heard.contains(&"G28 A R0".to_string()), "{heard:?}");
}

#[test]
fn a_board_that_lifts_the_stage_while_the_nosepiece_looks_for_its_switch_is_told() {
    let lifting = |knows_r0| {
        GcodeEmulator::serve(EmulatedBoard {
            steps_per_deg: Some(20.0),
            homing_ms: 30,
            lifts_mm: 5.0,
            knows_r0,
            ..EmulatedBoard::new()
        })
        .unwrap()
    };
    let turned = |emulator: &GcodeEmulator| {
        let stage = GcodeStage::connect(tcp(&emulator.address()), &whole_board()).unwrap();
        let stage = Arc::new(stage);
        let nosepiece = stage.nosepiece().unwrap();
        let gate = gate(stage, Box::new(nosepiece));
        gate.start_move(&z(-1000.0)).unwrap();
        assert_eq!(settled(|| gate.poll()), Motion::Settled);
        gate.start_change(&id("40x")).unwrap();
        let start = Instant::now();
        loop {
            match gate.poll_nosepiece() {
                Ok(Motion::Moving) if start.elapsed() < Duration::from_secs(5) => {}
                ended => return ended,
            }
        }
    };
    let emulator = lifting(true);
    assert_eq!(turned(&emulator), Ok(Motion::Settled));
    assert!((emulator.truth()[2] + 1.0).abs() < 1e-9);
    let error = turned(&lifting(false)).unwrap_err().to_string();
    assert!(
        error.contains("the stage moved while the nosepiece"),
        "{error}"
    );
}

#[test]
fn a_stepper_of_its_own_is_a_nosepiece() {
    let emulator = turning_board();
    let mut settings = board("");
    settings.nosepiece.as_mut().unwrap().needs_homing = false;
    let board = GcodeStage::connect(tcp(&emulator.address()), &settings).unwrap();
    let nosepiece = Arc::new(board).nosepiece().unwrap();
    // Where it stands is what somebody said.
    assert_eq!(nosepiece.known_by(), KnownBy::Count);
    assert_eq!(nosepiece.current(), Ok(Some(id("10x"))));
    nosepiece.start_change(&id("20x")).unwrap();
    assert_eq!(settled(|| nosepiece.poll()), Motion::Settled);
    assert!((emulator.turned_deg() - 60.0).abs() < 0.06);
    // Held up on the way, it does not claim to have arrived.
    nosepiece.start_change(&id("40x")).unwrap();
    std::thread::sleep(Duration::from_millis(30));
    emulator.block();
    assert_eq!(settled(|| nosepiece.poll()), Motion::Stopped);
    assert_eq!(nosepiece.current(), Ok(None));
}

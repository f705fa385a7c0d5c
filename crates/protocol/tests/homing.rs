//! Homing, light, and how a nosepiece knows its objective pass from a program to our devices and back.

use scopeservo_protocol::{Driver, Offer, listen};
use scopeservo_scope::{
    Axis, AxisInfo, CancelToken, ChangeRule, Clock, Devices, Immersion, Instrument, Kinematics,
    KnownBy, Light, Motion, Nosepiece, Objective, ObjectiveId, PositiveZ, Rules, ScopeError, Stage,
    StageInfo, StagePose, SystemClock, check_level,
};
use std::net::TcpListener;
use std::sync::{Arc, Mutex};

/// A stage that finds its reference at the second look.
struct Lost {
    info: StageInfo,
    /// Whether it knows where it is, and how many looks it takes until it does.
    state: Mutex<(bool, u32)>,
}

impl Lost {
    fn new() -> Self {
        Self {
            info: StageInfo {
                name: "lost".into(),
                axes: vec![AxisInfo {
                    axis: Axis::X,
                    min: -1e-3,
                    max: 1e-3,
                    repeatability: 0.0,
                    arrival_tolerance: None,
                }],
                kinematics: Kinematics::SpecimenXyOnTop,
                positive_z: PositiveZ::Closer,
            },
            state: Mutex::new((false, 0)),
        }
    }
}

impl Stage for Lost {
    fn info(&self) -> &StageInfo {
        &self.info
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        match self.state.lock().unwrap().0 {
            true => Ok(StagePose::default().with_si(Axis::X, 0.0)),
            false => Err(ScopeError::NotHomed { device: "stage" }),
        }
    }
    fn start_move(&self, _: &StagePose) -> Result<(), ScopeError> {
        Err(ScopeError::NotHomed { device: "stage" })
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        let mut state = self.state.lock().unwrap();
        if state.1 > 0 {
            *state = (state.1 == 1, state.1 - 1);
            return Ok(Motion::Moving);
        }
        Ok(Motion::Settled)
    }
    fn stop(&self) -> Result<(), ScopeError> {
        Ok(())
    }
    fn is_homed(&self) -> Result<bool, ScopeError> {
        Ok(self.state.lock().unwrap().0)
    }
    fn start_homing(&self) -> Result<(), ScopeError> {
        *self.state.lock().unwrap() = (false, 2);
        Ok(())
    }
}

struct Lamp(Mutex<f64>);

impl Light for Lamp {
    fn level(&self) -> Result<f64, ScopeError> {
        Ok(*self.0.lock().unwrap())
    }
    fn set_level(&self, level: f64) -> Result<f64, ScopeError> {
        check_level(level)?;
        *self.0.lock().unwrap() = level;
        Ok(level)
    }
}

#[test]
fn a_stage_is_homed_and_a_light_set_over_the_protocol() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        let offer = Offer {
            name: "lost".into(),
            devices: Devices {
                stage: Some(Box::new(Lost::new())),
                light: Some(Box::new(Lamp(Mutex::new(0.25)))),
                ..Devices::none(Arc::new(SystemClock::new()))
            },
        };
        listen(&listener, &offer, None, &|_| {})
    });
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let open = || {
        let driver = Driver::connect(&address, None).unwrap();
        let rules = Rules::travel_only(ChangeRule::Anywhere);
        Instrument::new(driver.devices(&clock).unwrap(), rules, CancelToken::new()).unwrap()
    };
    let scope = open();
    let to = StagePose::default().with_si(Axis::X, 1e-4);
    assert!(!scope.gate().is_homed().unwrap());
    let refused = scope.gate().start_move(&to);
    assert_eq!(refused, Err(ScopeError::NotHomed { device: "stage" }));
    scope.home().unwrap();
    assert!(scope.gate().is_homed().unwrap());
    let light = scope.light().unwrap();
    assert_eq!(light.level(), Ok(0.25));
    assert_eq!(light.set_level(0.75), Ok(0.75));
    assert!(matches!(
        light.set_level(1.5),
        Err(ScopeError::BadSetting { .. })
    ));
    assert_eq!(light.level(), Ok(0.75));
    drop(scope);
    // Who comes later is told that it knows where it is.
    assert!(open().gate().is_homed().unwrap());
}

/// Turned by somebody, who says so.
struct Turned(Vec<Objective>, Mutex<Option<ObjectiveId>>);

impl Nosepiece for Turned {
    fn objectives(&self) -> &[Objective] {
        &self.0
    }
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        Ok(self.1.lock().unwrap().clone())
    }
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        *self.1.lock().unwrap() = Some(to.clone());
        Ok(())
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        Ok(Motion::Settled)
    }
    fn stop(&self) -> Result<(), ScopeError> {
        Ok(())
    }
    fn known_by(&self) -> KnownBy {
        KnownBy::Report
    }
}

#[test]
fn a_nosepiece_of_another_program_says_how_it_knows_its_objective() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        let objective = |id: &str| Objective {
            id: ObjectiveId(id.into()),
            magnification: 100.0,
            numerical_aperture: 0.25,
            nominal_um_per_px: 1.0,
            immersion: Immersion::Air,
        };
        let turned = Turned(["10x", "40x"].map(objective).into(), Mutex::new(None));
        let offer = Offer {
            name: "turned".into(),
            devices: Devices {
                nosepiece: Some(Box::new(turned)),
                ..Devices::none(Arc::new(SystemClock::new()))
            },
        };
        listen(&listener, &offer, None, &|_| {})
    });
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let devices = Driver::connect(&address, None).unwrap().devices(&clock);
    let rules = Rules::travel_only(ChangeRule::Anywhere);
    let scope = Instrument::new(devices.unwrap(), rules, CancelToken::new()).unwrap();
    let (gate, id) = (scope.gate(), ObjectiveId("40x".into()));
    scope.select_objective(&id).unwrap();
    assert!(gate.objective_is_reported());
    gate.confirm_objective();
    assert!(!gate.objective_is_reported());
    // An image shows another: whoever turned it is asked again.
    assert!(gate.contradict_objective());
    assert_eq!(gate.current_objective(), Ok(None));
    scope.select_objective(&id).unwrap();
    assert_eq!(gate.current_objective(), Ok(Some(id)));
    assert!(gate.objective_is_reported());
}

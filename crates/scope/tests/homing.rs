//! Homing goes through the gate like every other motion.

use scopeservo_scope::{
    Axis, AxisInfo, AxisRange, CancelToken, ChangeRule, Clock, Devices, ErrorKind, GateEvent,
    Instrument, Kinematics, Limits, Motion, PositiveZ, Rules, ScopeError, Stage, StageInfo,
    StagePose, Timestamp, VirtualClock,
};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

/// A stage of one axis that does not know where it is until it was homed.
#[derive(Clone)]
struct Lost {
    info: StageInfo,
    world: Arc<Mutex<World>>,
}

struct World {
    homed: bool,
    /// Looks at it until the reference is found.
    left: Option<u32>,
    stopped: bool,
    /// Where the reference is, m.
    reference: f64,
    /// Whether it is found.
    finds: bool,
    at: f64,
    log: Vec<&'static str>,
}

impl Lost {
    fn new(reference: f64, finds: bool) -> Self {
        Self {
            info: StageInfo {
                name: "lost".into(),
                axes: vec![AxisInfo {
                    axis: Axis::X,
                    min: 0.0,
                    max: 1e-2,
                    repeatability: 0.0,
                    arrival_tolerance: None,
                }],
                kinematics: Kinematics::SpecimenXyOnTop,
                positive_z: PositiveZ::Closer,
            },
            world: Arc::new(Mutex::new(World {
                homed: false,
                left: None,
                stopped: false,
                reference,
                finds,
                at: 5e-3,
                log: Vec::new(),
            })),
        }
    }

    fn world(&self) -> MutexGuard<'_, World> {
        self.world.lock().unwrap()
    }

    /// Behind a gate that keeps it between 1 and 9 mm.
    fn instrument(&self, cancel: &CancelToken, clock: Arc<dyn Clock>) -> Instrument {
        let mut rules = Rules::travel_only(ChangeRule::Anywhere);
        rules.limits = Limits {
            ranges: vec![AxisRange {
                axis: Axis::X,
                min: 1e-3,
                max: 9e-3,
            }],
        };
        let devices = Devices {
            stage: Some(Box::new(self.clone())),
            ..Devices::none(clock)
        };
        Instrument::new(devices, rules, cancel.clone()).unwrap()
    }
}

impl Stage for Lost {
    fn info(&self) -> &StageInfo {
        &self.info
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        let world = self.world();
        match world.homed {
            true => Ok(StagePose::default().with_si(Axis::X, world.at)),
            false => Err(ScopeError::NotHomed { device: "stage" }),
        }
    }
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        let mut world = self.world();
        world.log.push("move");
        world.at = to.si(Axis::X).unwrap();
        Ok(())
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        let mut world = self.world();
        world.left = match world.left {
            Some(0) => {
                (world.homed, world.at) = (world.finds, world.reference);
                None
            }
            left => left.map(|n| n - 1),
        };
        Ok(match (world.left, world.stopped) {
            (Some(_), _) => Motion::Moving,
            (None, true) => Motion::Stopped,
            (None, false) => Motion::Settled,
        })
    }
    fn stop(&self) -> Result<(), ScopeError> {
        let mut world = self.world();
        world.log.push("stop");
        world.stopped |= world.left.take().is_some();
        Ok(())
    }
    fn is_homed(&self) -> Result<bool, ScopeError> {
        Ok(self.world().homed)
    }
    fn start_homing(&self) -> Result<(), ScopeError> {
        let mut world = self.world();
        world.log.push("home");
        (world.left, world.homed) = (Some(3), false);
        Ok(())
    }
}

fn x(mm: f64) -> StagePose {
    StagePose::default().with_si(Axis::X, mm * 1e-3)
}

#[test]
fn a_stage_that_does_not_know_where_it_is_goes_nowhere_but_to_its_reference() {
    let stage = Lost::new(0.5e-3, true);
    let scope = stage.instrument(&CancelToken::new(), Arc::new(VirtualClock::new()));
    let refused = scope.gate().start_move(&x(5.0));
    assert_eq!(refused, Err(ScopeError::NotHomed { device: "stage" }));
    assert_eq!(refused.unwrap_err().kind(), ErrorKind::Refused);
    assert!(stage.world().log.is_empty(), "{:?}", stage.world().log);
    assert!(!scope.gate().is_homed().unwrap());
    // While it looks for the reference, nothing else begins.
    scope.gate().start_homing().unwrap();
    for busy in [
        scope.gate().start_move(&x(5.0)),
        scope.gate().start_homing(),
    ] {
        assert_eq!(busy, Err(ScopeError::Busy { device: "stage" }));
    }
    assert_eq!(
        scope.home().unwrap_err(),
        ScopeError::Busy { device: "stage" }
    );
    while scope.gate().poll().unwrap() == Motion::Moving {}
    // Its reference lies outside the user's limits: that is no fault, and from there it only comes back.
    assert_eq!(scope.home().unwrap(), x(0.5));
    let out = scope.gate().start_move(&x(0.2));
    assert!(out.is_err_and(|e| e.kind() == ErrorKind::Refused));
    scope.move_to(&x(5.0)).unwrap();
    assert_eq!(stage.world().log, ["home", "home", "move"]);
}

#[test]
fn what_homing_does_not_find_or_cannot_be_is_a_fault() {
    let clock = || Arc::new(VirtualClock::new());
    let stage = Lost::new(0.0, false);
    let fault = stage.instrument(&CancelToken::new(), clock()).home();
    assert!(
        matches!(&fault, Err(ScopeError::Device { detail, .. }) if detail.contains("does not know")),
        "{fault:?}"
    );
    assert_eq!(stage.world().log, ["home", "stop"]);
    let stage = Lost::new(0.1, true);
    let fault = stage.instrument(&CancelToken::new(), clock()).home();
    assert!(
        matches!(fault, Err(ScopeError::ImpossiblePlace { .. })),
        "{fault:?}"
    );
}

/// What the gate tells.
fn heard(scope: &Instrument) -> Arc<Mutex<Vec<GateEvent>>> {
    let told: Arc<Mutex<Vec<GateEvent>>> = Arc::default();
    let ear = told.clone();
    scope
        .gate()
        .observe(Some(Arc::new(move |e| ear.lock().unwrap().push(e))));
    told
}

#[test]
fn homing_is_told_from_its_beginning_to_its_end() {
    let clock = || Arc::new(VirtualClock::new());
    let began = || GateEvent::HomingBegan {
        axes: vec![Axis::X],
    };
    let scope = Lost::new(0.5e-3, true).instrument(&CancelToken::new(), clock());
    let told = heard(&scope);
    assert_eq!(scope.gate().last_reported(), None);
    let at = scope.home().unwrap();
    assert_eq!(
        *told.lock().unwrap(),
        [began(), GateEvent::HomingEnded { at }]
    );
    assert_eq!(scope.gate().last_reported(), Some(at));
    // One that has nothing to begin with, and one that finds nothing.
    let cancel = CancelToken::new();
    let scope = Lost::new(0.0, false).instrument(&cancel, clock());
    let told = heard(&scope);
    scope.home().unwrap_err();
    cancel.cancel();
    scope.gate().start_homing().unwrap_err();
    let told = told.lock().unwrap();
    assert!(
        matches!(
            &told[..],
            [
                first,
                GateEvent::Stopped { .. },
                GateEvent::HomingFailed { .. },
                GateEvent::HomingRefused { .. }
            ] if *first == began()
        ),
        "{told:?}"
    );
}

#[test]
fn a_place_that_was_reported_counts_until_the_stage_departs() {
    let scope =
        Lost::new(1e-3, true).instrument(&CancelToken::new(), Arc::new(VirtualClock::new()));
    let gate = scope.gate();
    scope.home().unwrap();
    assert_eq!(gate.last_reported(), Some(x(1.0)));
    gate.start_move(&x(5.0)).unwrap();
    // Asked on the way it is nowhere to stay.
    assert_eq!(gate.position().unwrap(), x(5.0));
    assert_eq!(gate.last_reported(), None);
    assert_eq!(gate.poll().unwrap(), Motion::Settled);
    gate.arrived().unwrap();
    assert_eq!(gate.last_reported(), Some(x(5.0)));
    // A move that is refused has not begun.
    gate.start_move(&x(20.0)).unwrap_err();
    assert_eq!(gate.last_reported(), Some(x(5.0)));
}

/// A clock on which somebody asks for a stop as soon as anybody waits.
struct Impatient(VirtualClock, CancelToken);

impl Clock for Impatient {
    fn now(&self) -> Timestamp {
        self.0.now()
    }
    fn sleep(&self, duration: Duration) {
        self.1.cancel();
        self.0.sleep(duration);
    }
}

#[test]
fn homing_obeys_a_stop_and_does_not_begin_after_one() {
    let stage = Lost::new(0.0, true);
    let cancel = CancelToken::new();
    let clock = Impatient(VirtualClock::new(), cancel.clone());
    let scope = stage.instrument(&cancel, Arc::new(clock));
    // Where it stands then, nobody knows.
    assert_eq!(scope.home(), Err(ScopeError::Interrupted { at: None }));
    assert_eq!(stage.world().log[..2], ["home", "stop"]);
    let begun = |stage: &Lost| stage.world().log.iter().filter(|l| **l == "home").count();
    assert_eq!(
        scope.gate().start_homing(),
        Err(ScopeError::Interrupted { at: None })
    );
    assert_eq!(begun(&stage), 1);
}

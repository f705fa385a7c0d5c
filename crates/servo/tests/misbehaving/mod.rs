//! A simulated microscope whose stage misbehaves on demand. The twin knows the truth, and a log what was asked.

use scopeservo_scope::{
    Axis, AxisRange, Camera, CameraInfo, CancelToken, ChangeRule, Clock, Devices, Frame,
    Instrument, Limits, Motion, PositiveZ, Rules, ScopeError, Stage, StageInfo, StagePose,
    VirtualClock,
};
use scopeservo_servo::{NoSink, Procedure, ServoError, run};
use scopeservo_twin::specimen::{Specimen, Tissue};
use scopeservo_twin::{Config, StageConfig, Twin};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

/// What is wrong with the stage. Lengths in um.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Wrong {
    Nothing,
    /// It stops at an obstacle, and says where it is.
    Wall(Axis, [f64; 2]),
    /// Whatever moves along x lifts z by so much, which it says.
    LiftsZ(f64),
    /// It goes this share of every way.
    Share(f64),
    /// The axis goes to the other side.
    Mirrored(Axis),
    /// x goes on beyond its goal.
    RunsOn(f64),
    /// The encoder of x is off by so much.
    Says(f64),
    /// It says zero, wherever it is.
    SaysZero,
    /// It says the other sign of z.
    SaysOtherSign,
    /// It says this of x.
    SaysOfX(f64),
    /// It does not move, and says that it has arrived.
    Pretends,
    /// It says that it has settled while it moves.
    SettlesEarly,
    /// x goes on by so much a second after each move has begun, and says so.
    Creeps(f64),
    /// Its unit is wrong: it goes so many times too far, and says what it was told.
    Unit(f64),
    /// It takes no stop.
    IgnoresStop,
    /// It never settles.
    NeverSettles,
    /// It ends every move at once, and says so.
    StopsShort,
    /// It refuses to go nearer to the specimen than this from zero, um.
    RefusesNearer(f64),
    /// It fails there.
    FailsNearer(f64),
}

/// What was asked of the stage.
#[derive(Debug, Default)]
pub(crate) struct Log {
    pub(crate) goals: Vec<StagePose>,
    pub(crate) stops: usize,
    sent: StagePose,
    since_s: f64,
}

pub(crate) struct Misbehaving {
    real: Box<dyn Stage>,
    info: StageInfo,
    wrong: Arc<Mutex<Wrong>>,
    log: Arc<Mutex<Log>>,
    clock: Arc<dyn Clock>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap()
}

impl Misbehaving {
    fn wrong(&self) -> Wrong {
        *lock(&self.wrong)
    }
}

impl Stage for Misbehaving {
    fn info(&self) -> &StageInfo {
        &self.info
    }

    fn position(&self) -> Result<StagePose, ScopeError> {
        let at = self.real.position()?;
        let x = at.si(Axis::X).unwrap();
        Ok(match self.wrong() {
            Wrong::Says(um) => at.with_si(Axis::X, x + um * 1e-6),
            Wrong::SaysZero => StagePose::default()
                .with_si(Axis::X, 0.0)
                .with_si(Axis::Y, 0.0)
                .with_si(Axis::Z, 0.0),
            Wrong::SaysOtherSign => at.with_si(Axis::Z, -at.si(Axis::Z).unwrap()),
            Wrong::Creeps(um_per_s) => {
                let seconds = self.clock.now().seconds() - lock(&self.log).since_s;
                at.with_si(Axis::X, x + um_per_s * 1e-6 * seconds)
            }
            Wrong::SaysOfX(um) => at.with_si(Axis::X, um * 1e-6),
            Wrong::Pretends | Wrong::Unit(_) => lock(&self.log).sent.or(&at),
            _ => at,
        })
    }

    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        let at = self.real.position()?;
        let mut log = lock(&self.log);
        let nearer = |z: f64| self.info().positive_z.nearer_by(z * 1e6, 0.0);
        let nearer_um = to.si(Axis::Z).map(nearer);
        match self.wrong() {
            Wrong::RefusesNearer(um) if nearer_um.is_some_and(|z| z > um) => {
                return Err(ScopeError::Refused {
                    device: "stage",
                    detail: "too near".into(),
                });
            }
            Wrong::FailsNearer(um) if nearer_um.is_some_and(|z| z > um) => {
                return Err(ScopeError::Device {
                    device: "stage",
                    detail: "smoke".into(),
                });
            }
            _ => {}
        }
        log.goals.push(*to);
        log.since_s = self.clock.now().seconds();
        log.sent = to.or(&log.sent);
        let mut goal = *to;
        for axis in [Axis::X, Axis::Y, Axis::Z] {
            let Some(asked) = to.si(axis) else { continue };
            let from = at.si(axis).unwrap();
            goal = goal.with_si(
                axis,
                match self.wrong() {
                    Wrong::Wall(wall, [low, high]) if wall == axis => {
                        asked.clamp(low * 1e-6, high * 1e-6)
                    }
                    Wrong::Share(share) => from + share * (asked - from),
                    Wrong::Mirrored(other) if other == axis => from - (asked - from),
                    Wrong::RunsOn(um) if axis == Axis::X => asked + um * 1e-6,
                    Wrong::Unit(times) => asked * times,
                    _ => asked,
                },
            );
        }
        match self.wrong() {
            Wrong::Pretends => return Ok(()),
            Wrong::LiftsZ(um) if to.si(Axis::X) != at.si(Axis::X) && to.si(Axis::X).is_some() => {
                goal = goal.with_si(Axis::Z, at.si(Axis::Z).unwrap() + um * 1e-6);
            }
            _ => {}
        }
        self.real.start_move(&goal)
    }

    fn poll(&self) -> Result<Motion, ScopeError> {
        let motion = self.real.poll()?;
        match self.wrong() {
            Wrong::SettlesEarly => Ok(Motion::Settled),
            Wrong::NeverSettles if !lock(&self.log).goals.is_empty() => Ok(Motion::Moving),
            Wrong::StopsShort => {
                self.real.stop()?;
                Ok(Motion::Stopped)
            }
            _ => Ok(motion),
        }
    }

    fn stop(&self) -> Result<(), ScopeError> {
        lock(&self.log).stops += 1;
        match self.wrong() {
            Wrong::IgnoresStop => Ok(()),
            _ => self.real.stop(),
        }
    }
}

/// A camera that fails after so many images.
struct Failing {
    real: Box<dyn Camera>,
    left: Arc<Mutex<usize>>,
}

impl Camera for Failing {
    fn info(&self) -> &CameraInfo {
        self.real.info()
    }
    fn exposure(&self) -> Result<Duration, ScopeError> {
        self.real.exposure()
    }
    fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError> {
        self.real.set_exposure(exposure)
    }
    fn grab(&self) -> Result<Frame, ScopeError> {
        let mut left = lock(&self.left);
        if *left == 0 {
            return Err(ScopeError::Device {
                device: "camera",
                detail: "no light".into(),
            });
        }
        *left -= 1;
        self.real.grab()
    }
}

/// A clock that asks for a stop after a number of waits.
struct Impatient {
    clock: VirtualClock,
    left: Mutex<Option<usize>>,
    cancel: CancelToken,
}

impl Clock for Impatient {
    fn now(&self) -> scopeservo_scope::Timestamp {
        self.clock.now()
    }
    fn sleep(&self, duration: Duration) {
        self.clock.sleep(duration);
        let mut left = lock(&self.left);
        if let Some(waits) = left.as_mut() {
            *waits = waits.saturating_sub(1);
            if *waits == 0 {
                self.cancel.cancel();
            }
        }
    }
}

/// The microscope.
pub(crate) struct Bench {
    pub(crate) twin: Twin,
    pub(crate) scope: Instrument,
    wrong: Arc<Mutex<Wrong>>,
    pub(crate) log: Arc<Mutex<Log>>,
    pictures: Arc<Mutex<usize>>,
    clock: Arc<Impatient>,
}

/// How a microscope is set up.
pub(crate) struct Make {
    pub(crate) specimen: Arc<dyn Specimen>,
    pub(crate) positive_z: PositiveZ,
    /// Objectives by their number in the twin.
    pub(crate) objectives: Vec<usize>,
    /// Limits of x and z, um.
    pub(crate) x_um: [f64; 2],
    pub(crate) z_um: [f64; 2],
    /// Play in the focus drive, um.
    pub(crate) play_um: f64,
}

impl Default for Make {
    fn default() -> Self {
        Self {
            specimen: Arc::new(Tissue::new(7)),
            positive_z: PositiveZ::Closer,
            objectives: vec![2],
            x_um: [-3000.0, 3000.0],
            z_um: [-2500.0, 2500.0],
            play_um: 0.2,
        }
    }
}

impl Bench {
    pub(crate) fn new(make: Make) -> Self {
        let mut stage = StageConfig::xyz();
        stage.positive_z = make.positive_z;
        for axis in stage.axes.iter_mut().filter(|a| a.axis == Axis::Z) {
            axis.backlash = make.play_um;
        }
        let mut config = Config::realistic().with_stage(stage);
        // Small images are enough to tell, and quick.
        (config.camera.width, config.camera.height) = (320, 240);
        let mut kept = 0..config.optics.len();
        config
            .optics
            .retain(|_| make.objectives.contains(&kept.next().unwrap()));
        let cancel = CancelToken::new();
        let clock = Arc::new(Impatient {
            clock: VirtualClock::new(),
            left: Mutex::new(None),
            cancel: cancel.clone(),
        });
        let twin = Twin::new(config, make.specimen, 5, clock.clone()).unwrap();
        let (wrong, log) = (
            Arc::new(Mutex::new(Wrong::Nothing)),
            Arc::new(Mutex::new(Log::default())),
        );
        let real = twin.stage();
        let stage = Misbehaving {
            info: real.info().clone(),
            real,
            wrong: wrong.clone(),
            log: log.clone(),
            clock: clock.clone(),
        };
        let range = |axis, [min, max]: [f64; 2]| AxisRange {
            axis,
            min: min * 1e-6,
            max: max * 1e-6,
        };
        let rules = Rules {
            limits: Limits {
                ranges: vec![range(Axis::X, make.x_um), range(Axis::Z, make.z_um)],
            },
            ..Rules::travel_only(ChangeRule::Anywhere)
        };
        let pictures = Arc::new(Mutex::new(usize::MAX));
        let camera = Failing {
            real: twin.camera(),
            left: pictures.clone(),
        };
        let devices = Devices {
            stage: Some(Box::new(stage)),
            camera: Some(Box::new(camera)),
            ..twin.devices()
        };
        let scope = Instrument::new(devices, rules, cancel).unwrap();
        twin.centre_specimen([300.0, 100.0], 0.0);
        Self {
            twin,
            scope,
            wrong,
            log,
            pictures,
            clock,
        }
    }

    /// From now on this is wrong.
    pub(crate) fn goes_wrong(&self, wrong: Wrong) {
        *lock(&self.wrong) = wrong;
    }

    /// The camera fails after so many images.
    pub(crate) fn pictures_left(&self, count: usize) {
        *lock(&self.pictures) = count;
    }

    /// Somebody asks for a stop after so many waits.
    pub(crate) fn stop_after(&self, waits: usize) {
        *lock(&self.clock.left) = Some(waits);
    }

    pub(crate) fn log(&self) -> MutexGuard<'_, Log> {
        lock(&self.log)
    }

    /// Where the stage truly is, um.
    pub(crate) fn true_um(&self, axis: Axis) -> f64 {
        self.twin.truth_now().stage.si(axis).unwrap() * 1e6
    }

    /// Puts the real stage somewhere, past every rule.
    pub(crate) fn put_um(&self, axis: Axis, um: f64) {
        let stage = self.twin.stage();
        stage
            .start_move(&StagePose::default().with_si(axis, um * 1e-6))
            .unwrap();
        while stage.poll().unwrap() == Motion::Moving {
            self.clock.clock.sleep(Duration::from_millis(5));
        }
    }

    pub(crate) fn run<P: Procedure>(&self, mut procedure: P) -> Result<P::Output, ServoError> {
        run(&mut procedure, &self.scope, &mut NoSink)
    }
}

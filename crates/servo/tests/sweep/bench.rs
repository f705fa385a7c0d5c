//! A simulated microscope whose stage and camera do odd things while z moves slowly, and a focus with a sweep on it.

#![allow(unreachable_pub, reason = "a part of one test")]

use crate::common::{PLACE_UM, one_objective};
use scopeservo_scope::{
    Axis, Camera, CameraInfo, CancelToken, Clock, Devices, Frame, Instrument, Motion, ScopeError,
    Stage, StageInfo, StagePose, Timestamp, VirtualClock,
};
use scopeservo_servo::{
    Event, Focus, FocusOptions, FocusResult, FocusSweep, FrameRole, ServoError, Sink, Stamped, run,
};
use scopeservo_twin::specimen::Specimen;
use scopeservo_twin::{Config, Twin};
use std::sync::atomic::{AtomicU64, Ordering::SeqCst};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// What is odd about the stage in motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Odd {
    Nothing,
    /// It stands for so many seconds half-way, and goes on.
    Stalls(f64),
    /// It stands half-way for ever, and says that it moves.
    NeverArrives,
    /// It does not tell where it is.
    Silent,
    /// It says that it is where it was sent, or where it came from.
    SaysGoal,
    SaysStart,
    /// Its move call comes back when the move is over.
    Blocks,
    /// It has one speed.
    OneSpeed,
    /// It goes so many times as fast as it was asked to.
    Times(f64),
    /// It stops by itself half-way, and says so, or says that it is there.
    EndsHalfWay {
        says_settled: bool,
    },
}

struct OddStage {
    real: Box<dyn Stage>,
    clock: Arc<dyn Clock>,
    odd: Odd,
    /// Start, goal and begin of a slow move that is under way, and whether its second half has begun.
    slow: Mutex<Option<(StagePose, StagePose, f64, bool)>>,
    /// The heights that it was seen at, um.
    heights: Arc<Mutex<Vec<f64>>>,
}

impl Stage for OddStage {
    fn info(&self) -> &StageInfo {
        self.real.info()
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        let at = self.real.position()?;
        self.heights.lock().unwrap().push(at.z.unwrap().um());
        let slow = *self.slow.lock().unwrap();
        match (slow, self.odd) {
            (Some(_), Odd::Silent) => Err(ScopeError::Busy { device: "stage" }),
            (Some((_, to, ..)), Odd::SaysGoal) => Ok(to.or(&at)),
            (Some((from, ..)), Odd::SaysStart) => Ok(from),
            _ => Ok(at),
        }
    }
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        *self.slow.lock().unwrap() = None;
        self.real.start_move(to)
    }
    fn start_move_at(&self, to: &StagePose, m_per_s: f64) -> Result<(), ScopeError> {
        let from = self.real.position()?;
        let middle = 0.5 * (from.si(Axis::Z).unwrap() + to.si(Axis::Z).unwrap());
        let middle = StagePose::default().with_si(Axis::Z, middle);
        match self.odd {
            Odd::OneSpeed => {
                return Err(ScopeError::Refused {
                    device: "stage",
                    detail: "its speed cannot be chosen".into(),
                });
            }
            Odd::Stalls(_) | Odd::NeverArrives | Odd::EndsHalfWay { .. } => {
                self.real.start_move_at(&middle, m_per_s)?;
            }
            Odd::Times(times) => self.real.start_move_at(to, times * m_per_s)?,
            _ => self.real.start_move_at(to, m_per_s)?,
        }
        *self.slow.lock().unwrap() = Some((from, *to, self.clock.now().seconds(), false));
        while self.odd == Odd::Blocks && self.real.poll()? == Motion::Moving {
            self.clock.sleep(Duration::from_millis(5));
        }
        Ok(())
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        let motion = self.real.poll()?;
        let mut slow = self.slow.lock().unwrap();
        let Some((_, to, since, on)) = slow.as_mut().filter(|_| motion == Motion::Settled) else {
            return Ok(motion);
        };
        match self.odd {
            Odd::Stalls(s) if !*on => {
                if self.clock.now().seconds() - *since > s {
                    *on = true;
                    self.real.start_move_at(to, 1e-3)?;
                }
                Ok(Motion::Moving)
            }
            Odd::NeverArrives => Ok(Motion::Moving),
            Odd::EndsHalfWay {
                says_settled: false,
            } => Ok(Motion::Stopped),
            _ => {
                *slow = None;
                Ok(motion)
            }
        }
    }
    fn stop(&self) -> Result<(), ScopeError> {
        *self.slow.lock().unwrap() = None;
        self.real.stop()
    }
}

/// What is wrong with the time stamps of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stamp {
    True,
    /// Off by so many seconds.
    Off(f64),
    /// Off by so many seconds either way, in turn.
    Jumps(f64),
    /// Its clock goes so many times as fast.
    Fast(f64),
    /// Always the same.
    Stuck,
}

struct Stamps {
    real: Box<dyn Camera>,
    stamp: Stamp,
    grabs: AtomicU64,
}

impl Camera for Stamps {
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
        let mut frame = self.real.grab()?;
        let s = frame.exposure_start.seconds();
        let said = match self.stamp {
            Stamp::True => return Ok(frame),
            Stamp::Off(by) => s + by,
            Stamp::Jumps(by) => s + by * [1.0, -1.0][self.grabs.fetch_add(1, SeqCst) as usize % 2],
            Stamp::Fast(times) => s * times,
            Stamp::Stuck => 1.0,
        };
        frame.exposure_start = Timestamp::from_start(Duration::from_secs_f64(said.max(0.0)));
        Ok(frame)
    }
}

/// Hears what came of the sweep, and does something at its fourth frame.
struct Hears<'a> {
    in_motion: usize,
    sweep: Option<FocusSweep>,
    at_fourth: Box<dyn FnMut() + 'a>,
}

impl Sink for Hears<'_> {
    fn event(&mut self, stamped: Stamped) {
        match stamped.event {
            Event::FrameGrabbed { stage: None, .. } => {
                self.in_motion += 1;
                if self.in_motion == 4 {
                    (self.at_fourth)();
                }
            }
            Event::FocusSwept { sweep } => self.sweep = Some(sweep),
            _ => {}
        }
    }
    fn frame(&mut self, _: &Frame, _: FrameRole) {}
}

pub struct Bench {
    pub twin: Twin,
    pub scope: Instrument,
    pub cancel: CancelToken,
    heights: Arc<Mutex<Vec<f64>>>,
}

pub fn bench(config: Config, over: Arc<dyn Specimen>, odd: Odd, stamp: Stamp) -> Bench {
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let twin = Twin::new(config, over, 5, clock.clone()).unwrap();
    let cancel = CancelToken::new();
    let heights = Arc::new(Mutex::new(Vec::new()));
    let devices = Devices {
        stage: Some(Box::new(OddStage {
            real: twin.stage(),
            clock,
            odd,
            slow: Mutex::new(None),
            heights: heights.clone(),
        })),
        camera: Some(Box::new(Stamps {
            real: twin.camera(),
            stamp,
            grabs: AtomicU64::new(0),
        })),
        ..twin.devices()
    };
    let scope = Instrument::new(devices, twin.rules(), cancel.clone()).unwrap();
    twin.centre_specimen(PLACE_UM, 0.0);
    Bench {
        twin,
        scope,
        cancel,
        heights,
    }
}

/// The finest objective over a small image, noise of 1 % at mid grey and 4 um of play in z.
pub fn harsh() -> Config {
    let mut config = one_objective();
    (config.camera.width, config.camera.height) = (320, 240);
    config.camera.full_well_e = 0.5 / 1e-4;
    for axis in &mut config.stage.axes {
        if axis.axis == Axis::Z {
            axis.backlash = 4.0;
        }
    }
    config
}

/// A focus from so far off, um. What it says, what came of the sweep; positive z is nearer to the specimen.
pub fn focus_from(
    bench: &Bench,
    start_um: f64,
    at_fourth: impl FnMut(),
) -> (Result<FocusResult, ServoError>, Option<FocusSweep>, f64) {
    let z = || bench.scope.gate().position().unwrap().z.unwrap().um();
    for _ in 0..2 {
        let to = z() + start_um - bench.twin.truth_now().defocus_um;
        let to = StagePose::default().with_si(Axis::Z, to * 1e-6);
        bench.scope.move_to(&to).unwrap();
    }
    bench.scope.command_begins();
    let began = z();
    bench.heights.lock().unwrap().clear();
    let objective = bench.scope.gate().objectives()[0].clone();
    let options = FocusOptions {
        sweep: true,
        ..FocusOptions::default()
    };
    let nearest = began + options.nearest_um;
    let mut hears = Hears {
        in_motion: 0,
        sweep: None,
        at_fourth: Box::new(at_fourth),
    };
    let answer = run(
        &mut Focus::new(objective, options),
        &bench.scope,
        &mut hears,
    );
    let heights = bench.heights.lock().unwrap();
    assert!(heights.iter().all(|z| *z <= nearest + 0.1), "{nearest}");
    let sweep = hears.sweep;
    (answer, sweep, began)
}

/// It must be in focus to a quarter of the depth of field, which is 1.3 um.
pub fn is_right(bench: &Bench, answer: &Result<FocusResult, ServoError>, what: &str) {
    let off = bench.twin.truth_now().defocus_um;
    assert!(answer.is_ok(), "{what}: {answer:?}");
    assert!(off.abs() < 0.35, "{what}: {off} um, {answer:?}");
}

//! A coarse scan in motion: whatever goes wrong in it, the focus is right or a typed answer says why not, and the stage is not left nearer.

mod common;

use common::{PLACE_UM, one_objective};
use scopeservo_scope::{
    Axis, Camera, CameraInfo, CancelToken, Clock, Devices, Frame, Instrument, Motion, ScopeError,
    Stage, StageInfo, StagePose, Timestamp, VirtualClock,
};
use scopeservo_servo::{
    ErrorCode, Event, Focus, FocusOptions, FocusResult, FocusSweep, FrameRole, ServoError, Sink,
    Stamped, SweepEnd, run,
};
use scopeservo_twin::specimen::{Specimen, Tissue};
use scopeservo_twin::{Blank, Config, StageFault, Twin};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// What is odd about the stage in motion.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Odd {
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
            Odd::Stalls(_) | Odd::NeverArrives => self.real.start_move_at(&middle, m_per_s)?,
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

/// A camera whose time stamps are off.
struct Stamps {
    real: Box<dyn Camera>,
    off_s: f64,
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
        let said = (frame.exposure_start.seconds() + self.off_s).max(0.0);
        frame.exposure_start = Timestamp::from_start(Duration::from_secs_f64(said));
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

struct Bench {
    twin: Twin,
    scope: Instrument,
    cancel: CancelToken,
    heights: Arc<Mutex<Vec<f64>>>,
}

fn bench(config: Config, over: Arc<dyn Specimen>, odd: Odd, stamps_off_s: f64) -> Bench {
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
            off_s: stamps_off_s,
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
fn harsh() -> Config {
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
fn focus_from(
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
fn is_right(bench: &Bench, answer: &Result<FocusResult, ServoError>, what: &str) {
    let off = bench.twin.truth_now().defocus_um;
    assert!(answer.is_ok(), "{what}: {answer:?}");
    assert!(off.abs() < 0.35, "{what}: {off} um, {answer:?}");
}

#[test]
fn a_sweep_finds_where_to_look_on_either_side() {
    for start_um in [-170.0, -60.0, 90.0, 180.0] {
        let bench = bench(harsh(), Arc::new(Tissue::new(7)), Odd::Nothing, 0.0);
        let (answer, sweep, began) = focus_from(&bench, start_um, || {});
        is_right(&bench, &answer, &start_um.to_string());
        let sweep = sweep.unwrap();
        assert_eq!(sweep.end, SweepEnd::Found, "{start_um}: {sweep:?}");
        let off = sweep.near_um.unwrap() - (began - start_um);
        assert!(off.abs() < 12.0, "{start_um}: {off} um, {sweep:?}");
        // The far side alone where the focus lies there.
        let nearest = sweep.range_um[1] - began;
        assert_eq!(nearest > 1.0, start_um < 0.0, "{start_um}: {sweep:?}");
    }
}

#[test]
fn what_goes_wrong_in_a_sweep_costs_time_and_no_accuracy() {
    let tissue = || Arc::new(Tissue::new(7));
    for (odd, stamps_off_s, end) in [
        (Odd::Stalls(0.6), 0.0, SweepEnd::Found),
        (Odd::Silent, 0.0, SweepEnd::Unknown),
        (Odd::SaysGoal, 0.0, SweepEnd::Unknown),
        (Odd::SaysStart, 0.0, SweepEnd::Unknown),
        (Odd::Blocks, 0.0, SweepEnd::Unknown),
        (Odd::OneSpeed, 0.0, SweepEnd::Refused),
        (Odd::Nothing, 0.05, SweepEnd::Unknown),
        (Odd::Nothing, -0.05, SweepEnd::Unknown),
    ] {
        for start_um in [-110.0, 75.0] {
            let bench = bench(harsh(), tissue(), odd, stamps_off_s);
            let (answer, sweep, _) = focus_from(&bench, start_um, || {});
            let what = format!("{odd:?}, stamps {stamps_off_s} s, {start_um} um, {sweep:?}");
            is_right(&bench, &answer, &what);
            assert_eq!(sweep.unwrap().end, end, "{what}");
        }
    }
}

#[test]
fn frames_that_are_lost_or_late_in_a_sweep_cost_time_and_no_accuracy() {
    for fault in [
        StageFault::DropFrames(5),
        StageFault::LateFrames {
            count: 3,
            delay_s: 0.2,
        },
        StageFault::TornFrame,
    ] {
        for start_um in [-110.0, 75.0] {
            let bench = bench(harsh(), Arc::new(Tissue::new(7)), Odd::Nothing, 0.0);
            let (answer, sweep, _) = focus_from(&bench, start_um, || bench.twin.fault(fault));
            is_right(
                &bench,
                &answer,
                &format!("{fault:?}, {start_um}, {sweep:?}"),
            );
        }
    }
}

#[test]
fn a_camera_that_is_too_slow_for_a_sweep_has_none() {
    let mut config = harsh();
    config.camera.frames_per_s = 2.0;
    let bench = bench(config, Arc::new(Tissue::new(7)), Odd::Nothing, 0.0);
    let (answer, sweep, _) = focus_from(&bench, 75.0, || {});
    is_right(&bench, &answer, "two frames a second");
    let sweep = sweep.unwrap();
    assert_eq!((sweep.end, sweep.frames), (SweepEnd::NoFaster, 0));
}

#[test]
fn what_fails_in_a_sweep_is_told_and_leaves_the_stage_no_nearer() {
    let ended = |over: Arc<dyn Specimen>, odd, start_um: f64, fault: Option<StageFault>| {
        let bench = bench(harsh(), over, odd, 0.0);
        let (answer, ..) = focus_from(&bench, start_um, || {
            if let Some(fault) = fault {
                bench.twin.fault(fault);
            }
        });
        let is_nearer = bench.twin.truth_now().defocus_um > start_um + 0.5;
        assert!(!is_nearer, "{odd:?} {fault:?}: {answer:?}");
        answer.expect_err("it must not succeed").code()
    };
    let tissue = || Arc::new(Tissue::new(7));
    for start_um in [-60.0, 0.0, 60.0] {
        assert_eq!(
            ended(Arc::new(Blank), Odd::Nothing, start_um, None),
            ErrorCode::NoFocus
        );
    }
    for start_um in [-110.0, -60.0, 75.0] {
        let silent = Some(StageFault::SilentCamera(true));
        assert_eq!(
            ended(tissue(), Odd::Nothing, start_um, silent),
            ErrorCode::Fault
        );
        let pulled = Some(StageFault::Unplugged(true));
        assert_eq!(
            ended(tissue(), Odd::Nothing, start_um, pulled),
            ErrorCode::Fault
        );
        assert_eq!(
            ended(tissue(), Odd::NeverArrives, start_um, None),
            ErrorCode::Fault
        );
    }
}

#[test]
fn a_stop_in_a_sweep_stops_at_once() {
    for start_um in [-110.0, -60.0, 75.0] {
        let bench = bench(harsh(), Arc::new(Tissue::new(7)), Odd::Nothing, 0.0);
        let (answer, ..) = focus_from(&bench, start_um, || bench.cancel.cancel());
        let Err(ServoError::Scope(ScopeError::Interrupted { at: Some(at) })) = answer else {
            panic!("{answer:?}");
        };
        let here = bench.twin.stage().position().unwrap();
        assert_eq!(here.z, at.z, "it stands where it was stopped");
        assert_eq!(bench.twin.stage().poll().unwrap(), Motion::Stopped);
    }
}

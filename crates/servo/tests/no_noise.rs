//! A camera whose images of a stage at rest are the same to the last sample: it may have frozen, or have no noise, and a move tells.

mod common;

use common::{PLACE_UM, bench_over, one_objective, options};
use scopeservo_scope::{
    Axis, Camera, CameraInfo, CancelToken, Devices, Frame, Instrument, Samples, ScopeError,
    StagePose,
};
use scopeservo_servo::{
    Calibrate, Calibration, Event, NoSink, Outcome, Reason, Reposition, Target, Verdict,
    VisionOptions, run,
};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{StageConfig, StageFault, Truth, Twin};
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A camera that has noise until it is told that it has none any more: then a view at rest is one image.
struct Averages {
    real: Box<dyn Camera>,
    twin: Twin,
    alike: Arc<AtomicBool>,
    last: Mutex<Option<(StagePose, Samples)>>,
}

impl Camera for Averages {
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
        let at = self.twin.truth_now().stage;
        let mut last = self.last.lock().unwrap();
        match &*last {
            Some((place, samples)) if *place == at && self.alike.load(SeqCst) => {
                frame.samples = samples.clone();
            }
            _ => *last = Some((at, frame.samples.clone())),
        }
        Ok(frame)
    }
}

struct Bench {
    twin: Twin,
    scope: Instrument,
    alike: Arc<AtomicBool>,
    target: Target,
    truth: Truth,
}

fn bench() -> Bench {
    let config = one_objective().with_stage(StageConfig::xyz_theta());
    let usual = bench_over(config, Arc::new(Tissue::new(7)), Vec::new());
    let (target, truth) = usual.save();
    let twin = usual.twin;
    let alike = Arc::new(AtomicBool::new(false));
    let devices = Devices {
        camera: Some(Box::new(Averages {
            real: twin.camera(),
            twin: twin.clone(),
            alike: alike.clone(),
            last: Mutex::default(),
        })),
        ..twin.devices()
    };
    let scope = Instrument::new(devices, twin.rules(), CancelToken::new()).unwrap();
    Bench {
        twin,
        scope,
        alike,
        target,
        truth,
    }
}

fn calibration() -> Calibration {
    let bench = bench();
    let objective = bench.scope.gate().objectives()[0].clone();
    let mut calibrate = Calibrate::new(objective, options().calibrate, VisionOptions::default());
    run(&mut calibrate, &bench.scope, &mut NoSink).unwrap()
}

/// Comes back to the target; once a view has passed for the `nth` time something happens. Also how far it is off then, um.
fn come_back(known: &Calibration, nth: usize, happens: impl Fn(&Bench)) -> (Outcome, f64) {
    let bench = bench();
    bench.twin.remount(PLACE_UM, [38.0, -45.0], 5.0, false);
    let mut passed = 0;
    let mut sink = common::Listener(|event: &Event| {
        if let Event::Iteration {
            converged: true, ..
        } = event
        {
            passed += 1;
            if passed == nth {
                happens(&bench);
            }
        }
    });
    let known = [(known.objective.clone(), known.clone())];
    let mut reposition = Reposition::new(bench.target.clone(), options()).with_calibrations(known);
    let outcome = run(&mut reposition, &bench.scope, &mut sink).unwrap();
    let now = bench.twin.truth_now();
    let off = [0, 1].map(|k| now.centre_um[k] - bench.truth.centre_um[k]);
    (outcome, f64::hypot(off[0], off[1]))
}

/// Looks at rest, so that the camera is known to have noise.
fn is_known_to_have_noise(bench: &Bench) {
    bench.scope.gate().position().unwrap();
    for _ in 0..6 {
        let frame = bench.scope.grab().unwrap();
        bench.scope.check_new(&frame).unwrap();
    }
}

#[test]
fn a_camera_that_loses_its_noise_is_not_taken_for_one_that_froze() {
    let known = calibration();
    for nth in [1, 2] {
        let (outcome, off_um) = come_back(&known, nth, |bench| {
            is_known_to_have_noise(bench);
            bench.alike.store(true, SeqCst);
        });
        assert_eq!(
            outcome.verdict,
            Verdict::Arrived,
            "{nth}: {}",
            outcome.message
        );
        assert!(off_um < 1.2, "{nth}: {off_um} um");
    }
}

#[test]
fn one_that_froze_is_told_whatever_its_images_were_like_before() {
    let known = calibration();
    for pushed_um in [40.0, -7.0] {
        let (outcome, off_um) = come_back(&known, 1, |bench| {
            is_known_to_have_noise(bench);
            bench.twin.fault(StageFault::FrozenCamera(true));
            bench.twin.fault(StageFault::LostSteps {
                axis: Axis::X,
                si: pushed_um * 1e-6,
            });
        });
        let what = format!("{pushed_um}: {off_um} um, {}", outcome.message);
        assert_eq!(outcome.verdict, Verdict::Refused, "{what}");
        assert_eq!(outcome.reason, Reason::NothingMoves, "{what}");
        assert!(outcome.message.contains("frozen"), "{what}");
    }
}

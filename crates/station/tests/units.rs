//! A stage whose unit is wrong by a thousand agrees with itself in all that it reports: a calibration names it before a move goes far.

mod common;

use common::{PLACE_UM, Watched};
use scopeservo_scope::{
    Axis, CancelToken, Clock, Devices, Instrument, Motion, ScopeError, Stage, StageInfo, StagePose,
    VirtualClock,
};
use scopeservo_station::jobs::{CalibrateInput, CalibrateJob};
use scopeservo_station::{Parts, Session};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, Twin};
use std::sync::{Arc, Mutex};

/// Goes so many times as far in the plane as it says, and knows the farthest place, m.
struct OfOtherUnit {
    stage: Box<dyn Stage>,
    times: f64,
    farthest_m: Arc<Mutex<f64>>,
}

impl OfOtherUnit {
    fn scaled(&self, pose: &StagePose, times: f64) -> StagePose {
        let plane = [Axis::X, Axis::Y].into_iter();
        plane.fold(*pose, |to, axis| match pose.si(axis) {
            Some(si) => to.with_si(axis, si * times),
            None => to,
        })
    }
}

impl Stage for OfOtherUnit {
    fn info(&self) -> &StageInfo {
        self.stage.info()
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        Ok(self.scaled(&self.stage.position()?, 1.0 / self.times))
    }
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        let truly = self.scaled(to, self.times);
        for axis in [Axis::X, Axis::Y] {
            let mut farthest = self.farthest_m.lock().unwrap();
            *farthest = truly.si(axis).map_or(0.0, f64::abs).max(*farthest);
        }
        self.stage.start_move(&truly)
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        self.stage.poll()
    }
    fn stop(&self) -> Result<(), ScopeError> {
        self.stage.stop()
    }
}

/// What a calibration on such a stage comes to, and how far that went, um.
fn calibrated(times: f64) -> (Result<f64, String>, f64) {
    let mut config = Config::realistic();
    config.optics = config.optics.split_off(2);
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let twin = Twin::new(config, Arc::new(Tissue::new(7)), 5, clock).unwrap();
    let devices = twin.devices();
    let farthest_m = Arc::new(Mutex::new(0.0));
    let stage = devices.stage.map(|stage| {
        Box::new(OfOtherUnit {
            stage,
            times,
            farthest_m: farthest_m.clone(),
        }) as Box<dyn Stage>
    });
    let devices = Devices { stage, ..devices };
    let scope = Instrument::new(devices, twin.rules(), CancelToken::new()).unwrap();
    twin.centre_specimen(PLACE_UM, 0.0);
    let (journal, _hand) = Watched::new();
    let parts = Parts {
        journal,
        ..Parts::default()
    };
    let session = Session::new(Arc::new(scope), parts);
    let lease = session.take_lease("Ada", None).unwrap();
    let input = CalibrateInput {
        focus: None,
        ..CalibrateInput::default()
    };
    let job = CalibrateJob::new(input);
    let made = session.start(&lease, job).unwrap().wait();
    let made = made.map(|out| out.made[0].calibration.um_per_px());
    let farthest_um = *farthest_m.lock().unwrap() * 1e6;
    (made.map_err(|e| e.to_string()), farthest_um)
}

#[test]
fn a_unit_that_is_wrong_by_a_thousand_is_named_before_a_calibration_goes_far() {
    let (sound, _) = calibrated(1.0);
    assert!((sound.unwrap() / 0.508 - 1.0).abs() < 0.05);
    for times in [1e3, -1e3, 3e3] {
        let (said, went_um) = calibrated(times);
        let said = said.unwrap_err();
        assert!(said.contains("look at its unit"), "{times}: {said}");
        assert!(went_um < 200.0 * times.abs() / 1e3, "{times}: {went_um}");
    }
    for times in [1e-3, -1e-3, 1e-4] {
        let said = calibrated(times).0.unwrap_err();
        assert!(said.contains("at its unit"), "{times}: {said}");
    }
}

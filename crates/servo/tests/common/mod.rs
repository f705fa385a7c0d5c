//! A simulated microscope with one objective, and a sink that listens.

#![allow(
    dead_code,
    unreachable_pub,
    clippy::allow_attributes_without_reason,
    reason = "each test file uses its own part of this module"
)]

use scopeservo_scope::{
    Axis, AxisRange, CancelToken, Clock, Frame, Instrument, Limits, Rules, VirtualClock,
};
use scopeservo_servo::joint::PathOptions;
use scopeservo_servo::{
    CalibrateOptions, Event, Focus, FocusOptions, FrameRole, NoSink, Outcome, Procedure, Progress,
    Reposition, RepositionOptions, ServoError, ServoOptions, Sink, Stamped, Target, VisionOptions,
    run,
};
use scopeservo_twin::specimen::{Specimen, Tissue};
use scopeservo_twin::{Config, Truth, Twin};
use std::sync::Arc;

pub struct Bench {
    pub twin: Twin,
    pub scope: Instrument,
    pub cancel: CancelToken,
}

/// The realistic twin with its strongest objective alone: runs are one leg long.
pub fn one_objective() -> Config {
    let mut config = Config::realistic();
    config.optics = config.optics.split_off(2);
    config
}

pub fn bench_over(config: Config, specimen: Arc<dyn Specimen>, ranges: Vec<AxisRange>) -> Bench {
    bench_of(config, specimen, ranges, 5)
}

fn bench_of(
    config: Config,
    specimen: Arc<dyn Specimen>,
    ranges: Vec<AxisRange>,
    seed: u64,
) -> Bench {
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let twin = Twin::new(config, specimen, seed, clock).unwrap();
    let cancel = CancelToken::new();
    let rules = Rules {
        limits: Limits { ranges },
        ..twin.rules()
    };
    let scope = Instrument::new(twin.devices(), rules, cancel.clone()).unwrap();
    twin.centre_specimen(PLACE_UM, 0.0);
    Bench {
        twin,
        scope,
        cancel,
    }
}

pub fn bench(config: Config) -> Bench {
    bench_over(config, Arc::new(Tissue::new(7)), Vec::new())
}

/// The same with other mechanics and noise.
pub fn bench_seeded(config: Config, seed: u64) -> Bench {
    bench_of(config, Arc::new(Tissue::new(7)), Vec::new(), seed)
}

/// A place with tissue all over.
pub const PLACE_UM: [f64; 2] = [300.0, 100.0];

/// A quick law, and few views of a calibration: the tests are about where a run ends, both have studies.
pub fn options() -> RepositionOptions {
    RepositionOptions {
        calibrate: CalibrateOptions {
            path: PathOptions {
                most_views: 20,
                ..PathOptions::default()
            },
            ..CalibrateOptions::default()
        },
        servo: ServoOptions {
            lambda: 0.7,
            ..ServoOptions::default()
        },
        ..RepositionOptions::default()
    }
}

impl Bench {
    /// Focuses and saves the present view; also where it truly is.
    pub fn save(&self) -> (Target, Truth) {
        if self.scope.gate().info().axis(Axis::Z).is_some() {
            let objective = self.scope.gate().objectives()[0].clone();
            run(
                &mut Focus::new(objective, FocusOptions::default()),
                &self.scope,
                &mut NoSink,
            )
            .unwrap();
        }
        let target = Target::save(&self.scope, &VisionOptions::default(), &mut NoSink).unwrap();
        (target, self.twin.truth_now())
    }

    /// True distance (um) and angle (deg) of the present view from `target`.
    pub fn error_from(&self, target: &Truth) -> (f64, f64) {
        let now = self.twin.truth_now();
        let d = [0, 1].map(|k| now.centre_um[k] - target.centre_um[k]);
        let turn = (now.angle_deg - target.angle_deg + 180.0).rem_euclid(360.0) - 180.0;
        (f64::hypot(d[0], d[1]), turn.abs())
    }

    pub fn reposition(&self, target: Target) -> Result<Outcome, ServoError> {
        run(
            &mut Reposition::new(target, options()),
            &self.scope,
            &mut NoSink,
        )
    }
}

/// Steps a run, serialising and restoring it between all steps; its target is kept elsewhere.
pub fn run_through_json(target: Target, scope: &Instrument) -> Outcome {
    let target = std::sync::Arc::new(target);
    let mut machine = Reposition::new(target.clone(), options());
    loop {
        let stored = serde_json::to_string(&machine).unwrap();
        let restored: Reposition = serde_json::from_str(&stored).unwrap();
        machine = restored.with_target(target.clone());
        if let Progress::Done(outcome) = machine.step(scope, &mut NoSink).unwrap() {
            return outcome;
        }
    }
}

/// Keeps events and calls back on each.
pub struct Listener<F: FnMut(&Event)>(pub F);

impl<F: FnMut(&Event)> Sink for Listener<F> {
    fn event(&mut self, stamped: Stamped) {
        (self.0)(&stamped.event);
    }
    fn frame(&mut self, _: &Frame, _: FrameRole) {}
}

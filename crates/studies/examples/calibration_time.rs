//! What one joint calibration costs in computing, beyond the mechanics: the time in simulating frames is counted apart and taken off.
//!
//! `cargo run --release -p scopeservo-studies --example calibration_time -- --seeds 5 --threads 2`
//!
//! The camera of the simulated microscope is wrapped: what passes within it is the simulation's. On a real instrument frames come by themselves,
//! and moves take their time; what is left is what the calibration itself computes. Exit code 1 when the median of an objective exceeds `--at-most-s`.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

use clap::Parser;
use scopeservo_scope::{
    Axis, Camera, CameraInfo, CancelToken, Clock, Frame, Instrument, ScopeError, StagePose,
    VirtualClock,
};
use scopeservo_servo::{
    Calibrate, CalibrateOptions, Event, FrameRole, Sink, Stamped, VisionOptions, run,
};
use scopeservo_studies::quantile;
use scopeservo_studies::rounds::{Outcome, threads};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, Twin};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

/// The computing time of a joint calibration.
#[derive(Parser)]
struct Args {
    /// Calibrations of each objective, each over tissue and with noise of its own.
    #[arg(long, default_value_t = 5)]
    seeds: u64,
    /// Threads; all processors unless told.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// The median of an objective may be so long, s.
    #[arg(long, default_value_t = 3.0)]
    at_most_s: f64,
}

/// A camera that counts what its frames take.
struct Timed {
    real: Box<dyn Camera>,
    spent: Arc<Mutex<Spent>>,
}

impl Camera for Timed {
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
        let before = Spent::now();
        let frame = self.real.grab();
        let spent = Spent::now().since(&before);
        if let Ok(mut all) = self.spent.lock() {
            *all = all.plus(&spent);
        }
        frame
    }
}

/// By the clock on the wall, and of all threads on their processors where the system tells, s.
#[derive(Debug, Clone, Copy, Default)]
struct Spent {
    wall_s: f64,
    processor_s: f64,
}

impl Spent {
    fn now() -> Self {
        static BEGAN: OnceLock<Instant> = OnceLock::new();
        Self {
            wall_s: BEGAN.get_or_init(Instant::now).elapsed().as_secs_f64(),
            processor_s: processor_s(),
        }
    }
    fn since(&self, before: &Self) -> Self {
        Self {
            wall_s: self.wall_s - before.wall_s,
            processor_s: self.processor_s - before.processor_s,
        }
    }
    fn plus(&self, other: &Self) -> Self {
        Self {
            wall_s: self.wall_s + other.wall_s,
            processor_s: self.processor_s + other.processor_s,
        }
    }
}

/// What all threads of this process have run, by Linux; NaN elsewhere. Those of the pool do not end.
fn processor_s() -> f64 {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else {
        return f64::NAN;
    };
    let of = |task: std::fs::DirEntry| -> Option<f64> {
        let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse().ok()
    };
    tasks.flatten().filter_map(of).sum::<f64>() * 1e-9
}

#[derive(Default)]
struct Views(usize);

impl Sink for Views {
    fn event(&mut self, stamped: Stamped) {
        self.0 += usize::from(matches!(stamped.event, Event::CalibrationView { .. }));
    }
    fn frame(&mut self, _: &Frame, _: FrameRole) {}
}

/// One calibration.
struct Round {
    views: usize,
    instrument_s: f64,
    simulation: Spent,
    calibration: Spent,
}

fn round(objective: usize, seed: u64) -> Outcome<Round> {
    let mut config = Config::realistic();
    config.optics = vec![config.optics[objective].clone()];
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let twin = Twin::new(config, Arc::new(Tissue::new(seed)), seed, clock)?;
    let mut devices = twin.devices();
    let spent = Arc::new(Mutex::new(Spent::default()));
    let real = devices.camera.take().ok_or("the twin has a camera")?;
    devices.camera = Some(Box::new(Timed {
        real,
        spent: spent.clone(),
    }));
    let scope = Instrument::new(devices, twin.rules(), CancelToken::new())?;
    twin.centre_specimen([300.0, 100.0], 0.0);
    focus_by_the_truth(&twin, &scope)?;
    let objective = scope.gate().objectives()[0].clone();
    let mut calibrate = Calibrate::new(
        objective,
        CalibrateOptions::default(),
        VisionOptions::default(),
    );
    let mut views = Views::default();
    let (began_s, before) = (scope.clock().now().seconds(), Spent::now());
    run(&mut calibrate, &scope, &mut views)?;
    let all = Spent::now().since(&before);
    let simulation = *spent.lock().map_err(|e| e.to_string())?;
    Ok(Round {
        views: views.0,
        instrument_s: scope.clock().now().seconds() - began_s,
        simulation,
        calibration: all.since(&simulation),
    })
}

fn focus_by_the_truth(twin: &Twin, scope: &Instrument) -> Outcome<()> {
    if let Some(z) = scope.gate().position()?.si(Axis::Z) {
        let defocus_m = twin.truth_now().defocus_um * 1e-6;
        scope.move_to(&StagePose::default().with_si(Axis::Z, z - defocus_m))?;
    }
    Ok(())
}

fn main() -> Outcome<()> {
    let args = Args::parse();
    let threads = threads(args.threads)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()?;
    println!(
        "medians of {} calibrations on {threads} threads, s",
        args.seeds
    );
    println!(
        "| objective | views | on the instrument | calibration, wall | calibration, processors | calibration, most | simulating frames, wall | simulating, processors |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let mut slow = false;
    for (objective, name) in ["10x", "20x", "40x"].into_iter().enumerate() {
        let rounds = (0..args.seeds).map(|seed| pool.install(|| round(objective, seed + 1)));
        let rounds: Vec<Round> = rounds.collect::<Outcome<_>>()?;
        let all = |of: fn(&Round) -> f64| -> Vec<f64> { rounds.iter().map(of).collect() };
        let median = |of: fn(&Round) -> f64| quantile(&all(of), 0.5);
        let calibration_s = median(|r| r.calibration.wall_s);
        slow |= calibration_s > args.at_most_s;
        println!(
            "| {name} | {} | {:.1} | {calibration_s:.2} | {:.2} | {:.2} | {:.2} | {:.2} |",
            median(|r| r.views as f64),
            median(|r| r.instrument_s),
            median(|r| r.calibration.processor_s),
            quantile(&all(|r| r.calibration.wall_s), 1.0),
            median(|r| r.simulation.wall_s),
            median(|r| r.simulation.processor_s),
        );
    }
    if slow {
        std::process::exit(1);
    }
    Ok(())
}

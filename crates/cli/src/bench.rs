//! The demo's bench: a simulated microscope with a slide on it, the saving of the target, and the displacing of the slide.

use crate::answer::Answer;
use crate::args::{DemoArgs, Noise};
use crate::desk::rein_in;
use crate::error::CliError;
use crate::progress::Watcher;
use crate::scene::{self, Scene};
use scopeservo_scope::{CancelToken, Clock, Frame, Instrument, VirtualClock};
use scopeservo_servo::{
    Event, Focus, FocusOptions, FrameRole, NoSink, Reason, SaveOptions, SaveTarget, ServoError,
    Sink, Stamped, Target, VisionOptions,
};
use scopeservo_twin::specimen::{FileSpecimen, Specimen, Tissue};
use scopeservo_twin::{Config, Truth, Twin};
use std::sync::Arc;

/// The simulated bench: a microscope with the slide on it, and what only the simulation knows.
pub(crate) struct Bench {
    pub(crate) twin: Twin,
    pub(crate) scope: Arc<Instrument>,
    pub(crate) specimen: Arc<dyn Specimen>,
    pub(crate) scene: Scene,
}

impl Bench {
    /// The specimen that was asked for under a microscope that Ctrl-C stops.
    pub(crate) fn new(args: &DemoArgs, answer: &Answer) -> Result<Self, CliError> {
        let specimen: Arc<dyn Specimen> = match &args.specimen {
            Some(path) => Arc::new(FileSpecimen::open(path, args.um_per_px)?),
            None => Arc::new(Tissue::new(args.seed)),
        };
        let scene = scene::draw(&*specimen, args.seed, args.start_um, args.start_deg)?;
        let config = match args.noise {
            Noise::Default => Config::realistic(),
            Noise::None => Config::noiseless(),
        };
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
        let twin = Twin::new(config, specimen.clone(), args.seed, clock)?;
        let cancel = CancelToken::new();
        let reins = rein_in(&cancel, answer);
        let scope = Instrument::new(twin.devices(), twin.rules(), cancel)?;
        let scope = Arc::new(scope);
        reins.hold(&scope);
        Ok(Bench {
            twin,
            scope,
            specimen,
            scene,
        })
    }
}

/// Saves the target: the highest magnification, focused, over the scene's place. The inner error is that of a focus over
/// nothing: an answer, not a fault.
pub(crate) fn save_target(
    bench: &Bench,
    vision: &VisionOptions,
    watcher: &mut Watcher,
) -> Result<Result<(Target, Truth), ServoError>, CliError> {
    let scope = &*bench.scope;
    let best = scope
        .gate()
        .objectives()
        .iter()
        .max_by(|a, b| a.magnification.total_cmp(&b.magnification))
        .cloned()
        .ok_or_else(|| CliError::Internal("the simulated nosepiece is empty".into()))?;
    scope.select_objective(&best.id)?;
    bench.twin.centre_specimen(bench.scene.target_um, 0.0);
    let mut focus = Focus::new(best, FocusOptions::default());
    // The sweep before saving is not part of the run that the report tells of.
    match scopeservo_servo::run(&mut focus, scope, &mut NoSink) {
        Ok(_) => {}
        Err(error @ ServoError::NoFocus { .. }) => return Ok(Err(error)),
        Err(error) => return Err(error.into()),
    }
    let mut save = SaveTarget::new(SaveOptions {
        vision: vision.clone(),
        ..SaveOptions::default()
    });
    let mut sink = OnlyTheTarget {
        watcher,
        sequence: None,
    };
    let saved = scopeservo_servo::run(&mut save, scope, &mut sink);
    let sequence = sink.sequence;
    let target = match saved {
        Ok(target) => target,
        Err(error) if Reason::of(&error).is_some() => return Ok(Err(error)),
        Err(error) => return Err(error.into()),
    };
    let truth = sequence
        .and_then(|sequence| bench.twin.truth(sequence))
        .ok_or_else(|| CliError::Internal("the simulation forgot the target's pose".into()))?;
    Ok(Ok((target, truth)))
}

/// Of the saving, the report shows the target: the step aside is not part of the run that it tells of.
struct OnlyTheTarget<'a> {
    watcher: &'a mut Watcher,
    sequence: Option<u64>,
}

impl Sink for OnlyTheTarget<'_> {
    fn event(&mut self, stamped: Stamped) {
        if let Event::FrameGrabbed {
            role: FrameRole::Target,
            ..
        } = stamped.event
        {
            self.watcher.event(stamped);
        }
    }
    fn frame(&mut self, frame: &Frame, role: FrameRole) {
        if role == FrameRole::Target {
            self.sequence = Some(frame.sequence);
            self.watcher.frame(frame, role);
        }
    }
}

/// Puts the slide back so that the view's centre lies at `target + start_um`, the slide turned about the target.
pub(crate) fn displace(bench: &Bench) {
    let Scene {
        target_um,
        start_um,
        turn_deg,
    } = bench.scene;
    let (s, c) = turn_deg.to_radians().sin_cos();
    let shift_um = [
        -(c * start_um[0] - s * start_um[1]),
        -(s * start_um[0] + c * start_um[1]),
    ];
    bench.twin.remount(target_um, shift_um, turn_deg, false);
}

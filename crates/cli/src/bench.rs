//! The demo's bench: a simulated microscope at a station of its own, the saving of the target, and the displacing of the slide.

use crate::answer::Answer;
use crate::args::{DemoArgs, Noise};
use crate::console::{Console, hand_on};
use crate::error::CliError;
use crate::open_instrument::stop_on_interrupt;
use crate::progress::Watcher;
use crate::scene::{self, Scene};
use scopeservo_scope::{CancelToken, Clock, Instrument, ObjectiveId, VirtualClock};
use scopeservo_servo::{
    Event, FocusOptions, FrameRole, Progress, Reason, ServoError, Target, VisionOptions,
};
use scopeservo_station::jobs::{SaveTargetInput, SaveTargetJob, SaveTargetOutput};
use scopeservo_station::{JobError, MemoryJournal, News, UseCase, Work};
use scopeservo_twin::specimen::{FileSpecimen, Specimen, Tissue};
use scopeservo_twin::{Config, Truth, Twin};
use scopeservo_workbench::{Late, Told};
use serde::Serialize;
use std::sync::Arc;

/// The simulated bench: a microscope with the slide on it, and what only the simulation knows.
pub(crate) struct Bench {
    pub(crate) twin: Twin,
    pub(crate) scope: Arc<Instrument>,
    pub(crate) console: Console,
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
        let stop = stop_on_interrupt(&cancel, answer);
        let scope = Instrument::new(twin.devices(), twin.rules(), cancel)?;
        let scope = Arc::new(scope);
        stop.hold(&scope);
        // Nothing of it outlives the program. Each view may be kept, and none is left out.
        let journal = Arc::new(MemoryJournal::default());
        let console = Console::new(&scope, journal, Late::WaitedFor, |_| {})?;
        Ok(Bench {
            twin,
            scope,
            console,
            specimen,
            scene,
        })
    }
}

/// Brings an objective into the beam and does no more: the slide is laid under it.
#[derive(Serialize)]
struct Turn {
    to: ObjectiveId,
}

impl UseCase for Turn {
    type Output = ();

    fn kind(&self) -> &'static str {
        "turn"
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<()>, JobError> {
        work.scope().select_objective(&self.to)?;
        Ok(Progress::Done(()))
    }
}

/// Saves the target: the highest magnification, focused, over the scene's place. The inner error is that of a view with nothing to
/// save: an answer, not a fault.
pub(crate) fn save_target(
    bench: &Bench,
    vision: &VisionOptions,
    watcher: &mut Watcher,
) -> Result<Result<(Target, Truth), ServoError>, CliError> {
    let best = bench
        .scope
        .gate()
        .objectives()
        .iter()
        .max_by(|a, b| a.magnification.total_cmp(&b.magnification))
        .ok_or_else(|| CliError::Internal("the simulated nosepiece is empty".into()))?;
    let turn = Turn {
        to: best.id.clone(),
    };
    bench.console.follow(turn, |_| {})??;
    bench.twin.centre_specimen(bench.scene.target_um, 0.0);
    let save = SaveTargetJob::new(SaveTargetInput {
        focus: Some(FocusOptions::default()),
        vision: vision.clone(),
        ..SaveTargetInput::default()
    });
    // Of the saving, the report shows the target: the sweep and the step aside are not part of the run that it tells of.
    let saved = bench.console.follow(save, |told| {
        if is_of_the_target(&told) {
            hand_on(&told, watcher);
        }
    })?;
    let SaveTargetOutput { target, frame, .. } = match saved {
        Ok(saved) => saved,
        Err(CliError::Servo(error)) if Reason::of(&error).is_some() => return Ok(Err(error)),
        Err(error) => return Err(error),
    };
    let truth = frame.and_then(|frame| bench.twin.truth(frame.sequence));
    let truth = truth
        .ok_or_else(|| CliError::Internal("the simulation forgot the target's pose".into()))?;
    Ok(Ok((target, truth)))
}

fn is_of_the_target(told: &Told) -> bool {
    match told {
        Told::Frame(_, role) => *role == FrameRole::Target,
        Told::Event(record) => matches!(
            &record.news,
            News::Procedure(event) if matches!(
                &**event,
                Event::FrameGrabbed { role: FrameRole::Target, .. }
            )
        ),
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

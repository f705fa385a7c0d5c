//! One run, and what it came to. The truth only judges.

use crate::scene::{Bench, Scene};
use scopeservo_scope::{Frame, ObjectiveId, StagePose};
use scopeservo_servo::{
    Bring, Calibration, Event, FocusOptions, FrameRole, Phase, Reposition, RepositionOptions,
    SaveOptions, SaveTarget, ServoError, Sink, Stamped, Target, Verdict, VisionOptions,
    run as steps,
};
use scopeservo_studies::rounds::Outcome;
use scopeservo_twin::{Truth, Twin};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// What one run came to.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Record {
    pub(crate) index: u64,
    pub(crate) stage: String,
    pub(crate) specimen: String,
    pub(crate) begins_with: String,
    pub(crate) start_um: f64,
    pub(crate) turn_deg: f64,
    pub(crate) noise: f64,
    pub(crate) features: usize,
    /// The program's verdict, `refused_at_saving`, or `fault`.
    pub(crate) verdict: String,
    pub(crate) reason: String,
    pub(crate) message: String,
    /// Where the view really is from the target.
    pub(crate) true_um: f64,
    pub(crate) true_deg: f64,
    pub(crate) defocus_um: f64,
    pub(crate) claimed_um: Option<f64>,
    /// Goals that the law set: frames of the loop after which it moved.
    pub(crate) goals: usize,
    pub(crate) moves: u64,
    pub(crate) frames: u64,
    /// On the instrument's clock: all of it, and without the changes of objective.
    pub(crate) seconds: f64,
    pub(crate) seconds_unchanged: f64,
    /// What the loop saw, in order.
    #[serde(default)]
    pub(crate) path: Vec<Seen>,
}

/// One frame of the loop.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Seen {
    /// Since the run began.
    pub(crate) seconds: f64,
    pub(crate) objective: String,
    /// Where the view really was from the target.
    pub(crate) true_um: f64,
    pub(crate) true_deg: f64,
}

impl Record {
    /// A sure answer that is wrong.
    pub(crate) fn is_false(&self) -> bool {
        let claimed = self.claimed_um.unwrap_or(0.0);
        self.verdict == "arrived" && (self.true_um > 1.0 + claimed || self.true_deg > 0.05)
    }
}

/// Counts, and times the changes.
#[derive(Default)]
pub(crate) struct Watch<'a> {
    trace: bool,
    /// What judges, and what to come to.
    judge: Option<(&'a Twin, Truth)>,
    path: Vec<Seen>,
    goals: usize,
    last: Option<u64>,
    target: Option<u64>,
    change_began: Option<f64>,
    changing_s: f64,
}

impl<'a> Watch<'a> {
    /// Says what happens, where that is asked for, and how far off the last image truly was.
    pub(crate) fn of(trace: bool, twin: &'a Twin, aim: &Truth) -> Self {
        Self {
            trace,
            judge: Some((twin, aim.clone())),
            ..Self::default()
        }
    }
}

impl Sink for Watch<'_> {
    fn event(&mut self, stamped: Stamped) {
        if self.trace
            && !matches!(
                stamped.event,
                Event::FocusSample { .. } | Event::FrameGrabbed { .. }
            )
        {
            let mut text = format!("{:.2} {:?}", stamped.time_s, stamped.event);
            text.truncate(400);
            println!("{text}");
            if let (Some((twin, aim)), Some(last)) = (&self.judge, self.last)
                && let Some(truth) = twin.truth(last)
            {
                let (um, deg) = apart(aim, &truth);
                println!("     truly {um:.2} um, {deg:.4} deg");
            }
        }
        match stamped.event {
            Event::PhaseStarted { phase, .. } => {
                if let Some(began) = self.change_began.take() {
                    self.changing_s += stamped.time_s - began;
                }
                self.change_began = (phase == Phase::Switch).then_some(stamped.time_s);
            }
            Event::Iteration {
                converged,
                sequence,
                objective,
                ..
            } => {
                self.goals += usize::from(!converged);
                if let Some((twin, aim)) = &self.judge
                    && let Some(truth) = twin.truth(sequence)
                {
                    let (true_um, true_deg) = apart(aim, &truth);
                    self.path.push(Seen {
                        seconds: stamped.time_s,
                        objective: objective.0,
                        true_um,
                        true_deg,
                    });
                }
            }
            _ => {}
        }
    }
    fn frame(&mut self, frame: &Frame, role: FrameRole) {
        self.last = Some(frame.sequence);
        if role == FrameRole::Target {
            self.target = Some(frame.sequence);
        }
    }
}

pub(crate) fn word(value: &impl Serialize) -> Outcome<String> {
    Ok(serde_json::to_value(value)?
        .as_str()
        .unwrap_or_default()
        .into())
}

/// How far two views are apart, um and deg.
pub(crate) fn apart(a: &Truth, b: &Truth) -> (f64, f64) {
    let um = f64::hypot(
        a.centre_um[0] - b.centre_um[0],
        a.centre_um[1] - b.centre_um[1],
    );
    let turn = (a.angle_deg - b.angle_deg + 180.0).rem_euclid(360.0) - 180.0;
    (um, turn.abs())
}

/// A view was saved, and the slide was put back elsewhere.
pub(crate) struct Start {
    pub(crate) bench: Bench,
    pub(crate) target: Target,
    /// Where the target truly is.
    pub(crate) aim: Truth,
}

/// Brings an objective into focus.
fn bring(bench: &Bench, id: &str, watch: &mut Watch<'_>) -> Result<(), ServoError> {
    let focus = Some(FocusOptions::default());
    let id = ObjectiveId(id.into());
    let mut bring = Bring::new(id, focus, VisionOptions::default());
    steps(&mut bring, &bench.scope, watch).map(|_| ())
}

/// A camera is late by fewer images than these.
const LATEST: usize = 4;

/// A saved view.
#[derive(Clone)]
pub(crate) struct Saved {
    target: Target,
    aim: Truth,
    /// Where the stage stood.
    stood: StagePose,
}

impl Saved {
    /// The inner result has the reason why nothing was saved.
    fn of(scene: &Scene, bench: &Bench) -> Outcome<Result<Self, String>> {
        let mut watch = Watch::default();
        bench.twin.centre_specimen(scene.target_um, 0.0);
        for id in scene.focused_before {
            bring(bench, id, &mut watch)?;
        }
        let saved = bring(bench, scene.saved_with, &mut watch).and_then(|()| {
            let mut save = SaveTarget::new(SaveOptions::default());
            steps(&mut save, &bench.scope, &mut watch)
        });
        let target = match saved {
            Ok(target) => target,
            Err(refusal) => return Ok(Err(refusal.to_string())),
        };
        let aim = watch.target.and_then(|s| bench.twin.truth(s));
        let aim = aim.ok_or("the twin forgot the target")?;
        let stood = bench.scope.gate().position()?;
        Ok(Ok(Self { target, aim, stood }))
    }

    /// Puts the slide back elsewhere, on the instrument where it was saved.
    fn put_back(self, scene: &Scene, bench: Bench) -> Outcome<Start> {
        if scene.begins_with != scene.saved_with {
            bring(&bench, scene.begins_with, &mut Watch::default())?;
        }
        let [x, y] = scene.start_um;
        let (s, c) = scene.turn_deg.to_radians().sin_cos();
        let shift_um = [s * y - c * x, -s * x - c * y];
        bench
            .twin
            .remount(scene.target_um, shift_um, scene.turn_deg, false);
        let Self { target, aim, .. } = self;
        Ok(Start { bench, target, aim })
    }

    /// The same on another instrument of this kind, which is brought to where it was saved.
    pub(crate) fn put_on(self, scene: &Scene, bench: Bench) -> Outcome<Start> {
        bench.twin.centre_specimen(scene.target_um, 0.0);
        let objective = ObjectiveId(scene.saved_with.into());
        bench.scope.select_objective(&objective)?;
        bench.scope.move_to(&self.stood)?;
        // A camera that is late shows what it saw before.
        for _ in 0..LATEST {
            bench.scope.grab()?;
        }
        self.put_back(scene, bench)
    }
}

/// Saves, and puts the slide back elsewhere. The inner result has the reason why nothing was saved.
pub(crate) fn begin(scene: &Scene, bench: Bench) -> Outcome<Result<Start, String>> {
    Ok(match Saved::of(scene, &bench)? {
        Ok(saved) => Ok(saved.put_back(scene, bench)?),
        Err(refusal) => Err(refusal),
    })
}

/// Views that were saved, by the number of their scene: each is saved once, however many runs come back to it.
#[derive(Default)]
pub(crate) struct Saves(Mutex<BTreeMap<u64, Arc<Save>>>);

type Save = Mutex<Option<Result<Saved, String>>>;

impl Saves {
    /// The view of a scene. The inner result has the reason why nothing was saved.
    pub(crate) fn of(&self, number: u64, scene: &Scene) -> Outcome<Result<Saved, String>> {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let one = Arc::clone(all.entry(number).or_default());
        drop(all);
        let mut one = one.lock().unwrap_or_else(PoisonError::into_inner);
        if one.is_none() {
            let bench = Bench::new((scene.kind, scene.seed), scene.noise, scene.specimen()?.1)?;
            *one = Some(Saved::of(scene, &bench)?);
        }
        one.clone().ok_or_else(|| "nothing was saved".into())
    }
}

/// Saves, puts the slide back elsewhere, and comes back.
pub(crate) fn run(
    scene: &Scene,
    index: u64,
    known: Vec<(ObjectiveId, Calibration)>,
    options: RepositionOptions,
    trace: bool,
) -> Outcome<Record> {
    let (name, specimen) = scene.specimen()?;
    let bench = Bench::new((scene.kind, scene.seed), scene.noise, specimen)?;
    let mut record = Record {
        index,
        stage: format!("{:?}", scene.kind),
        specimen: name,
        begins_with: scene.begins_with.into(),
        start_um: f64::hypot(scene.start_um[0], scene.start_um[1]),
        turn_deg: scene.turn_deg,
        noise: scene.noise,
        ..Record::default()
    };
    let Start { bench, target, aim } = match begin(scene, bench)? {
        Ok(start) => start,
        Err(refusal) => {
            (record.verdict, record.message) = ("refused_at_saving".into(), refusal);
            return Ok(record);
        }
    };
    record.features = target.features.len();
    let mut watch = Watch {
        trace,
        judge: Some((&bench.twin, aim.clone())),
        ..Watch::default()
    };
    let before = (bench.scope.counters(), bench.scope.clock().now());
    let mut reposition = Reposition::new(target, options).with_calibrations(known);
    let answer = steps(&mut reposition, &bench.scope, &mut watch);
    let after = (bench.scope.counters(), bench.scope.clock().now());
    record.goals = watch.goals;
    record.moves = after.0.moves - before.0.moves;
    record.frames = after.0.frames - before.0.frames;
    record.seconds = after.1.seconds() - before.1.seconds();
    record.seconds_unchanged = record.seconds - watch.changing_s;
    record.path = std::mem::take(&mut watch.path);
    for seen in &mut record.path {
        seen.seconds -= before.1.seconds();
    }
    let truth = watch.last.and_then(|s| bench.twin.truth(s));
    let truth = truth.ok_or("the twin forgot a frame")?;
    (record.true_um, record.true_deg) = apart(&aim, &truth);
    record.defocus_um = truth.defocus_um;
    match answer {
        Ok(outcome) => {
            record.verdict = word(&outcome.verdict)?;
            record.reason = word(&outcome.reason)?;
            record.claimed_um = outcome.estimated_error_um;
            record.message = outcome.message;
            if outcome.verdict != Verdict::Arrived && trace {
                println!("{}", record.message);
            }
        }
        Err(fault) => (record.verdict, record.message) = ("fault".into(), fault.to_string()),
    }
    Ok(record)
}

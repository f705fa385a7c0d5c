//! One run through the library that the program uses, and what it came to. The truth only judges.

use crate::Outcome;
use crate::scene::{Instrument, Scene};
use scopeservo_scope::{
    Axis, CancelToken, Clock, Frame, Instrument as Scope, ObjectiveId, StagePose, VirtualClock,
};
use scopeservo_servo::{
    Calibrate, CalibrateOptions, Calibration, Event, FrameRole, NoSink, Reposition,
    RepositionOptions, SaveOptions, SaveTarget, ServoEnd, ServoError, Sink, Stamped, Target,
    VisionOptions, run,
};
use scopeservo_twin::{Truth, Twin, specimen::Specimen, specimen::Tissue};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// What one run came to.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Record {
    /// Groups the table.
    pub(crate) kind: String,
    /// What else there is to know of the scene.
    #[serde(default)]
    pub(crate) note: String,
    /// Which number it has in its family.
    pub(crate) index: u64,
    /// Whether something was fixed to the camera.
    pub(crate) faulty: bool,
    /// Of a lattice.
    pub(crate) pitch_px: Option<f64>,
    /// The program's verdict, or `refused_at_saving`, or `fault`.
    pub(crate) verdict: String,
    /// Its reason.
    pub(crate) reason: String,
    /// In words.
    pub(crate) message: String,
    /// Where the view really is from the target, um and degrees.
    pub(crate) true_um: Option<f64>,
    /// See there.
    pub(crate) true_deg: Option<f64>,
    /// How far it says it is.
    pub(crate) claimed_um: Option<f64>,
    /// Inliers at the end.
    pub(crate) inliers: Option<usize>,
    /// Of the run, without saving.
    pub(crate) moves: u64,
    /// Of the run, without saving.
    pub(crate) frames: u64,
    /// Of the run on the instrument's clock.
    pub(crate) seconds: f64,
    /// A sure answer that is wrong.
    pub(crate) wrong: bool,
}

impl Record {
    /// Of a scene that nothing was made of yet.
    pub(crate) fn of(scene: &Scene, index: u64) -> Self {
        Self {
            kind: scene.kind.clone(),
            note: scene.note(),
            index,
            faulty: true,
            pitch_px: scene.pitch_px,
            ..Self::default()
        }
    }
}

/// Calibrations of each instrument.
pub(crate) type Calibrations = HashMap<Instrument, Vec<(ObjectiveId, Calibration)>>;

/// Those of one, made once on tissue without anything fixed to the camera, and kept in the folder.
pub(crate) fn calibrations(
    instrument: Instrument,
    folder: &Path,
) -> Outcome<Vec<(ObjectiveId, Calibration)>> {
    let Instrument {
        seed,
        by_hand,
        objectives,
    } = instrument;
    let path = folder.join(format!("calibration-{seed}-{by_hand}-{objectives}.json"));
    if let Some(known) = crate::kept(&path)? {
        return Ok(known);
    }
    let made = calibrate(instrument)?;
    crate::keep(&path, &made)?;
    Ok(made)
}

fn calibrate(instrument: Instrument) -> Outcome<Vec<(ObjectiveId, Calibration)>> {
    let tissue = Arc::new(Tissue::new(instrument.seed));
    let bench = Bench::new(instrument.config(), tissue, instrument.seed)?;
    let mut all = Vec::new();
    for objective in bench.scope.gate().objectives() {
        bench.scope.select_objective(&objective.id)?;
        bench.focus_by_hand()?;
        let mut calibrate = Calibrate::new(
            objective.clone(),
            CalibrateOptions::default(),
            VisionOptions::default(),
        );
        let calibration = run(&mut calibrate, &bench.scope, &mut NoSink)?;
        all.push((objective.id.clone(), calibration));
    }
    Ok(all)
}

/// A microscope and its instrument.
pub(crate) struct Bench {
    pub(crate) twin: Twin,
    pub(crate) scope: Scope,
}

impl Bench {
    pub(crate) fn new(
        config: scopeservo_twin::Config,
        specimen: Arc<dyn Specimen>,
        seed: u64,
    ) -> Outcome<Self> {
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
        let twin = Twin::new(config, specimen, seed, clock)?;
        let scope = Scope::new(twin.devices(), twin.rules(), CancelToken::new())?;
        Ok(Self { twin, scope })
    }

    /// The scene's microscope, the view on the target.
    pub(crate) fn at_target(scene: &Scene, faulty: bool) -> Outcome<Self> {
        let mut config = scene.instrument.config();
        match &scene.fault {
            Some(fault) if faulty => fault.build_into(&mut config),
            Some(_) => {}
            None => config.camera.dust = vec![scopeservo_twin::DustConfig::default()],
        }
        let bench = Self::new(config, scene.specimen.make()?, scene.instrument.seed)?;
        if let (Some(fault), true) = (&scene.fault, faulty) {
            fault.save(&bench.twin)?;
        }
        bench.scope.select_objective(&ObjectiveId("40x".into()))?;
        bench.twin.centre_specimen(scene.target_um, 0.0);
        bench.focus_by_hand()?;
        Ok(bench)
    }

    /// The slide is taken out and put back.
    pub(crate) fn displace(&self, scene: &Scene, faulty: bool) -> Outcome<()> {
        if let (Some(fault), true) = (&scene.fault, faulty) {
            fault.come_back(&self.twin)?;
        }
        let [x, y] = scene.start_um;
        let (s, c) = scene.turn_deg.to_radians().sin_cos();
        let shift_um = [s * y - c * x, -s * x - c * y];
        self.twin
            .remount(scene.target_um, shift_um, scene.turn_deg, false);
        Ok(())
    }

    /// Somebody looks and turns the focus: not the program, which may find nothing to focus on.
    pub(crate) fn focus_by_hand(&self) -> Outcome<()> {
        if self.scope.gate().info().axis(Axis::Z).is_none() {
            return Ok(());
        }
        let z = self
            .scope
            .gate()
            .position()?
            .si(Axis::Z)
            .ok_or("the stage has no height")?;
        let defocus = self.twin.truth_now().defocus_um * 1e-6;
        self.scope
            .move_to(&StagePose::default().with_si(Axis::Z, z - defocus))?;
        Ok(())
    }
}

/// Remembers which frame was the last.
#[derive(Default)]
struct Last {
    sequence: Option<u64>,
    inliers: Option<usize>,
}

impl Sink for Last {
    fn event(&mut self, event: Stamped) {
        if let Event::Iteration { inliers, .. } = event.event {
            self.inliers = Some(inliers);
        }
    }
    fn frame(&mut self, frame: &Frame, _: FrameRole) {
        self.sequence = Some(frame.sequence);
    }
}

/// Saves the view as the program does. An error that is no fault is a refusal.
fn save(scope: &Scope, sink: &mut dyn Sink) -> Result<Target, ServoError> {
    run(&mut SaveTarget::new(SaveOptions::default()), scope, sink)
}

/// Saves, displaces, repositions, and compares with the truth.
pub(crate) fn whole(
    scene: &Scene,
    index: u64,
    faulty: bool,
    known: &[(ObjectiveId, Calibration)],
) -> Outcome<Record> {
    let mut record = Record {
        faulty,
        ..Record::of(scene, index)
    };
    let bench = Bench::at_target(scene, faulty)?;
    let mut last = Last::default();
    let aim = bench.twin.truth_now();
    let target = match save(&bench.scope, &mut last) {
        Ok(target) => target,
        Err(refusal) => {
            record.verdict = "refused_at_saving".into();
            record.message = refusal.to_string();
            return Ok(record);
        }
    };
    bench.displace(scene, faulty)?;
    let mut options = RepositionOptions::default();
    options.servo.lambda = 0.7;
    let before = (bench.scope.counters(), bench.scope.clock().now());
    let mut reposition = Reposition::new(target, options).with_calibrations(known.to_vec());
    let answer = run(&mut reposition, &bench.scope, &mut last);
    let after = (bench.scope.counters(), bench.scope.clock().now());
    record.moves = after.0.moves - before.0.moves;
    record.frames = after.0.frames - before.0.frames;
    record.seconds = after.1.seconds() - before.1.seconds();
    record.inliers = last.inliers;
    let truth = last
        .sequence
        .and_then(|s| bench.twin.truth(s))
        .ok_or("the twin forgot a frame")?;
    let (um, deg) = apart(&aim, &truth);
    (record.true_um, record.true_deg) = (Some(um), Some(deg));
    match answer {
        Ok(outcome) => {
            record.verdict = word(&outcome.verdict)?;
            record.reason = word(&outcome.reason)?;
            record.claimed_um = outcome.estimated_error_um;
            if let Some(ServoEnd::Lost(why)) = outcome.magnifications.last().map(|m| &m.end) {
                record.reason = format!("{} ({})", record.reason, code(why)?);
            }
            record.message = outcome.message;
        }
        Err(fault) => {
            record.verdict = "fault".into();
            record.message = fault.to_string();
        }
    }
    if record.verdict == "arrived" {
        let claimed = record.claimed_um.unwrap_or(0.0);
        // Two pixels of the target, or more than a micrometre beyond what is claimed.
        let allowed_um = (1.0 + claimed).min(2.0 * aim.um_per_px);
        record.wrong = um > allowed_um || deg > 0.05;
    }
    Ok(record)
}

/// How far two views are from each other on the specimen, um and degrees.
fn apart(a: &Truth, b: &Truth) -> (f64, f64) {
    let turn = (b.angle_deg - a.angle_deg + 180.0).rem_euclid(360.0) - 180.0;
    let [x, y] = [0, 1].map(|k| b.centre_um[k] - a.centre_um[k]);
    (x.hypot(y), turn.abs())
}

/// What a value is called in JSON.
pub(crate) fn word(value: &impl Serialize) -> Outcome<String> {
    let value = serde_json::to_value(value)?;
    Ok(value
        .as_str()
        .map_or_else(|| value.to_string(), str::to_owned))
}

/// The code of a reason that carries numbers.
pub(crate) fn code(value: &impl Serialize) -> Outcome<String> {
    let value = serde_json::to_value(value)?;
    Ok(value["code"].as_str().unwrap_or("?").to_owned())
}

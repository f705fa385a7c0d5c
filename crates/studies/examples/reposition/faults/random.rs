//! Runs in which one thing breaks at a random moment: while the stage moves, the nosepiece turns, a frame is exposed, or nothing does.
//!
//! Each scene is run whole once, which tells how long it takes; then, for each kind, again with the fault at a moment drawn evenly over that time. The clock
//! breaks it, so that no step of the run protects from it.

use super::any_time::{KINDS, Kind};
use crate::many::{EACH, Many, is_named};
use crate::scene::{Bench, Known, draw, of};
use crate::whole::{apart, begin, word};
use scopeservo_geometry::SplitMix64;
use scopeservo_scope::{Clock, Frame, StagePose, Timestamp, VirtualClock};
use scopeservo_servo::{
    Event, FrameRole, Reposition, RepositionOptions, Sink, Stamped, Verdict, run as steps,
};
use scopeservo_studies::rounds::{Outcome, rounds};
use scopeservo_twin::Twin;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// What a run came to.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Record {
    index: u64,
    kind: String,
    stage: String,
    /// When it broke, s from the beginning, and what was under way.
    at_s: f64,
    during: String,
    /// Frames that came afterwards.
    frames_after: usize,
    /// The verdict, `refused_at_saving`, or the code of the fault.
    verdict: String,
    reason: String,
    message: String,
    true_um: f64,
    true_deg: f64,
    claimed_um: Option<f64>,
    seconds: f64,
    /// How far the stage was beyond the rules, um or mdeg.
    outside: f64,
    /// The nearest to the specimen that the objective came, um beyond the focus.
    nearest_um: f64,
}

impl Record {
    fn arrived(&self) -> bool {
        self.verdict == "arrived"
    }

    /// A sure answer that is wrong. What happens after the last frame nobody can see.
    fn is_false(&self) -> bool {
        let claimed = self.claimed_um.unwrap_or(0.0);
        let off = self.true_um > 1.0 + claimed || self.true_deg > 0.05;
        self.arrived() && off && self.frames_after > 0
    }

    /// A sweep goes 200 um nearer than it began, and a stage slips by 20.
    fn is_outside(&self) -> bool {
        self.outside > 0.0 || self.nearest_um > 260.0
    }

    fn is_right(&self, kind: &Kind) -> bool {
        let as_it_must = self.arrived() || !kind.arrives;
        as_it_must && !self.is_false() && !self.is_outside() && self.verdict != "internal"
    }
}

/// Something that happens once.
type Once = Box<dyn FnOnce() + Send>;

/// A clock at a moment of which something happens, whoever waits then.
#[derive(Default)]
struct Breaking {
    real: VirtualClock,
    armed: Mutex<Option<(f64, Once)>>,
}

impl Breaking {
    fn arm(&self, at: Option<(f64, Once)>) {
        *self.armed.lock().unwrap_or_else(|e| e.into_inner()) = at;
    }

    fn due(&self, by_s: f64) -> Option<(f64, Once)> {
        let mut armed = self.armed.lock().unwrap_or_else(|e| e.into_inner());
        armed.take_if(|(at, _)| *at <= by_s)
    }
}

impl Clock for Breaking {
    fn now(&self) -> Timestamp {
        self.real.now()
    }
    fn sleep(&self, duration: Duration) {
        let until = self.now().after(duration);
        if let Some((at, breaks)) = self.due(until.seconds()) {
            let first = at - self.now().seconds();
            self.real.sleep(Duration::from_secs_f64(first.max(0.0)));
            breaks();
        }
        self.real.sleep(until.since(self.now()));
    }
}

/// What is under way, and where the stage was.
struct Watch<'a> {
    twin: &'a Twin,
    ranges: Vec<scopeservo_scope::AxisRange>,
    during: Arc<Mutex<String>>,
    broke: Arc<Mutex<Option<String>>>,
    frames_after: usize,
    outside: f64,
    nearest_um: f64,
    trace: bool,
}

impl Watch<'_> {
    fn stands(&mut self, at: &StagePose) {
        for range in &self.ranges {
            // As much as an arrival may miss.
            let slack = if range.axis.is_rotation() { 1e-3 } else { 1e-6 };
            let si = at.si(range.axis).unwrap_or(range.min);
            let beyond = (range.min - slack - si).max(si - range.max - slack);
            self.outside = self.outside.max(1e6 * beyond);
        }
        self.nearest_um = self.nearest_um.max(self.twin.truth_now().defocus_um);
    }
}

impl Sink for Watch<'_> {
    fn event(&mut self, stamped: Stamped) {
        let many = matches!(
            stamped.event,
            Event::FocusSample { .. } | Event::FrameGrabbed { .. }
        );
        if self.trace && !many {
            let mut text = format!("{:.2} {:?}", stamped.time_s, stamped.event);
            text.truncate(300);
            println!("{text}");
        }
        let now = match &stamped.event {
            Event::PhaseStarted { phase, .. } => Some(format!("{phase:?}").to_lowercase()),
            Event::FrameGrabbed { role, stage, .. } => {
                if let Some(at) = stage {
                    self.stands(at);
                }
                let broke = self.broke.lock().unwrap_or_else(|e| e.into_inner());
                self.frames_after += usize::from(broke.is_some());
                (*role == FrameRole::Aside).then(|| "evidence".into())
            }
            // Within the tolerance: what comes now makes sure.
            Event::Iteration { converged, .. } => {
                Some(if *converged { "evidence" } else { "servo" }.into())
            }
            _ => None,
        };
        if let Some(now) = now {
            *self.during.lock().unwrap_or_else(|e| e.into_inner()) = now;
        }
    }
    fn frame(&mut self, _: &Frame, _: FrameRole) {}
}

/// A run in which a kind breaks at a share of the time that the whole run takes.
fn run(
    (kind, index, share): (&Kind, u64, f64),
    whole_s: f64,
    known: &[Known],
    trace: bool,
) -> Outcome<Record> {
    let scene = draw(index % EACH);
    let (_, slide) = scene.specimen()?;
    let clock = Arc::new(Breaking::default());
    let bench = Bench::timed_by((scene.kind, scene.seed), scene.noise, slide, clock.clone())?;
    let mut record = Record {
        index,
        kind: kind.name.into(),
        stage: format!("{:?}", scene.kind),
        at_s: share * whole_s,
        ..Record::default()
    };
    let start = match begin(&scene, bench)? {
        Ok(start) => start,
        Err(refusal) => {
            (record.verdict, record.message) = ("refused_at_saving".into(), refusal);
            return Ok(record);
        }
    };
    let (scope, twin) = (&start.bench.scope, &start.bench.twin);
    let began = scope.clock().now().seconds();
    let (during, broke) = (Arc::<Mutex<String>>::default(), Arc::default());
    let mut watch = Watch {
        twin,
        ranges: scope.gate().ranges().to_vec(),
        during: during.clone(),
        broke: Arc::clone(&broke),
        frames_after: 0,
        outside: 0.0,
        nearest_um: twin.truth_now().defocus_um,
        trace,
    };
    let (broken, what, mut rng) = (twin.clone(), kind.what, SplitMix64::new(0xFA17 ^ index));
    let breaks: Once = Box::new(move || {
        what(&broken, &mut rng);
        let now = during.lock().unwrap_or_else(|e| e.into_inner()).clone();
        if trace {
            println!("it breaks during {now}");
        }
        *broke.lock().unwrap_or_else(|e| e.into_inner()) = Some(now);
    });
    clock.arm(Some((began + record.at_s, breaks)));
    let mut reposition = Reposition::new(start.target, RepositionOptions::default())
        .with_calibrations(of(known, &scene));
    let answer = steps(&mut reposition, scope, &mut watch);
    clock.arm(None);
    record.seconds = scope.clock().now().seconds() - began;
    if let Ok(at) = scope.gate().position() {
        watch.stands(&at);
    }
    record.during = {
        let broke = watch.broke.lock().unwrap_or_else(|e| e.into_inner());
        broke.clone().unwrap_or_default()
    };
    (record.frames_after, record.outside) = (watch.frames_after, watch.outside.max(0.0));
    record.nearest_um = watch.nearest_um;
    (record.true_um, record.true_deg) = apart(&start.aim, &twin.truth_now());
    match answer {
        Ok(answer) => {
            (record.verdict, record.reason) = (word(&answer.verdict)?, word(&answer.reason)?);
            record.claimed_um = (answer.verdict == Verdict::Arrived)
                .then_some(answer.estimated_error_um)
                .flatten();
            record.message = answer.message;
        }
        Err(fault) => {
            (record.verdict, record.message) = (word(&fault.code())?, fault.to_string());
        }
    }
    Ok(record)
}

/// Makes the runs and their table, with faults in the last part of each run that is this share of it; returns how many ended as none may.
pub(super) fn study(
    many: &Many<'_>,
    (when, last): (&str, f64),
    named: &[String],
    known: &[Known],
) -> Outcome<usize> {
    let whole = |k: u64| run((&KINDS[0], k, 2.0), 1e3, known, false);
    let even = |k: u64| SplitMix64::new(0x0AB0 ^ k.wrapping_mul(0x9E37_79B9_7F4A_7C15)).uniform();
    let moment = |k: u64| 1.0 - last * even(k);
    let kind = |k: u64| &KINDS[(k / EACH) as usize];
    if let Some(k) = many.only {
        let whole_s = whole(k % EACH)?.seconds;
        let record = run((kind(k), k, moment(k)), whole_s, known, true)?;
        println!("{}", serde_json::to_string_pretty(&record)?);
        return Ok(0);
    }
    let file = |name: &str| many.out.join(format!("faults-{when}-{name}.jsonl"));
    let scenes: Vec<u64> = (0..many.count).collect();
    let index = |r: &Record| r.index;
    let wholes = rounds(&file("whole"), &scenes, many.threads, index, whole)?;
    let saved = wholes.iter().filter(|r| r.verdict != "refused_at_saving");
    let lengths: BTreeMap<u64, f64> = saved.map(|r| (r.index, r.seconds)).collect();
    let asked = (1..KINDS.len()).filter(|k| is_named(KINDS[*k].name, named));
    let scenes: Vec<u64> = lengths.keys().copied().collect();
    let numbers: Vec<u64> = asked
        .flat_map(|k| scenes.iter().map(move |n| k as u64 * EACH + n))
        .collect();
    let records = rounds(&file("runs"), &numbers, many.threads, index, |k| {
        let whole_s = lengths.get(&(k % EACH)).copied().unwrap_or(0.0);
        run((kind(k), k, moment(k)), whole_s, known, false)
    })?;
    Ok(print(&wholes, &records))
}

/// Prints the table and what did not end as it is to; returns how many ended as none may.
fn print(wholes: &[Record], records: &[Record]) -> usize {
    println!(
        "| broken at a random moment | runs | broke before the end | arrived | faults told | other answers | wrong | outside | nearest um |\n|{}",
        "---|".repeat(9)
    );
    let mut not = 0;
    for kind in &KINDS {
        let all: Vec<&Record> = wholes.iter().chain(records).collect();
        let all: Vec<&Record> = all.into_iter().filter(|r| r.kind == kind.name).collect();
        if all.is_empty() {
            continue;
        }
        let count = |f: &dyn Fn(&Record) -> bool| all.iter().filter(|r| f(r)).count();
        let (arrived, faults) = (count(&Record::arrived), count(&|r| r.verdict == "fault"));
        let nearest = all.iter().map(|r| r.nearest_um).fold(f64::MIN, f64::max);
        println!(
            "| {} | {} | {} | {arrived} | {faults} | {} | {} | {} | {nearest:.0} |",
            kind.name,
            all.len(),
            count(&|r| !r.during.is_empty()),
            all.len() - arrived - faults,
            count(&Record::is_false),
            count(&Record::is_outside),
        );
        not += count(&|r| !r.is_right(kind));
    }
    let mut during: BTreeMap<&str, usize> = BTreeMap::new();
    for r in records.iter().filter(|r| !r.during.is_empty()) {
        *during.entry(&r.during).or_default() += 1;
    }
    println!("\nbroke during: {during:?}");
    for r in wholes.iter().chain(records) {
        let kind = KINDS.iter().find(|k| k.name == r.kind);
        if kind.is_some_and(|kind| !r.is_right(kind)) {
            println!(
                "{} {}, {} during {} at {:.2} of {:.2} s: {} {}, {:.1} um {:.3} deg off, {:.1} outside, nearest {:.0} um: {}",
                r.index,
                r.kind,
                r.stage,
                r.during,
                r.at_s,
                r.seconds,
                r.verdict,
                r.reason,
                r.true_um,
                r.true_deg,
                r.outside,
                r.nearest_um,
                r.message
            );
        }
    }
    not
}

//! One run, and what it said.

use super::kinds::{Ends, Kind, What, When};
use crate::scene::{Bench, Known, draw, of};
use crate::whole::{Saves, Start, apart, word};
use scopeservo_geometry::SplitMix64;
use scopeservo_scope::{Axis, AxisRange, CancelToken, Frame, Instrument, Limits, Rules, StagePose};
use scopeservo_servo::{
    Event, FrameRole, Outcome as Answer, Remark, Reposition, RepositionOptions, ServoEnd, Sink,
    Stamped, Verdict, run as steps,
};
use scopeservo_studies::rounds::Outcome;
use scopeservo_twin::Twin;
use serde::{Deserialize, Serialize};

/// What one run came to.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Record {
    pub(crate) index: u64,
    pub(crate) kind: String,
    pub(crate) stage: String,
    pub(crate) specimen: String,
    /// The program's verdict, `refused_at_saving`, or `fault`.
    pub(crate) verdict: String,
    pub(crate) reason: String,
    pub(crate) message: String,
    /// All that it called it.
    pub(crate) named: Vec<String>,
    pub(crate) named_rightly: bool,
    /// Whether it broke before the run ended.
    pub(crate) broke: bool,
    /// Moves of the loop since.
    pub(crate) moves: usize,
    /// How far the stage says it is from where the run began, um, and deg.
    pub(crate) from_start_um: f64,
    pub(crate) from_start_deg: f64,
    /// The farthest that it said it was.
    pub(crate) farthest_um: f64,
    /// Where the view really is from the target.
    pub(crate) true_um: f64,
    pub(crate) true_deg: f64,
    pub(crate) claimed_um: Option<f64>,
    pub(crate) seconds: f64,
}

/// A stage that came back lies within this of where it was, um and deg.
const BACK: (f64, f64) = (3.0, 0.02);

impl Record {
    pub(crate) fn arrived(&self) -> bool {
        self.verdict == "arrived"
    }

    /// A sure answer that is wrong.
    pub(crate) fn is_false(&self) -> bool {
        let claimed = self.claimed_um.unwrap_or(0.0);
        self.arrived() && (self.true_um > 1.0 + claimed || self.true_deg > 0.05)
    }

    pub(crate) fn is_back(&self) -> bool {
        self.from_start_um <= BACK.0 && self.from_start_deg <= BACK.1
    }

    /// Moves after the first one that was to show it.
    pub(crate) fn moves_after(&self) -> usize {
        self.moves.saturating_sub(1)
    }

    /// Whether it ended as it is to.
    pub(crate) fn is_right(&self, ends: Ends) -> bool {
        match ends {
            Ends::ToldAndBack => self.named_rightly && (self.arrived() || self.is_back()),
            Ends::Told => self.named_rightly,
            Ends::ArrivesAndTells => self.arrived() && self.named_rightly,
            Ends::Arrives => self.arrived(),
        }
    }
}

/// Breaks things, and counts.
struct Breaks<'a> {
    kind: &'a Kind,
    twin: &'a Twin,
    rng: SplitMix64,
    began: StagePose,
    trace: bool,
    broke: bool,
    last: Option<StagePose>,
    moves: usize,
    farthest_um: f64,
}

/// How far two places of the stage are apart, um in x and y, and deg.
fn between(a: &StagePose, b: &StagePose) -> (f64, f64) {
    let way = |axis| b.si(axis).unwrap_or(0.0) - a.si(axis).unwrap_or(0.0);
    (
        1e6 * f64::hypot(way(Axis::X), way(Axis::Y)),
        way(Axis::Rz).to_degrees().abs(),
    )
}

impl Breaks<'_> {
    fn breaks(&mut self) {
        if let What::Twin(what) = self.kind.what {
            what(self.twin, &mut self.rng);
        }
        self.broke = true;
    }
}

impl Sink for Breaks<'_> {
    fn event(&mut self, stamped: Stamped) {
        let many = matches!(
            stamped.event,
            Event::FocusSample { .. } | Event::FrameGrabbed { .. }
        );
        if self.trace && !many {
            let mut text = format!("{:.2} {:?}", stamped.time_s, stamped.event);
            text.truncate(500);
            println!("{text}");
        }
        match &stamped.event {
            Event::FrameGrabbed {
                role: FrameRole::Servo,
                stage: Some(at),
                ..
            } => {
                let moved = self.last.replace(*at).is_some_and(|before| {
                    let (um, deg) = between(&before, at);
                    um > 0.5 || deg > 0.01
                });
                self.moves += usize::from(moved && self.broke);
                self.farthest_um = self.farthest_um.max(between(&self.began, at).0);
            }
            Event::Iteration { .. }
                if self.kind.when == When::EachMove
                    || self.kind.when == When::Middle && !self.broke =>
            {
                self.breaks();
            }
            _ => {}
        }
    }
    fn frame(&mut self, _: &Frame, _: FrameRole) {}
}

/// Which of scale, angle and centre is off most, by what is to be expected of them.
fn drifted(scale: f64, deg: f64, mm: [f64; 2]) -> &'static str {
    let parts = [
        ("drifted scale", scale.abs() / 0.03),
        ("drifted angle", deg.abs() / 4.5),
        ("drifted centre", mm[0].hypot(mm[1]) / 4.6),
    ];
    let most = parts.into_iter().max_by(|a, b| a.1.total_cmp(&b.1));
    most.map_or("", |(name, _)| name)
}

/// All that an answer calls it.
fn names(answer: &Answer) -> Outcome<Vec<String>> {
    let mut names = vec![word(&answer.reason)?];
    if let Some(ServoEnd::Contradicted { why, .. }) = answer.magnifications.last().map(|m| &m.end) {
        names.push(format!("{why:?}"));
    }
    for remark in &answer.remarks {
        names.push(match remark {
            Remark::Drifted {
                scale,
                turned_deg,
                centre_mm,
                ..
            } => drifted(scale.value, turned_deg.value, centre_mm.map(|k| k.value)).into(),
            Remark::Beside {
                share_of_way: Some(share),
                ..
            } => format!("beside, {share:.2} of the way"),
            Remark::Beside { .. } => "beside".into(),
            Remark::Blurred { .. } => "blurred".into(),
            Remark::ScalesDisagree { .. } => "scales disagree".into(),
            Remark::Contradicted { why, .. } => format!("{why:?}"),
            Remark::Tried { attempt, .. } => format!("tried {attempt:?}"),
        });
    }
    if answer.message.contains("frozen") {
        names.push("frozen".into());
    }
    Ok(names)
}

/// The same microscope with limits that end before the target.
fn limited(start: &Start) -> Outcome<Instrument> {
    let twin = &start.bench.twin;
    let now = start.bench.scope.gate().position()?;
    let ranges = [Axis::X, Axis::Y].map(|axis| {
        let at = now.si(axis).unwrap_or(0.0);
        AxisRange {
            axis,
            min: at - 50e-6,
            max: at + 50e-6,
        }
    });
    let rules = Rules {
        limits: Limits {
            ranges: ranges.to_vec(),
        },
        ..twin.rules()
    };
    Ok(Instrument::new(twin.devices(), rules, CancelToken::new())?)
}

/// Puts the slide of a saved view back elsewhere, and comes back while something is broken.
pub(crate) fn run(
    kind: &Kind,
    index: u64,
    (number, saves): (u64, &Saves),
    known: &[Known],
    trace: bool,
) -> Outcome<Record> {
    let scene = draw(number);
    let (specimen, slide) = scene.specimen()?;
    let mut record = Record {
        index,
        kind: kind.name.into(),
        stage: format!("{:?}", scene.kind),
        specimen,
        ..Record::default()
    };
    let bench = Bench::new((scene.kind, scene.seed), scene.noise, slide)?;
    let start = match saves.of(number, &scene)? {
        Ok(saved) => saved.put_on(&scene, bench)?,
        Err(refusal) => {
            (record.verdict, record.message) = ("refused_at_saving".into(), refusal);
            return Ok(record);
        }
    };
    let limited = match kind.what {
        What::Limit => Some(limited(&start)?),
        _ => None,
    };
    let scope = limited.as_ref().unwrap_or(&start.bench.scope);
    let began = scope.gate().position()?;
    let mut breaks = Breaks {
        kind,
        twin: &start.bench.twin,
        rng: SplitMix64::new(0xFA17 ^ index),
        began,
        trace,
        broke: false,
        last: None,
        moves: 0,
        farthest_um: 0.0,
    };
    if kind.when == When::Start {
        breaks.breaks();
    }
    let known = of(known, &scene).into_iter().map(|(id, calibration)| {
        let calibration = match kind.what {
            What::Calibration(how) => how(&id, calibration),
            _ => calibration,
        };
        (id, calibration)
    });
    let mut reposition =
        Reposition::new(start.target, RepositionOptions::default()).with_calibrations(known);
    let clock = scope.clock().now().seconds();
    let answer = steps(&mut reposition, scope, &mut breaks);
    record.seconds = scope.clock().now().seconds() - clock;
    (record.broke, record.moves) = (breaks.broke, breaks.moves);
    record.farthest_um = breaks.farthest_um;
    let ends = scope.gate().position()?;
    (record.from_start_um, record.from_start_deg) = between(&began, &ends);
    let truth = start.bench.twin.truth_now();
    (record.true_um, record.true_deg) = apart(&start.aim, &truth);
    match answer {
        Ok(answer) => {
            (record.verdict, record.reason) = (word(&answer.verdict)?, word(&answer.reason)?);
            record.named = names(&answer)?;
            record.claimed_um = (answer.verdict == Verdict::Arrived)
                .then_some(answer.estimated_error_um)
                .flatten();
            record.message = answer.message;
        }
        Err(fault) => {
            (record.verdict, record.message) = ("fault".into(), fault.to_string());
            record.named = vec![record.message.clone()];
        }
    }
    let is = |name: &String| kind.right.iter().any(|right| name.contains(right));
    record.named_rightly = record.named.iter().any(is);
    Ok(record)
}

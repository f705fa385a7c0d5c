//! Runs whose view is disturbed after it was saved.

mod camera;
mod kinds;
mod table;

use crate::many::{EACH, Many, is_named};
use crate::scene::{Bench, Known, Scene, draw, of};
use crate::whole::{Start, Watch, apart, begin, word};
use camera::Disturbed;
use kinds::{AIMED_AT, ALONE, Kind, PAPER};
use scopeservo_geometry::SplitMix64;
use scopeservo_servo::{Reposition, RepositionOptions, Verdict, run as steps};
use scopeservo_studies::rounds::{Outcome, rounds};
use serde::{Deserialize, Serialize};
use std::fs;
use std::sync::{Arc, Mutex};

/// What one run came to.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Record {
    index: u64,
    disturbed: String,
    objective: String,
    stage: String,
    specimen: String,
    verdict: String,
    reason: String,
    message: String,
    true_um: f64,
    true_deg: f64,
    claimed_um: Option<f64>,
    seconds: f64,
}

impl Record {
    /// A sure answer that is wrong.
    fn is_false(&self) -> bool {
        let claimed = self.claimed_um.unwrap_or(0.0);
        self.verdict == "arrived" && (self.true_um > 1.0 + claimed || self.true_deg > 0.05)
    }
}

/// What is disturbed, and the target's objective.
struct Case {
    kinds: Vec<&'static Kind>,
    objective: &'static str,
    /// Whether a covering set has it: each way meets each objective.
    covers: bool,
}

impl Case {
    fn name(&self) -> String {
        let names: Vec<_> = self.kinds.iter().map(|k| k.name).collect();
        names.join(" and ")
    }
}

const OBJECTIVES: [&str; 3] = ["10x", "20x", "40x"];

fn cases(pairs: bool) -> Vec<Case> {
    let mut all: Vec<(Vec<&Kind>, usize)> = Vec::new();
    match pairs {
        false => all.extend(ALONE.iter().map(|k| (vec![k], 0))),
        true => {
            for (i, a) in ALONE.iter().enumerate().skip(1) {
                let others = ALONE.iter().enumerate().skip(i + 1);
                all.extend(others.map(|(j, b)| (vec![a, b], i + j)));
            }
        }
    }
    let mut cases = Vec::new();
    for (kinds, turn) in all {
        for (k, objective) in OBJECTIVES.into_iter().enumerate() {
            cases.push(Case {
                kinds: kinds.clone(),
                objective,
                covers: k == turn % 3,
            });
        }
    }
    if !pairs {
        cases.extend(PAPER.iter().map(|k| Case {
            kinds: vec![k],
            objective: "20x",
            covers: true,
        }));
        for kind in &AIMED_AT {
            cases.extend(OBJECTIVES.map(|objective| Case {
                kinds: vec![kind],
                objective,
                covers: true,
            }));
        }
    }
    cases
}

/// Makes the runs, their tables and their page; returns how many answers were wrong.
pub(crate) fn study(
    many: &Many<'_>,
    (pairs, covering, named): (bool, bool, &[String]),
    known: &[Known],
) -> Outcome<usize> {
    let cases = cases(pairs);
    let trace = many.only.is_some();
    let one = |index: u64| run(&cases[(index / EACH) as usize], index, known, trace);
    if let Some(index) = many.only {
        println!("{}", serde_json::to_string_pretty(&one(index)?)?);
        return Ok(0);
    }
    let asked = cases
        .iter()
        .enumerate()
        .filter(|(_, c)| c.covers || !covering)
        .filter(|(_, c)| is_named(&c.name(), named));
    let numbers = many.numbers(asked.map(|(k, _)| k));
    let name = if pairs {
        "disturbance-pairs"
    } else {
        "disturbance"
    };
    let file = |ending: &str| many.out.join(format!("{name}.{ending}"));
    let records = rounds(
        &file("jsonl"),
        &numbers,
        many.threads,
        |r: &Record| r.index,
        one,
    )?;
    fs::write(file("csv"), table::csv(&records))?;
    fs::write(file("html"), table::page(&records))?;
    Ok(table::print(&records))
}

/// The scene of a number, for a target of an objective.
fn scene(index: u64, objective: &'static str) -> Scene {
    let mut scene = draw(index);
    scene.saved_with = objective;
    if objective == "10x" {
        // Half of the view is still there.
        scene.start_um = scene.start_um.map(|v| 0.5 * v);
    }
    scene
}

fn run(case: &Case, index: u64, known: &[Known], trace: bool) -> Outcome<Record> {
    let scene = scene(index % EACH, case.objective);
    let (specimen, slide) = scene.specimen()?;
    let mut record = Record {
        index,
        disturbed: case.name(),
        objective: case.objective.into(),
        stage: format!("{:?}", scene.kind),
        specimen,
        ..Record::default()
    };
    let changes = Arc::new(Mutex::new(Vec::new()));
    let bench = Bench::seen_by((scene.kind, scene.seed), scene.noise, slide, |real| {
        let changes = changes.clone();
        Box::new(Disturbed { real, changes })
    })?;
    let Start { bench, target, aim } = match begin(&scene, bench)? {
        Ok(start) => start,
        Err(refusal) => {
            (record.verdict, record.message) = ("refused_at_saving".into(), refusal);
            return Ok(record);
        }
    };
    let mut rng = SplitMix64::new(0xD15 ^ index);
    let all = case.kinds.iter();
    let all: Vec<_> = all
        .flat_map(|k| (k.what)(&bench.twin, scene.target_um, &mut rng))
        .collect();
    *changes.lock().map_err(|e| e.to_string())? = all;
    let mut reposition =
        Reposition::new(target, RepositionOptions::default()).with_calibrations(of(known, &scene));
    let began = bench.scope.clock().now().seconds();
    let mut watch = Watch::of(trace, &bench.twin, &aim);
    let answer = steps(&mut reposition, &bench.scope, &mut watch);
    record.seconds = bench.scope.clock().now().seconds() - began;
    (record.true_um, record.true_deg) = apart(&aim, &bench.twin.truth_now());
    match answer {
        Ok(answer) => {
            (record.verdict, record.reason) = (word(&answer.verdict)?, word(&answer.reason)?);
            if answer.verdict == Verdict::Arrived {
                record.claimed_um = answer.estimated_error_um;
            }
            record.message = answer.message;
        }
        Err(fault) => (record.verdict, record.message) = ("fault".into(), fault.to_string()),
    }
    Ok(record)
}

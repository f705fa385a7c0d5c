//! Runs to a view that is not there: another slide lies under the objective, or the other section of a series, or a field beside, or blank glass, or the
//! slide lies upside down. None may arrive.

use crate::many::{EACH, Many, is_named};
use crate::scene::{Bench, Known, draw, of};
use crate::whole::{Start, Watch, apart, begin, word};
use scopeservo_geometry::SplitMix64;
use scopeservo_servo::{Reposition, RepositionOptions, run as steps};
use scopeservo_studies::page::Page;
use scopeservo_studies::rounds::{Outcome, rounds};
use scopeservo_twin::specimen::{Blank, FileSpecimen, Specimen};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::fs;
use std::path::Path;
use std::sync::Arc;

/// What lies there in place of the view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shown {
    OtherSlide,
    Serial,
    Beside,
    Blank,
    UpsideDown,
}

const EACH_SHOWN: [(Shown, &str); 5] = [
    (Shown::OtherSlide, "another slide"),
    (Shown::Serial, "the other section of a series"),
    (Shown::Beside, "a field beside"),
    (Shown::Blank, "blank glass"),
    (Shown::UpsideDown, "the slide upside down"),
];

/// Two sections that are alike to the eye. At their own scale they have no detail for 400x, so they are shown as if they were smaller, um per pixel.
const SERIES: [&str; 2] = ["olfactory_bulb_1.png", "olfactory_bulb_3.png"];
const SERIES_UM: [f64; 2] = [0.5, 1.0];
/// So far from the middle of the lowest view no part of the saved one is in it, um; nor much farther.
const BESIDE_UM: [f64; 2] = [850.0, 1300.0];

/// What one run came to.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Record {
    index: u64,
    shown: String,
    stage: String,
    saved: String,
    verdict: String,
    reason: String,
    message: String,
    /// From where the saved view truly is, um, where it is anywhere.
    true_um: Option<f64>,
    seconds: f64,
}

impl Record {
    /// Arrived at what is not the saved view.
    fn is_false(&self) -> bool {
        self.verdict == "arrived" && self.true_um.is_none_or(|um| um > 1.0)
    }
}

/// Makes the runs, their table and their page; returns how many answers were wrong.
pub(crate) fn study(many: &Many<'_>, named: &[String], known: &[Known]) -> Outcome<usize> {
    let one = |index: u64, trace: bool| run(index, known, trace);
    if let Some(index) = many.only {
        println!("{}", serde_json::to_string_pretty(&one(index, true)?)?);
        return Ok(0);
    }
    // Without slides there is no other one, and no series.
    let has_slides = std::env::var_os("SCOPESERVO_SPECIMENS").is_some();
    let asked = EACH_SHOWN.iter().enumerate().filter(|(_, (shown, name))| {
        is_named(name, named) && (has_slides || *shown != Shown::Serial)
    });
    let numbers = many.numbers(asked.map(|(k, _)| k));
    let path = many.out.join("elsewhere.jsonl");
    let records = rounds(
        &path,
        &numbers,
        many.threads,
        |r: &Record| r.index,
        |k| one(k, false),
    )?;
    fs::write(many.out.join("elsewhere.csv"), csv(&records))?;
    fs::write(many.out.join("elsewhere.html"), page(&records))?;
    Ok(print(&records))
}

fn series(folder: &Path, section: usize, um_per_px: f64) -> Outcome<Arc<dyn Specimen>> {
    let slide = FileSpecimen::open(&folder.join(SERIES[section]), Some(um_per_px))?;
    Ok(Arc::new(slide))
}

fn run(index: u64, known: &[Known], trace: bool) -> Outcome<Record> {
    let (shown, name) = EACH_SHOWN[(index / EACH) as usize];
    let mut scene = draw(index % EACH);
    let mut rng = SplitMix64::new(0xE15E ^ index);
    if shown == Shown::Beside {
        let [low, high] = BESIDE_UM;
        let (way, far) = (TAU * rng.uniform(), low + (high - low) * rng.uniform());
        scene.start_um = [far * way.cos(), far * way.sin()];
    }
    let folder = std::env::var_os("SCOPESERVO_SPECIMENS");
    let of_series = |section: usize| {
        let folder = folder.as_ref().ok_or("SCOPESERVO_SPECIMENS is not set")?;
        series(Path::new(folder), section, SERIES_UM[index as usize % 2])
    };
    let (saved, slide) = match shown {
        Shown::Serial => (SERIES[0].into(), of_series(0)?),
        _ => scene.specimen()?,
    };
    let mut record = Record {
        index,
        shown: name.into(),
        stage: format!("{:?}", scene.kind),
        saved,
        ..Record::default()
    };
    let bench = Bench::new((scene.kind, scene.seed), scene.noise, slide)?;
    let Start { bench, target, aim } = match begin(&scene, bench)? {
        Ok(start) => start,
        Err(refusal) => {
            (record.verdict, record.message) = ("refused_at_saving".into(), refusal);
            return Ok(record);
        }
    };
    match shown {
        Shown::OtherSlide => {
            let other = scene.another_specimen(rng.below(usize::MAX))?;
            bench.twin.replace_specimen(other);
        }
        Shown::Serial => {
            bench.twin.replace_specimen(of_series(1)?);
        }
        Shown::Beside => {}
        Shown::Blank => {
            bench.twin.replace_specimen(Arc::new(Blank));
        }
        Shown::UpsideDown => bench.twin.remount(scene.target_um, [0.0; 2], 0.0, true),
    }
    let options = RepositionOptions::default();
    let mut reposition = Reposition::new(target, options).with_calibrations(of(known, &scene));
    let began = bench.scope.clock().now().seconds();
    let mut watch = Watch::of(trace, &bench.twin, &aim);
    let answer = steps(&mut reposition, &bench.scope, &mut watch);
    record.seconds = bench.scope.clock().now().seconds() - began;
    let is_somewhere = shown == Shown::Beside;
    record.true_um = is_somewhere.then(|| apart(&aim, &bench.twin.truth_now()).0);
    match answer {
        Ok(answer) => {
            (record.verdict, record.reason) = (word(&answer.verdict)?, word(&answer.reason)?);
            record.message = answer.message;
        }
        Err(fault) => (record.verdict, record.message) = ("fault".into(), fault.to_string()),
    }
    Ok(record)
}

const HEAD: [&str; 8] = [
    "there lies",
    "runs",
    "arrived",
    "wrong",
    "not found",
    "ambiguous",
    "refused or a fault",
    "median s",
];

fn rows(records: &[Record]) -> Vec<Vec<String>> {
    let all = EACH_SHOWN.iter().map(|(_, name)| {
        let of: Vec<&Record> = records
            .iter()
            .filter(|r| r.shown == *name && r.verdict != "refused_at_saving")
            .collect();
        let count = |f: &dyn Fn(&&&Record) -> bool| of.iter().filter(f).count().to_string();
        let mut seconds: Vec<f64> = of.iter().map(|r| r.seconds).collect();
        seconds.sort_by(f64::total_cmp);
        let median = seconds.get(seconds.len() / 2).copied().unwrap_or(0.0);
        vec![
            (*name).into(),
            of.len().to_string(),
            count(&|r| r.verdict == "arrived"),
            count(&|r| r.is_false()),
            count(&|r| r.verdict == "not_found"),
            count(&|r| r.verdict == "ambiguous"),
            count(&|r| r.verdict == "refused" || r.verdict == "fault"),
            format!("{median:.1}"),
        ]
    });
    all.filter(|row| row[1] != "0").collect()
}

/// Prints the table and the wrong answers; returns how many there are.
fn print(records: &[Record]) -> usize {
    println!("| {} |\n|{}", HEAD.join(" | "), "---|".repeat(HEAD.len()));
    for row in rows(records) {
        println!("| {} |", row.join(" | "));
    }
    let refused = records.iter().filter(|r| r.verdict == "refused_at_saving");
    println!("{} refused when they were saved", refused.count());
    let wrong: Vec<&Record> = records.iter().filter(|r| r.is_false()).collect();
    for r in &wrong {
        println!("{} {} for {}: {}", r.index, r.shown, r.saved, r.message);
    }
    wrong.len()
}

fn csv(records: &[Record]) -> String {
    let line = |r: &Record| {
        format!(
            "{},{},{},{},{},{},{:.2}\n",
            r.index, r.shown, r.stage, r.saved, r.verdict, r.reason, r.seconds
        )
    };
    let lines: String = records.iter().map(line).collect();
    format!("index,shown,stage,saved,verdict,reason,seconds\n{lines}")
}

fn page(records: &[Record]) -> String {
    let mut page = Page::new("Runs to a view that is not there");
    page.table(&HEAD, &rows(records));
    let reasons: Vec<Vec<String>> = records
        .iter()
        .filter(|r| r.verdict != "refused_at_saving")
        .map(|r| {
            [
                &r.shown, &r.stage, &r.saved, &r.verdict, &r.reason, &r.message,
            ]
            .map(Clone::clone)
            .to_vec()
        })
        .collect();
    page.heading("Each run");
    page.table(
        &[
            "there lies",
            "stage",
            "saved on",
            "verdict",
            "reason",
            "told",
        ],
        &reasons,
    );
    page.finish()
}

//! What all runs came to, in Markdown.

use crate::run::Record;
use crate::scene::Family;
use std::collections::{BTreeMap, BTreeSet};

/// Pitch from which a disordered lattice is to be found, px.
const WIDE_PX: f64 = 62.0;

/// Prints one family's records; tells how many sure answers were wrong.
pub(crate) fn print(family: Family, objectives: usize, records: &[Record]) -> usize {
    println!("\n## {family:?}, {objectives} objective(s)\n");
    counts(records);
    reasons(records);
    match family {
        Family::Camera => camera_power(records),
        Family::Lattice => lattice_power(records),
        Family::Pairs => {}
    }
    let wrong: Vec<&Record> = records.iter().filter(|r| r.wrong).collect();
    for r in &wrong {
        let camera = if r.faulty { "" } else { ", camera clean" };
        let pitch = r
            .pitch_px
            .map_or(String::new(), |p| format!(", pitch {p:.1} px"));
        let note = if r.note.is_empty() {
            String::new()
        } else {
            format!(", {}", r.note)
        };
        println!(
            "WRONG {} {}{camera}{pitch}{note}: {} in truth, {} claimed, {} places",
            r.kind,
            r.index,
            place(r.true_um, r.true_deg),
            place(r.claimed_um, None),
            r.inliers.unwrap_or(0),
        );
    }
    wrong.len()
}

fn place(um: Option<f64>, deg: Option<f64>) -> String {
    let um = um.map_or("?".into(), |v| format!("{v:.3} um"));
    deg.map_or(um.clone(), |d| format!("{um} {d:.3} deg"))
}

fn sure(r: &Record) -> bool {
    r.verdict == "arrived" || r.verdict == "found"
}

fn counts(records: &[Record]) {
    let verdicts: BTreeSet<&str> = records.iter().map(|r| r.verdict.as_str()).collect();
    let list = verdicts.iter().copied().collect::<Vec<_>>();
    println!("| kind | camera | runs | {} | wrong |", list.join(" | "));
    println!("|---|---|---|{}---|", "---|".repeat(list.len()));
    let groups: BTreeSet<(&str, bool)> = records
        .iter()
        .map(|r| (r.kind.as_str(), r.faulty))
        .collect();
    let line = |name: &str, camera: &str, of: &[&Record]| {
        let each = list
            .iter()
            .map(|v| of.iter().filter(|r| r.verdict == *v).count().to_string());
        println!(
            "| {name} | {camera} | {} | {} | {} |",
            of.len(),
            each.collect::<Vec<_>>().join(" | "),
            of.iter().filter(|r| r.wrong).count()
        );
    };
    let camera = |faulty| if faulty { "as named" } else { "clean" };
    for (kind, faulty) in groups {
        let of: Vec<&Record> = records
            .iter()
            .filter(|r| r.kind == kind && r.faulty == faulty)
            .collect();
        line(kind, camera(faulty), &of);
    }
    for faulty in [false, true] {
        let of: Vec<&Record> = records.iter().filter(|r| r.faulty == faulty).collect();
        if !of.is_empty() {
            line("all", camera(faulty), &of);
        }
    }
}

fn reasons(records: &[Record]) {
    let mut all: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    for r in records.iter().filter(|r| !sure(r)) {
        let why = if r.reason.is_empty() {
            r.message.as_str()
        } else {
            r.reason.as_str()
        };
        *all.entry((&r.verdict, why)).or_default() += 1;
    }
    println!("\n| verdict | reason | runs |\n|---|---|---|");
    for ((verdict, reason), count) in all {
        println!("| {verdict} | {reason} | {count} |");
    }
    println!();
}

fn share(name: &str, good: usize, of: usize) {
    let percent = 100.0 * good as f64 / of.max(1) as f64;
    println!("{name}: {good} of {of} ({percent:.0} %)");
}

/// Of the targets that arrive with a clean camera, those that arrive with the fault, and what it costs them.
fn camera_power(records: &[Record]) {
    let clean: BTreeMap<u64, &Record> = records
        .iter()
        .filter(|r| !r.faulty && sure(r) && !r.wrong)
        .map(|r| (r.index, r))
        .collect();
    let pairs: Vec<(&Record, &Record)> = records
        .iter()
        .filter(|r| r.faulty)
        .filter_map(|r| Some((*clean.get(&r.index)?, r)))
        .collect();
    let faults: BTreeSet<&str> = pairs.iter().map(|(_, r)| fault_of(r)).collect();
    let arrives = |r: &Record| sure(r) && !r.wrong;
    for fault in faults {
        let of = || pairs.iter().filter(|(_, r)| fault_of(r) == fault);
        share(
            &format!("arrive with {fault} of those that arrive without"),
            of().filter(|(_, r)| arrives(r)).count(),
            of().count(),
        );
    }
    share(
        "arrive with a fault of those that arrive without",
        pairs.iter().filter(|(_, r)| arrives(r)).count(),
        pairs.len(),
    );
    let both: Vec<_> = pairs.iter().filter(|(_, r)| arrives(r)).collect();
    let mean = |of: &dyn Fn(&Record) -> f64| {
        let more = both.iter().map(|(clean, faulty)| of(faulty) - of(clean));
        more.sum::<f64>() / both.len().max(1) as f64
    };
    println!(
        "these take {:.2} moves, {:.2} frames and {:.2} s more than without",
        mean(&|r| r.moves as f64),
        mean(&|r| r.frames as f64),
        mean(&|r| r.seconds)
    );
}

fn fault_of(r: &Record) -> &str {
    r.kind.split_once(", ").map_or("?", |(_, fault)| fault)
}

/// Gratings apart: nothing tells where along its lines a view lies.
fn lattice_power(records: &[Record]) {
    for disorder in [0, 5] {
        for wide in [false, true] {
            let of: Vec<&Record> = records
                .iter()
                .filter(|r| !r.kind.starts_with("grating"))
                .filter(|r| r.kind.ends_with(&format!("disorder {disorder} %")))
                .filter(|r| r.pitch_px.is_some_and(|p| p >= WIDE_PX) == wide)
                .collect();
            let pitch = if wide { "from" } else { "below" };
            share(
                &format!(
                    "arrive, gratings apart, with {disorder} % disorder and a pitch {pitch} {WIDE_PX} px"
                ),
                of.iter().filter(|r| sure(r) && !r.wrong).count(),
                of.len(),
            );
        }
    }
}

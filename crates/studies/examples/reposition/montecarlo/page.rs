//! What the runs say: a table, a page and numbers for elsewhere.

use super::{Method, Run};
use crate::table::quantile;
use scopeservo_studies::page::{Page, Plot};
use std::fmt::Write as _;

const HEAD: [&str; 12] = [
    "specimen, method",
    "runs",
    "arrived",
    "wrong",
    "mean s without changes",
    "of the paper's law",
    "mean s",
    "goals: median, 95 %",
    "moves, median",
    "95 % µm",
    "95 % deg",
    "95 % defocus µm",
];

fn arrived<'a>(runs: &[&'a Run]) -> Vec<&'a Run> {
    let all = runs.iter().copied();
    all.filter(|r| r.record.verdict == "arrived").collect()
}

fn mean(runs: &[&Run], of: impl Fn(&Run) -> f64) -> f64 {
    runs.iter().map(|r| of(r)).sum::<f64>() / runs.len() as f64
}

/// How long the runs took beside those of the paper's law from the same starts: of pairs that both arrived.
fn of_the_papers(runs: &[&Run], all: &[Run]) -> f64 {
    let pairs = runs.iter().filter_map(|r| {
        let same = |p: &&Run| {
            p.method == Method::Paper
                && p.record.index == r.record.index
                && p.record.specimen == r.record.specimen
                && p.record.verdict == "arrived"
        };
        let paper = all.iter().find(same)?;
        Some((r.record.seconds_unchanged, paper.record.seconds_unchanged))
    });
    let (ours, papers) = pairs.fold((0.0, 0.0), |sum, p| (sum.0 + p.0, sum.1 + p.1));
    ours / papers
}

fn row(name: &str, runs: &[&Run], all: &[Run]) -> Vec<String> {
    let good = arrived(runs);
    let of = |f: fn(&Run) -> f64, share: f64| quantile(good.iter().map(|r| f(r)), share);
    vec![
        name.into(),
        runs.len().to_string(),
        good.len().to_string(),
        runs.iter()
            .filter(|r| r.record.is_false())
            .count()
            .to_string(),
        format!("{:.2}", mean(&good, |r| r.record.seconds_unchanged)),
        format!("{:.3}", of_the_papers(&good, all)),
        format!("{:.2}", mean(&good, |r| r.record.seconds)),
        format!(
            "{}, {}",
            of(|r| r.record.goals as f64, 0.5),
            of(|r| r.record.goals as f64, 0.95)
        ),
        of(|r| r.record.moves as f64, 0.5).to_string(),
        format!("{:.3}", of(|r| r.record.true_um, 0.95)),
        format!("{:.4}", of(|r| r.record.true_deg, 0.95)),
        format!("{:.2}", of(|r| r.record.defocus_um.abs(), 0.95)),
    ]
}

/// Their names, in order of the runs.
fn specimens(runs: &[Run]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for run in runs {
        if !names.contains(&run.record.specimen.as_str()) {
            names.push(&run.record.specimen);
        }
    }
    names
}

fn table(runs: &[Run]) -> Vec<Vec<String>> {
    let mut rows = Vec::new();
    let mut add = |name: String, keep: &dyn Fn(&Run) -> bool| {
        let kept: Vec<&Run> = runs.iter().filter(|r| keep(r)).collect();
        if !kept.is_empty() {
            rows.push(row(&name, &kept, runs));
        }
    };
    for method in Method::ALL {
        add(format!("all, {}", method.name()), &|r| r.method == method);
    }
    for begins in ["40x", "10x"] {
        for method in Method::ALL {
            add(format!("from {begins}, {}", method.name()), &|r| {
                r.method == method && r.record.begins_with == begins
            });
        }
    }
    for specimen in specimens(runs) {
        for method in Method::ALL {
            add(format!("{specimen}, {}", method.name()), &|r| {
                r.method == method && r.record.specimen == specimen
            });
        }
    }
    rows
}

/// Prints the table and what did not arrive; returns how many answers were wrong.
pub(crate) fn print(runs: &[Run]) -> usize {
    println!("| {} |\n|{}", HEAD.join(" | "), "---|".repeat(HEAD.len()));
    for row in table(runs) {
        println!("| {} |", row.join(" | "));
    }
    for run in runs {
        let r = &run.record;
        if r.verdict != "arrived" || r.is_false() {
            println!(
                "{} {} {}: {} {} {} ({:.2} um, {:.3} deg)",
                run.number,
                run.method.name(),
                r.specimen,
                r.verdict,
                r.reason,
                r.message,
                r.true_um,
                r.true_deg
            );
        }
    }
    runs.iter().filter(|r| r.record.is_false()).count()
}

/// Run by run.
pub(crate) fn csv(runs: &[Run]) -> String {
    let mut out = String::from(
        "number,method,specimen,repeat,begins_with,start_um,turn_deg,verdict,true_um,true_deg,defocus_um,goals,moves,frames,seconds,seconds_without_changes\n",
    );
    for run in runs {
        let r = &run.record;
        let _ = writeln!(
            out,
            "{},\"{}\",\"{}\",{},{},{},{},{},{},{},{},{},{},{},{},{}",
            run.number,
            run.method.name(),
            r.specimen,
            r.index,
            r.begins_with,
            r.start_um,
            r.turn_deg,
            r.verdict,
            r.true_um,
            r.true_deg,
            r.defocus_um,
            r.goals,
            r.moves,
            r.frames,
            r.seconds,
            r.seconds_unchanged
        );
    }
    out
}

/// The distance from the target over time, one line a run.
fn distances(runs: &[&Run]) -> Plot {
    let longest = runs.iter().map(|r| r.record.seconds).fold(1.0, f64::max);
    let mut plot = Plot::new(
        [0.0, longest],
        [-2.0, 3.0],
        "s since the run began",
        "log10 of the true distance, µm",
    );
    for run in runs {
        let path = run.record.path.iter();
        let points = path.map(|seen| (seen.seconds, seen.true_um.max(1e-9).log10()));
        plot.line(points, run.record.verdict == "arrived");
    }
    plot
}

/// The page.
pub(crate) fn page(runs: &[Run]) -> String {
    let mut page = Page::new("Coming back again and again: the paper's law and direct control");
    page.text(
        "As in the paper's repeated repositioning a view is saved at 400x, the slide is put back elsewhere, and the microscope comes back; focus and \
         calibrations are those of before. Every start is run by each method on the same simulated hexapod (10 mm/s, 100 ms to settle, 30 frames a \
         second, 2 s for a change of objective). Errors are the simulation's truth, which no method sees. The paper reports a mean of 30.7 s.",
    );
    page.table(&HEAD, &table(runs));
    page.heading("How the distance falls");
    page.text(
        "One line is one run, one corner one frame of the loop, whatever the objective; green lines arrived. The paper's law leaves four fifths of the \
         error at each step, at each of three magnifications; direct control takes the whole step.",
    );
    for specimen in specimens(runs) {
        page.heading(specimen);
        let plots = Method::ALL.map(|method| {
            let of = |r: &&Run| r.method == method && r.record.specimen == specimen;
            let kept: Vec<&Run> = runs.iter().filter(of).collect();
            (distances(&kept), method.name().to_owned())
        });
        page.plots(plots.into());
    }
    page.finish()
}

//! The rounds as a page: each against the truth, and what they say together.

use crate::instrument::Design;
use crate::record::Record;
use crate::table::{NAMES, PAPER_SD, mean};
use scopeservo_studies::page::{Page, Plot, around, wilson_95};
use std::collections::BTreeMap;

const NUMBERS: [&str; 6] = ["map 11", "map 12", "map 21", "map 22", "eta 1", "eta 2"];
/// Standard deviations that are drawn to either side.
const REACH: f64 = 4.5;

fn made(records: &[Record]) -> Vec<&Record> {
    records.iter().filter(|r| r.refused.is_none()).collect()
}

/// kx, ky (px/m) and phi (deg) of the paper's instrument, and no error of eta (mm), by objective.
fn paper_truth() -> BTreeMap<String, [f64; 5]> {
    let of = |k: u64| {
        let design = Design::of_paper(k);
        let optics = &design.config.optics[design.objective];
        let phi_deg = design.config.mount.phi_deg;
        (
            optics.id.0.clone(),
            [optics.kx_px_per_m, optics.ky_px_per_m, phi_deg, 0.0, 0.0],
        )
    };
    (0..3).map(of).collect()
}

/// The paper's Table II: each number of each round against the truth, and the methods beside each other.
pub(crate) fn of_paper(title: &str, method: &str, by_method: &[(String, Vec<Record>)]) -> String {
    let mut page = Page::new(title);
    page.text(
        "The paper's instrument over tissue, simulated, each round at a place and an angle of its own. A dot is one round less the truth, the bar its \
         stated standard deviation; red where the truth lies outside of 1.96 of these. The band is the paper's standard deviation.",
    );
    let truth = paper_truth();
    page.heading("The methods beside each other");
    page.table(
        &[
            "objective",
            "number",
            "method",
            "rounds",
            "mean off",
            "sd",
            "stated sd",
            "the paper's sd",
            "paper / ours",
        ],
        &beside_each_other(by_method, &truth),
    );
    let own = by_method.iter().find(|(name, _)| name == method);
    for (objective, paper) in PAPER_SD {
        let (Some((_, records)), Some(truth)) = (own, truth.get(objective)) else {
            continue;
        };
        let of: Vec<&Record> = made(records)
            .into_iter()
            .filter(|r| r.objective == objective)
            .collect();
        if of.is_empty() {
            continue;
        }
        page.heading(&format!("{objective}, {method}"));
        let plots = (0..5).map(|k| scatter(&of, k, truth[k], paper[k]));
        page.plots(plots.collect());
    }
    page.finish()
}

fn scatter(records: &[&Record], k: usize, truth: f64, paper_sd: f64) -> (Plot, String) {
    let rounds: Vec<(f64, f64)> = records
        .iter()
        .filter_map(|r| Some((r.reading?[k] - truth, r.stated?[k])))
        .collect();
    let reach = rounds.iter().map(|(off, sigma)| off.abs() + sigma);
    let count = rounds.len() as f64;
    let y = around(reach, 0.0);
    let mut plot = Plot::new([-1.0, count], y, "round", NAMES[k]);
    plot.band([-1.0, count], [-paper_sd, paper_sd]);
    for (n, (off, sigma)) in rounds.iter().enumerate() {
        let good = off.abs() < 1.96 * sigma;
        plot.upright(n as f64, [off - sigma, off + sigma], good);
        plot.dot(n as f64, *off, good);
    }
    let off = mean(rounds.iter().map(|r| r.0));
    let sd = (mean(rounds.iter().map(|r| (r.0 - off).powi(2))) * count / (count - 1.0)).sqrt();
    let caption = format!("less the truth: mean {off:.4}, sd {sd:.4}; the paper's sd {paper_sd}");
    (plot, caption)
}

fn beside_each_other(
    by_method: &[(String, Vec<Record>)],
    truth: &BTreeMap<String, [f64; 5]>,
) -> Vec<Vec<String>> {
    let mut rows = Vec::new();
    for (objective, paper) in PAPER_SD {
        for k in 0..5 {
            for (method, records) in by_method {
                let Some(truth) = truth.get(objective) else {
                    continue;
                };
                let of = made(records).into_iter();
                let of = of.filter(|r| r.objective == objective);
                let rounds: Vec<(f64, f64)> = of
                    .filter_map(|r| Some((r.reading?[k] - truth[k], r.stated?[k])))
                    .collect();
                if rounds.len() < 2 {
                    continue;
                }
                let n = rounds.len() as f64;
                let off = mean(rounds.iter().map(|r| r.0));
                let sd =
                    (rounds.iter().map(|r| (r.0 - off).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
                rows.push(vec![
                    objective.into(),
                    NAMES[k].into(),
                    method.clone(),
                    rounds.len().to_string(),
                    format!("{off:.5}"),
                    format!("{sd:.5}"),
                    format!("{:.5}", mean(rounds.iter().map(|r| r.1))),
                    paper[k].to_string(),
                    format!("{:.1}", paper[k] / sd),
                ]);
            }
        }
    }
    rows
}

/// Instruments of every kind: whether what is stated holds, by property, and every number of every round.
pub(crate) fn of_any(title: &str, records: &[Record]) -> String {
    let mut page = Page::new(title);
    let made = made(records);
    page.text(&format!(
        "{} instruments, {} calibrated. The share of 95 % intervals that hold the truth, with the interval in which it is itself known (Wilson, \
         95 %); the band is 92 to 98 %. Numbers of one round are counted as if they were independent, which they are not wholly.",
        records.len(),
        made.len()
    ));
    let groups = groups(&made);
    page.heading("Whether what is stated holds");
    page.plots(vec![
        (coverage(&groups, 0..4), "The map's four numbers.".into()),
        (coverage(&groups, 4..6), "The rotation centre's two.".into()),
    ]);
    let rows: Vec<Vec<String>> = groups
        .iter()
        .map(|(name, of)| {
            let mut row = vec![name.clone(), of.len().to_string()];
            for range in [0..4, 4..6] {
                let (hits, all) = hits(of, range);
                let [low, high] = wilson_95(hits, all);
                row.push(match all {
                    0 => "-".into(),
                    _ => format!(
                        "{:.1} ({:.1} to {:.1})",
                        100.0 * hits as f64 / all as f64,
                        100.0 * low,
                        100.0 * high
                    ),
                });
            }
            row
        })
        .collect();
    page.table(
        &["property", "calibrated", "map, % held", "centre, % held"],
        &rows,
    );
    page.heading("Every number of every round, in its standard deviations");
    let plots = NUMBERS.iter().enumerate().map(|(k, name)| {
        let mut plot = Plot::new(
            [-1.0, made.len() as f64],
            [-REACH, REACH],
            "instrument",
            name,
        );
        plot.band([-1.0, made.len() as f64], [-1.96, 1.96]);
        for (n, r) in made.iter().enumerate() {
            if let Some(pull) = r.pulls().get(k) {
                plot.dot(n as f64, *pull, pull.abs() < 1.96);
            }
        }
        (plot, format!("{name} less the truth, over its sigma"))
    });
    page.plots(plots.collect());
    let refused: Vec<Vec<String>> = records
        .iter()
        .filter_map(|r| {
            Some(vec![
                r.index.to_string(),
                r.design.clone(),
                r.refused.clone()?,
            ])
        })
        .collect();
    if !refused.is_empty() {
        page.heading("Not calibrated");
        page.table(&["round", "instrument", "why"], &refused);
    }
    page.finish()
}

/// By property, as the instrument's words and the objective tell it.
fn groups<'a>(made: &[&'a Record]) -> BTreeMap<String, Vec<&'a Record>> {
    let mut groups: BTreeMap<String, Vec<&Record>> = BTreeMap::new();
    for r in made {
        let mut of: Vec<String> = r.design.split(", ").map(str::to_owned).collect();
        // Every angle is another; what counts is whether the image is mirrored.
        of.retain(|word| !word.ends_with(" deg"));
        let mirrored = of.iter().any(|word| word == "mirrored");
        of.extend((!mirrored).then(|| "not mirrored".to_owned()));
        of.extend([format!("at {}", r.objective), "all".to_owned()]);
        for name in of {
            groups.entry(name).or_default().push(r);
        }
    }
    groups
}

/// How many intervals of 95 % hold the truth, of how many.
fn hits(records: &[&Record], range: std::ops::Range<usize>) -> (usize, usize) {
    let pulls = records
        .iter()
        .flat_map(|r| r.pulls().into_iter().enumerate());
    let of: Vec<f64> = pulls
        .filter(|(k, _)| range.contains(k))
        .map(|(_, p)| p)
        .collect();
    (of.iter().filter(|p| p.abs() < 1.96).count(), of.len())
}

fn coverage(groups: &BTreeMap<String, Vec<&Record>>, range: std::ops::Range<usize>) -> Plot {
    let rows = groups.len() as f64;
    let mut plot = Plot::rows(
        [60.0, 100.0],
        groups.len(),
        "% of intervals that hold the truth",
    );
    plot.band([92.0, 98.0], [-1.0, rows]);
    for v in [70.0, 80.0, 90.0, 95.0, 100.0] {
        plot.x_tick(v, &format!("{v:.0}"));
    }
    for (k, (name, of)) in groups.iter().rev().enumerate() {
        let (hits, all) = hits(of, range.clone());
        let short = name
            .replace("simulated ", "")
            .replace("repeatability", "scatter");
        plot.y_tick(k as f64, &short);
        if all > 0 {
            let interval = wilson_95(hits, all).map(|v| 100.0 * v);
            let good = interval[0] <= 95.0 && interval[1] >= 95.0;
            plot.across(k as f64, interval, good);
            plot.dot(100.0 * hits as f64 / all as f64, k as f64, good);
        }
    }
    plot
}

/// The records of one study by every method of which there are any beside this one's.
pub(crate) fn methods_at_hand(
    folder: &std::path::Path,
    study: &str,
    own: (&str, &[Record]),
) -> Vec<(String, Vec<Record>)> {
    let mut all = Vec::new();
    for method in ["joint", "two-step", "grid"] {
        if method == own.0 {
            all.push((method.to_owned(), own.1.to_vec()));
            continue;
        }
        let path = folder.join(format!("{study}-{method}.jsonl"));
        let lines = std::fs::read_to_string(path).unwrap_or_default();
        let records: Vec<Record> = lines
            .lines()
            .filter_map(|line| serde_json::from_str(line).ok())
            .collect();
        if !records.is_empty() {
            all.push((method.to_owned(), records));
        }
    }
    all
}

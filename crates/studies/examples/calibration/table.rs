//! What the records say.

use crate::record::Record;
use scopeservo_studies::quantile;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Table II: standard deviations of kx, ky (px/m), phi (deg), eta (mm) at 100x, 200x, 400x.
pub(crate) const PAPER_SD: [(&str, [f64; 5]); 3] = [
    ("10x", [367.0, 414.0, 0.0198, 0.1072, 0.0511]),
    ("20x", [1351.0, 822.0, 0.0401, 0.1570, 0.1355]),
    ("40x", [3047.0, 2908.0, 0.0597, 0.2071, 0.1683]),
];
pub(crate) const NAMES: [&str; 5] = [
    "kx px/m",
    "ky px/m",
    "phi deg",
    "eta1 off mm",
    "eta2 off mm",
];

/// The reading, its error and its standard deviations, from the map's.
fn readings(records: &[&Record]) -> Vec<[f64; 5]> {
    records.iter().filter_map(|r| r.reading).collect()
}

pub(crate) fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    values.clone().sum::<f64>() / values.count().max(1) as f64
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    quantile(&values.collect::<Vec<_>>(), 0.5)
}

/// The table of the paper's instrument; whether anything is wrong.
pub(crate) fn of_paper(records: &[Record]) -> bool {
    println!("| objective | | mean | sd | relative | stated sd | the paper's sd | ratio | views |");
    println!("|---|---|---|---|---|---|---|---|---|");
    for (name, paper) in PAPER_SD {
        let of: Vec<&Record> = records
            .iter()
            .filter(|r| r.objective == name && r.refused.is_none())
            .collect();
        if of.is_empty() {
            continue;
        }
        let values = readings(&of);
        let n = values.len() as f64;
        for k in 0..5 {
            let mean_k = mean(values.iter().map(|v| v[k]));
            let sd =
                (values.iter().map(|v| (v[k] - mean_k).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
            let said = median(of.iter().filter_map(|r| Some(r.stated?[k])));
            let relative = match k {
                0 | 1 => format!("{:.4} %", 100.0 * sd / mean_k.abs()),
                _ => "-".into(),
            };
            println!(
                "| {name} | {} | {mean_k:.5} | {sd:.5} | {relative} | {said:.5} | {} | {:.1} | {} |",
                NAMES[k],
                paper[k],
                paper[k] / sd,
                median(of.iter().map(|r| r.views as f64))
            );
        }
    }
    println!();
    within(records)
}

/// The table of instruments of every kind; whether anything is wrong.
pub(crate) fn of_any(records: &[Record]) -> bool {
    let failed = within(records);
    by_number(records);
    failed
}

/// Number by number: how many 95 % intervals hold the truth, and the root mean square of how far off they are, in standard deviations.
fn by_number(records: &[Record]) {
    println!("\n| number | of | 95 % hold the truth | rms of pulls | beyond 3 |");
    println!("|---|---|---|---|---|");
    let pulls: Vec<Vec<f64>> = records.iter().map(Record::pulls).collect();
    for (k, name) in ["m11", "m12", "m21", "m22", "centre x", "centre y"]
        .into_iter()
        .enumerate()
    {
        let of: Vec<f64> = pulls.iter().filter_map(|p| p.get(k).copied()).collect();
        let count = |limit: f64| of.iter().filter(|p| p.abs() < limit).count();
        println!(
            "| {name} | {} | {:.1} | {:.3} | {} |",
            of.len(),
            100.0 * count(1.96) as f64 / of.len().max(1) as f64,
            mean(of.iter().map(|p| p * p)).sqrt(),
            of.len() - count(3.0)
        );
    }
}

/// One number of 30 000 is farther off than this, in its standard deviations.
const WRONG: f64 = 4.2;

/// Whether any instrument was not calibrated, or a number of it is not what it says.
pub(crate) fn any_wrong(records: &[Record]) -> bool {
    let farthest = |r: &Record| r.pulls().into_iter().fold(0.0, |m: f64, p| m.max(p.abs()));
    let wrong: Vec<&Record> = records
        .iter()
        .filter(|r| r.refused.is_some() || farthest(r) > WRONG)
        .collect();
    for r in &wrong {
        println!("wrong {}: {}: {:.1} sigmas", r.index, r.design, farthest(r));
    }
    !wrong.is_empty()
}

const CHI_95: [(usize, f64); 2] = [(4, 9.488), (6, 12.592)];

/// By groups: how many were calibrated, the shares of 95 % intervals that hold the truth, bias over its standard deviation.
fn within(records: &[Record]) -> bool {
    let mut groups: BTreeMap<String, Vec<&Record>> = BTreeMap::new();
    for r in records {
        groups
            .entry(format!("play {} um", r.play_um))
            .or_default()
            .push(r);
        groups
            .entry(format!("with {}", r.objective))
            .or_default()
            .push(r);
        groups.entry("all".into()).or_default().push(r);
    }
    println!(
        "| group | rounds | calibrated | 95 % hold the map | the centre | all jointly | the play | arrivals | mean pulls | views | moves | on the instrument s | computing s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    let mut failed = false;
    for (name, all) in &groups {
        let made: Vec<&&Record> = all.iter().filter(|r| r.refused.is_none()).collect();
        let pulls = |range: std::ops::Range<usize>| -> Vec<f64> {
            let of = made.iter().flat_map(|r| r.pulls().into_iter().enumerate());
            of.filter(|(k, _)| range.contains(k))
                .map(|(_, p)| p)
                .collect()
        };
        let share =
            |pulls: &[f64]| 100.0 * mean(pulls.iter().map(|p| f64::from(u8::from(p.abs() < 1.96))));
        let jointly = made.iter().map(|r| {
            let limit = CHI_95
                .iter()
                .find(|(n, _)| *n == r.off.len())
                .map_or(0.0, |c| c.1);
            f64::from(u8::from(r.distance_sq().is_some_and(|d| d < limit)))
        });
        let play: Vec<f64> = made
            .iter()
            .filter_map(|r| r.backlash_off_um)
            .flat_map(|[off, sigma]| [off[0] / sigma[0], off[1] / sigma[1]])
            .collect();
        let arrivals: Vec<f64> = made
            .iter()
            .flat_map(|r| &r.arrivals_um)
            .flat_map(|[x, y, xx, _, yy]| [x / xx.sqrt(), y / yy.sqrt()])
            .collect();
        let (map, centre) = (pulls(0..4), pulls(4..6));
        let bias = |k: usize| {
            let of = pulls(k..k + 1);
            mean(of.iter().copied()) * (of.len() as f64).sqrt()
        };
        let biases: Vec<f64> = (0..6).map(bias).collect();
        failed |= name == "all" && biases.iter().any(|b| b.abs() > 3.5);
        println!(
            "| {name} | {} | {} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} | {} | {} | {} | {:.1} | {:.1} |",
            all.len(),
            made.len(),
            share(&map),
            share(&centre),
            100.0 * mean(jointly),
            share(&play),
            share(&arrivals),
            biases
                .iter()
                .map(|b| format!("{b:.1}"))
                .collect::<Vec<_>>()
                .join(" "),
            median(made.iter().map(|r| r.views as f64)),
            median(made.iter().map(|r| r.moves as f64)),
            median(made.iter().map(|r| r.instrument_s)),
            median(made.iter().map(|r| r.computing_s)),
        );
    }
    for r in records.iter().filter(|r| r.refused.is_some()) {
        println!(
            "refused {}: {}: {}",
            r.index,
            r.design,
            r.refused.as_deref().unwrap_or_default()
        );
    }
    failed
}

/// A line for each round.
pub(crate) fn csv(records: &[Record]) -> String {
    let mut out = String::from(
        "round,instrument,objective,play_um,refused,kx_px_per_m,ky_px_per_m,phi_deg,eta1_off_mm,eta2_off_mm,views,moves\n",
    );
    for r in records {
        let reading = r
            .reading
            .map_or(",,,,".into(), |v| v.map(|v| v.to_string()).join(","));
        let _ = writeln!(
            out,
            "{},\"{}\",{},{},{},{reading},{},{}",
            r.index,
            r.design,
            r.objective,
            r.play_um,
            r.refused.is_some(),
            r.views,
            r.moves
        );
    }
    out
}

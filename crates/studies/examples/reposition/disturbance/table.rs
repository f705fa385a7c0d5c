//! What the records say: a table, a page and numbers for elsewhere.

use super::Record;
use scopeservo_studies::page::{Page, Plot};
use std::fmt::Write as _;

const HEAD: [&str; 8] = [
    "disturbed",
    "objective",
    "runs",
    "arrived",
    "wrong",
    "median um",
    "95 % um",
    "95 % deg",
];

/// The records of each case, in their order.
fn cases(records: &[Record]) -> Vec<Vec<&Record>> {
    let mut all: Vec<Vec<&Record>> = Vec::new();
    for r in records.iter().filter(|r| r.verdict != "refused_at_saving") {
        match all.last_mut() {
            Some(case) if case[0].disturbed == r.disturbed && case[0].objective == r.objective => {
                case.push(r);
            }
            _ => all.push(vec![r]),
        }
    }
    all
}

fn row(case: &[&Record]) -> Vec<String> {
    let arrived: Vec<&&Record> = case.iter().filter(|r| r.verdict == "arrived").collect();
    let of = |f: fn(&Record) -> f64, share: f64| {
        let mut all: Vec<f64> = arrived.iter().map(|r| f(r)).collect();
        all.sort_by(f64::total_cmp);
        let at = (share * all.len() as f64) as usize;
        all.get(at.min(all.len().saturating_sub(1)))
            .map_or("-".into(), |v| format!("{v:.3}"))
    };
    vec![
        case[0].disturbed.clone(),
        case[0].objective.clone(),
        case.len().to_string(),
        arrived.len().to_string(),
        case.iter().filter(|r| r.is_false()).count().to_string(),
        of(|r| r.true_um, 0.5),
        of(|r| r.true_um, 0.95),
        of(|r| r.true_deg, 0.95),
    ]
}

/// Prints the table and what did not arrive; returns how many answers were wrong.
pub(crate) fn print(records: &[Record]) -> usize {
    println!("| {} |\n|{}", HEAD.join(" | "), "---|".repeat(HEAD.len()));
    for case in cases(records) {
        println!("| {} |", row(&case).join(" | "));
    }
    for r in records
        .iter()
        .filter(|r| r.verdict != "arrived" || r.is_false())
    {
        println!(
            "{} {} at {}: {} {} {} {} ({:.2} um, {:.3} deg)",
            r.index,
            r.disturbed,
            r.objective,
            r.stage,
            r.verdict,
            r.reason,
            r.message,
            r.true_um,
            r.true_deg
        );
    }
    records.iter().filter(|r| r.is_false()).count()
}

/// Run by run.
pub(crate) fn csv(records: &[Record]) -> String {
    let mut out = String::from(
        "index,disturbed,objective,stage,specimen,verdict,reason,true_um,true_deg,claimed_um,seconds\n",
    );
    for r in records {
        let claimed = r.claimed_um.map_or(String::new(), |um| um.to_string());
        let _ = writeln!(
            out,
            "{},\"{}\",{},{},\"{}\",{},{},{},{},{claimed},{}",
            r.index,
            r.disturbed,
            r.objective,
            r.stage,
            r.specimen,
            r.verdict,
            r.reason,
            r.true_um,
            r.true_deg,
            r.seconds
        );
    }
    out
}

/// The page.
pub(crate) fn page(records: &[Record]) -> String {
    let mut page = Page::new("Coming back while the view is disturbed");
    page.text(
        "A view is saved, the slide is put back elsewhere, and what the camera shows is disturbed from then on. Errors are the twin's truth, of runs \
         that arrived.",
    );
    let all = cases(records);
    let rows: Vec<_> = all.iter().map(|case| row(case)).collect();
    page.table(&HEAD, &rows);
    let mut plots = Vec::new();
    for objective in ["10x", "20x", "40x"] {
        let of: Vec<_> = all.iter().filter(|c| c[0].objective == objective).collect();
        if of.is_empty() {
            continue;
        }
        let mut arrived = Plot::rows(
            [0.0, 100.0],
            of.len(),
            &format!("arrived at {objective}, %"),
        );
        for (k, case) in of.iter().enumerate() {
            let y = (of.len() - 1 - k) as f64;
            arrived.y_tick(y, &case[0].disturbed.chars().take(22).collect::<String>());
            let count = case.iter().filter(|r| r.verdict == "arrived").count();
            let wrong = case.iter().any(|r| r.is_false());
            arrived.dot(100.0 * count as f64 / case.len() as f64, y, !wrong);
        }
        for x in [0.0, 50.0, 100.0] {
            arrived.x_tick(x, &format!("{x}"));
        }
        let caption =
            format!("Share of runs that arrived at {objective}; red where an answer was wrong.");
        plots.push((arrived, caption));
    }
    page.plots(plots);
    page.finish()
}

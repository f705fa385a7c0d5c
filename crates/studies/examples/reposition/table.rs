//! What the records say.

use crate::whole::Record;

/// The value that this share of all does not exceed.
pub(crate) fn quantile(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let mut all: Vec<f64> = values.collect();
    all.sort_by(f64::total_cmp);
    let at = (share * all.len() as f64) as usize;
    all.get(at.min(all.len().saturating_sub(1)))
        .copied()
        .unwrap_or(f64::NAN)
}

fn row(name: &str, records: &[&Record]) {
    let arrived: Vec<&&Record> = records.iter().filter(|r| r.verdict == "arrived").collect();
    let of = |f: fn(&Record) -> f64, share: f64| quantile(arrived.iter().map(|r| f(r)), share);
    println!(
        "| {name} | {} | {} ({:.1} %) | {} | {:.2} | {:.3} | {:.4} | {:.2} | {} | {} | {} | {} | {:.1} | {:.1} |",
        records.len(),
        arrived.len(),
        100.0 * arrived.len() as f64 / records.len().max(1) as f64,
        records.iter().filter(|r| r.is_false()).count(),
        of(|r| r.true_um, 0.5),
        of(|r| r.true_um, 0.95),
        of(|r| r.true_deg, 0.95),
        of(|r| r.defocus_um.abs(), 0.95),
        of(|r| r.goals as f64, 0.5),
        of(|r| r.goals as f64, 0.95),
        of(|r| r.moves as f64, 0.5),
        of(|r| r.frames as f64, 0.5),
        of(|r| r.seconds, 0.5),
        of(|r| r.seconds_unchanged, 0.5),
    );
}

/// Prints the table, and what did not arrive; returns how many answers were wrong.
pub(crate) fn print(records: &[Record]) -> usize {
    println!(
        "| runs | number | arrived | wrong | median um | 95 % um | 95 % deg | 95 % defocus um | median goals | 95 % goals | median moves | median frames | median s | without changes s |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|---|"
    );
    let of = |f: &dyn Fn(&Record) -> bool| records.iter().filter(|r| f(r)).collect::<Vec<_>>();
    row("all", &of(&|_| true));
    for stage in ["Hexapod", "Turntable"] {
        row(stage, &of(&|r| r.stage == stage));
    }
    for begins in ["40x", "10x"] {
        row(&format!("from {begins}"), &of(&|r| r.begins_with == begins));
    }
    let mut specimens: Vec<&str> = records.iter().map(|r| r.specimen.as_str()).collect();
    specimens.sort_unstable();
    specimens.dedup();
    for specimen in specimens {
        row(specimen, &of(&|r| r.specimen == specimen));
    }
    for r in records
        .iter()
        .filter(|r| r.verdict != "arrived" || r.is_false())
    {
        println!(
            "{} {} {} from {} at {:.0} um {:.1} deg, {} features: {} {} {} ({:.2} um, {:.3} deg)",
            r.index,
            r.stage,
            r.specimen,
            r.begins_with,
            r.start_um,
            r.turn_deg,
            r.features,
            r.verdict,
            r.reason,
            r.message,
            r.true_um,
            r.true_deg
        );
    }
    records.iter().filter(|r| r.is_false()).count()
}

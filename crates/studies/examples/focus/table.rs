//! What the records say.

use crate::start::Record;
use scopeservo_servo::SweepEnd;

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn row(name: &str, records: &[&Record]) -> Vec<String> {
    let n = records.len();
    let share = |k: usize| format!("{k} ({:.1} %)", 100.0 * k as f64 / n.max(1) as f64);
    let count = |f: &dyn Fn(&Record) -> bool| records.iter().filter(|r| f(r)).count();
    let focused = count(&|r| r.answer == "focused");
    let right = count(&Record::is_right);
    let off = median(
        records
            .iter()
            .filter(|r| r.answer == "focused")
            .map(|r| r.end_um.abs() / r.depth_um)
            .collect(),
    );
    let frames = median(records.iter().map(|r| r.frames as f64).collect());
    let moves = median(records.iter().map(|r| r.moves as f64).collect());
    let seconds = median(records.iter().map(|r| r.seconds).collect());
    let again: Vec<(&Record, f64, f64)> = records
        .iter()
        .filter_map(|r| r.again.map(|(off, n)| (*r, off, n as f64)))
        .collect();
    let again_right = again
        .iter()
        .filter(|(r, off, _)| off.abs() <= 0.25 * r.depth_um)
        .count();
    let again_frames = median(again.iter().map(|a| a.2).collect());
    vec![
        name.into(),
        n.to_string(),
        focused.to_string(),
        share(right),
        format!("{off:.3}"),
        frames.to_string(),
        moves.to_string(),
        format!("{seconds:.2}"),
        format!("{again_right} of {}", again.len()),
        again_frames.to_string(),
    ]
}

pub(crate) const HEAD: [&str; 10] = [
    "starts",
    "number",
    "focused",
    "within a quarter of the depth of field",
    "median error, depths",
    "median frames",
    "median moves",
    "median s",
    "again, right",
    "again, median frames",
];

/// All starts, and parts of them.
pub(crate) fn rows(records: &[Record]) -> Vec<Vec<String>> {
    let mut rows = Vec::new();
    let mut add = |name: &str, of: &dyn Fn(&Record) -> bool| {
        let of: Vec<_> = records.iter().filter(|r| of(r)).collect();
        if !of.is_empty() {
            rows.push(row(name, &of));
        }
    };
    add("all", &|_| true);
    for objective in ["10x", "20x", "40x"] {
        add(objective, &|r| r.objective == objective);
    }
    let mut specimens: Vec<&str> = records.iter().map(|r| r.specimen.as_str()).collect();
    specimens.sort_unstable();
    specimens.dedup();
    for specimen in specimens {
        add(specimen, &|r| r.specimen == specimen);
    }
    add("noise up to 0.5 %", &|r| r.noise <= 0.005);
    add("noise above 0.5 %", &|r| r.noise > 0.005);
    add("backlash up to 2 µm", &|r| r.play_um <= 2.0);
    add("backlash above 2 µm", &|r| r.play_um > 2.0);
    add("beyond 50 µm", &|r| r.start_um.abs() > 50.0);
    rows
}

/// Prints the table; returns how many failures left the stage nearer or worse off.
pub(crate) fn print(records: &[Record], blank: bool) -> usize {
    println!("| {} |\n|{}", HEAD.join(" | "), "---|".repeat(HEAD.len()));
    for row in rows(records) {
        println!("| {} |", row.join(" | "));
    }
    let of = |f: &dyn Fn(&Record) -> bool| records.iter().filter(|r| f(r)).collect::<Vec<_>>();
    let harmed = of(&Record::is_harmed).len();
    println!("\n{harmed} failures left the stage nearer to the specimen");
    for end in [
        SweepEnd::Found,
        SweepEnd::NoPeak,
        SweepEnd::Unknown,
        SweepEnd::NoFaster,
        SweepEnd::Refused,
    ] {
        let swept = of(&|r| r.swept == Some(end)).len();
        if swept > 0 {
            println!("coarse scan in motion, {end:?}: {swept}");
        }
    }
    let wrong = of(&|r| r.answer == "focused" && !r.is_right());
    if blank {
        println!(
            "{} of {} in focus on glass",
            of(&|r| r.answer == "focused").len(),
            records.len()
        );
    }
    for r in wrong.iter().take(12) {
        println!(
            "off: {} {} {}: {:.2} um of depth {:.2}, {:?}",
            r.index, r.objective, r.specimen, r.end_um, r.depth_um, r.claimed_sigma_um
        );
    }
    for r in of(&|r| r.answer != "focused").iter().take(12) {
        println!(
            "not: {} {} {}: {} from {:.0} um",
            r.index, r.objective, r.specimen, r.answer, r.start_um
        );
    }
    harmed
}

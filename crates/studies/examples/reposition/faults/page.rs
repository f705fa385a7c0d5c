//! What the records say, as a table and as a page.

use super::kinds::{Ends, Kind};
use super::run::Record;
use scopeservo_studies::page::{Page, Plot};

const HEAD: [&str; 9] = [
    "broken",
    "runs",
    "as it is to end",
    "arrived",
    "wrong",
    "named rightly",
    "back, of those that did not arrive",
    "moves after the first contradiction: median, most",
    "farthest um",
];

/// Those that were made, and broke before they ended.
fn of<'a>(kind: &Kind, records: &'a [Record]) -> Vec<&'a Record> {
    let made = |r: &&Record| r.kind == kind.name && r.verdict != "refused_at_saving";
    let all = records.iter().filter(made);
    all.filter(|r| r.broke || r.verdict != "arrived").collect()
}

fn row(kind: &Kind, all: &[&Record]) -> Vec<String> {
    let count = |f: &dyn Fn(&Record) -> bool| all.iter().filter(|r| f(r)).count();
    let mut moves: Vec<usize> = all.iter().map(|r| r.moves_after()).collect();
    moves.sort_unstable();
    let at = |k: usize| moves.get(k).map_or("-".into(), ToString::to_string);
    let away = count(&|r| !r.arrived());
    let named = match kind.ends {
        Ends::Arrives => "-".into(),
        _ => count(&|r| r.named_rightly).to_string(),
    };
    let back = match kind.ends {
        Ends::ToldAndBack => format!("{} of {away}", count(&|r| !r.arrived() && r.is_back())),
        _ => "-".into(),
    };
    let farthest = all.iter().map(|r| r.farthest_um).fold(0.0, f64::max);
    vec![
        kind.name.into(),
        all.len().to_string(),
        count(&|r| r.is_right(kind.ends)).to_string(),
        count(&Record::arrived).to_string(),
        count(&Record::is_false).to_string(),
        named,
        back,
        format!(
            "{}, {}",
            at(moves.len() / 2),
            at(moves.len().saturating_sub(1))
        ),
        format!("{farthest:.0}"),
    ]
}

fn table(kinds: &[Kind], records: &[Record]) -> Vec<Vec<String>> {
    let rows = kinds.iter().map(|kind| (kind, of(kind, records)));
    rows.filter(|(_, all)| !all.is_empty())
        .map(|(kind, all)| row(kind, &all))
        .collect()
}

/// Prints the table and what did not end as it is to; returns how many answers were wrong.
pub(crate) fn print(kinds: &[Kind], records: &[Record]) -> usize {
    println!("| {} |\n|{}", HEAD.join(" | "), "---|".repeat(HEAD.len()));
    for row in table(kinds, records) {
        println!("| {} |", row.join(" | "));
    }
    for kind in kinds {
        for r in of(kind, records).iter().filter(|r| !r.is_right(kind.ends)) {
            println!(
                "{} {}: {} {} {:?} after {} moves, {:.1} um {:.3} deg from the start: {}",
                r.index,
                kind.name,
                r.stage,
                r.verdict,
                r.named,
                r.moves,
                r.from_start_um,
                r.from_start_deg,
                r.message
            );
        }
    }
    records.iter().filter(|r| r.is_false()).count()
}

/// The page.
pub(crate) fn page(kinds: &[Kind], records: &[Record]) -> String {
    let mut page = Page::new("Runs in which one thing is broken");
    page.text(
        "In each run one thing of the simulated instrument is broken, before it begins or on its way. What the run says of it is compared with \
         what was broken, and where the stage ends with where it began. The first move after it broke shows the first contradiction.",
    );
    page.table(&HEAD, &table(kinds, records));
    page.heading("Moves after the first contradiction");
    let made: Vec<(&Kind, Vec<&Record>)> = kinds
        .iter()
        .map(|k| (k, of(k, records)))
        .filter(|(_, all)| !all.is_empty())
        .collect();
    let mut moves = Plot::rows([0.0, 8.0], made.len(), "moves");
    let mut ends = Plot::rows([0.0, 1500.0], made.len(), "um from the start, at the end");
    for (k, (kind, all)) in made.iter().enumerate() {
        let y = (made.len() - 1 - k) as f64;
        for plot in [&mut moves, &mut ends] {
            plot.y_tick(y, &kind.name.chars().take(22).collect::<String>());
        }
        for (n, r) in all.iter().enumerate() {
            // Beside each other, where they are the same.
            let beside = 0.6 * (n as f64 / all.len() as f64 - 0.5);
            let right = r.is_right(kind.ends);
            moves.dot(r.moves_after() as f64, y + beside, right);
            if !r.arrived() {
                ends.dot(r.from_start_um, y + beside, right);
            }
        }
    }
    for x in [0.0, 2.0, 4.0, 6.0, 8.0] {
        moves.x_tick(x, &format!("{x}"));
    }
    for x in [0.0, 500.0, 1000.0, 1500.0] {
        ends.x_tick(x, &format!("{x}"));
    }
    page.plots(vec![
        (moves, "Each dot is a run; green ended as it is to.".into()),
        (
            ends,
            "Runs that did not arrive: how far the stage says it is from where it began.".into(),
        ),
    ]);
    page.finish()
}

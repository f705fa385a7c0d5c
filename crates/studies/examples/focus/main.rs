//! Autofocus from random starts: specimens, noise, backlash, every objective.
//!
//! `cargo run --release -p scopeservo-studies --example focus -- --count 1500`
//!
//! Every start is kept as a line of its own: a study that was broken off goes on; beside them a page with plots, and CSV. `SCOPESERVO_SPECIMENS` gives real slides; without it
//! the tissue is procedural. Exit code 1 when a failure left the stage nearer to the specimen or worse off than it began.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

mod page;
mod start;
mod table;

use clap::Parser;
use scopeservo_servo::Measure;
use scopeservo_studies::rounds::{Outcome, rounds, threads};
use start::{Kind, Record, Start, Without};
use std::fs;
use std::path::PathBuf;

/// Autofocus from random starts within 200 um.
#[derive(Parser)]
struct Args {
    /// Starts.
    #[arg(long, default_value_t = 1500)]
    count: u64,
    /// Only this start.
    #[arg(long)]
    only: Option<u64>,
    /// How sharpness is measured: laplacian, tenengrad, band_power or paper.
    #[arg(long, default_value = "laplacian", value_parser = measure)]
    measure: Measure,
    /// Starts on glass without a specimen, with and without dust: none may be in focus.
    #[arg(long)]
    blank: bool,
    /// Only with this objective: 10x, 20x or 40x, a third of the starts.
    #[arg(long, value_parser = ["10x", "20x", "40x"])]
    objective: Option<String>,
    /// Spares the starts this cause of error: what is missing then is its share.
    #[arg(long, value_delimiter = ',')]
    without: Vec<Without>,
    /// The coarse scan in motion, where that saves time.
    #[arg(long)]
    sweep: bool,
    /// Time between the end of a move and settled, s, in place of the stage's 0.1.
    #[arg(long)]
    settle_s: Option<f64>,
    /// Threads; all processors unless told.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Where starts are kept; what lies there is not run again. A new folder for a new build.
    #[arg(long, default_value = "target/focus")]
    out: PathBuf,
}

/// In the order of the starts.
const OBJECTIVES: [&str; 3] = ["10x", "20x", "40x"];

fn measure(text: &str) -> Result<Measure, String> {
    serde_json::from_value(text.into())
        .map_err(|_| "laplacian, tenengrad, band_power or paper".into())
}

fn main() -> Outcome<()> {
    let mut args = Args::parse();
    args.threads = threads(args.threads)?;
    let measure = serde_json::to_value(args.measure)?;
    let mut name = vec![if args.blank { "blank" } else { "starts" }.to_string()];
    name.extend(measure.as_str().map(String::from));
    for (without, word) in [
        (Without::Scatter, "no_scatter"),
        (Without::Noise, "no_noise"),
    ] {
        name.extend(args.without.contains(&without).then(|| word.into()));
    }
    name.extend(args.sweep.then(|| "sweep".into()));
    name.extend(args.settle_s.map(|s| format!("settle_{s}")));
    let kind = Kind {
        blank: args.blank,
        settle_s: args.settle_s,
        without: args.without,
    };
    fs::create_dir_all(&args.out)?;
    let path = args.out.join(format!("{}.jsonl", name.join("-")));
    // Objectives go in turns.
    let objective = args
        .objective
        .and_then(|id| OBJECTIVES.iter().position(|o| *o == id));
    let wanted = |k: &u64| objective.is_none_or(|o| k % OBJECTIVES.len() as u64 == o as u64);
    let records = match args.only {
        Some(index) => {
            let record = Start::draw(index, &kind)?.run(args.measure, args.sweep, true)?;
            println!("{}", serde_json::to_string_pretty(&record)?);
            vec![record]
        }
        None => rounds(
            &path,
            &(0..args.count).filter(wanted).collect::<Vec<_>>(),
            args.threads,
            |r: &Record| r.index,
            |k| Start::draw(k, &kind)?.run(args.measure, args.sweep, false),
        )?,
    };
    if args.only.is_none() {
        fs::write(path.with_extension("csv"), page::csv(&records))?;
        fs::write(path.with_extension("html"), page::page(&records))?;
    }
    let harmed = table::print(&records, kind.blank);
    if harmed > 0 {
        std::process::exit(1);
    }
    Ok(())
}

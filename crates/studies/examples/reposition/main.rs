//! Whole runs from random starts: the slide is put back anywhere within the lowest view, turned by what the stage can turn it back.
//!
//! `cargo run --release -p scopeservo-studies --example reposition -- --count 200`
//!
//! `... -- faults --count 20` breaks one thing in each run; `... -- disturbance --count 20` disturbs the view; `... -- elsewhere
//! --count 100` shows something else; `... -- montecarlo --count 5` repeats
//! the paper's repositioning on three specimens, by its law and by direct control from the same starts.
//!
//! Instruments are calibrated once, focus is found anew, and every run is kept as a line of its own: a study that was broken off goes on.
//! `SCOPESERVO_SPECIMENS` gives real slides; without it the tissue is procedural. Exit code 1 when an answer was wrong.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

mod disturbance;
mod elsewhere;
mod faults;
mod many;
mod montecarlo;
mod scene;
mod table;
mod whole;

use clap::{Parser, Subcommand};
use scopeservo_servo::{Law, RepositionOptions};
use scopeservo_studies::rounds::{Outcome, rounds, threads};
use std::fs;
use std::path::PathBuf;

/// Whole runs from random starts.
#[derive(Parser)]
struct Args {
    #[command(subcommand)]
    study: Option<Study>,
    /// Runs; of each kind where there are several.
    #[arg(long, global = true, default_value_t = 200)]
    count: u64,
    /// Only this one, with what happens.
    #[arg(long, global = true)]
    only: Option<u64>,
    /// direct, or proportional: a fifth of the error at a time, at every magnification.
    #[arg(long, default_value = "direct", value_parser = law)]
    law: Law,
    /// Threads; all processors unless told.
    #[arg(long, global = true, default_value_t = 0)]
    threads: usize,
    /// Where calibrations and runs are kept; what lies there is not made again. A new folder for a new build.
    #[arg(long, global = true, default_value = "target/reposition")]
    out: PathBuf,
}

/// What else may be studied.
#[derive(Subcommand)]
enum Study {
    /// Something of the instrument is broken, one thing in each run: was it told, and where did it end?
    Faults {
        /// When it breaks.
        #[arg(long, value_enum, default_value = "fixed")]
        when: faults::When,
        /// Only those whose names have one of these in them.
        #[arg(long)]
        named: Vec<String>,
    },
    /// The view is disturbed, in one way or in two, after it was saved: is it found, and how well?
    Disturbance {
        /// Two ways at a time.
        #[arg(long)]
        pairs: bool,
        /// Of the pairs each with one objective by turns, in place of all three: every two of ways and objectives meet.
        #[arg(long, requires = "pairs")]
        covering: bool,
        /// Only those whose names have one of these in them.
        #[arg(long)]
        named: Vec<String>,
    },
    /// The view is not there: another slide, the other section of a series, a field beside, blank glass, the slide upside down. Does any run arrive?
    Elsewhere {
        /// Only those whose names have one of these in them.
        #[arg(long)]
        named: Vec<String>,
    },
    /// The paper's repeated repositioning: its law and direct control from the same starts, focus and calibration reused.
    Montecarlo,
}

fn law(text: &str) -> Result<Law, String> {
    serde_json::from_value(text.into()).map_err(|_| "direct or proportional".into())
}

fn main() -> Outcome<()> {
    let args = Args::parse();
    fs::create_dir_all(&args.out)?;
    let known = scene::calibrations(&args.out)?;
    if let Some(study) = &args.study {
        let many = many::Many {
            count: args.count,
            only: args.only,
            threads: threads(args.threads)?,
            out: &args.out,
        };
        let wrong = match study {
            Study::Faults { when, named } => faults::study(&many, (*when, named), &known)?,
            Study::Disturbance {
                pairs,
                covering,
                named,
            } => disturbance::study(&many, (*pairs, *covering, named), &known)?,
            Study::Elsewhere { named } => elsewhere::study(&many, named, &known)?,
            Study::Montecarlo => montecarlo::study(&many, &known)?,
        };
        if wrong > 0 {
            std::process::exit(1);
        }
        return Ok(());
    }
    let mut options = RepositionOptions::default();
    options.servo.law = args.law;
    let run = |index: u64, trace: bool| {
        let scene = scene::draw(index);
        let known = scene::of(&known, &scene);
        whole::run(&scene, index, known, options.clone(), trace)
    };
    let records = match args.only {
        Some(index) => {
            let record = run(index, true)?;
            println!("{}", serde_json::to_string_pretty(&record)?);
            vec![record]
        }
        None => {
            let law = serde_json::to_value(args.law)?;
            let name = format!("{}.jsonl", law.as_str().unwrap_or_default());
            let numbers: Vec<u64> = (0..args.count).collect();
            rounds(
                &args.out.join(name),
                &numbers,
                threads(args.threads)?,
                |r: &whole::Record| r.index,
                |k| run(k, false),
            )?
        }
    };
    if table::print(&records) > 0 {
        std::process::exit(1);
    }
    Ok(())
}

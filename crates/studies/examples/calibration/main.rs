//! Calibrations of simulated instruments against their hidden truth: the paper's Table II, and instruments of every kind.
//!
//! `cargo run --release -p scopeservo-studies --example calibration -- table2 --rounds 50`
//! `cargo run --release -p scopeservo-studies --example calibration -- instruments --count 400`
//! `cargo run --release -p scopeservo-studies --example calibration -- pairwise --times 4`
//! `cargo run --release -p scopeservo-studies --example calibration -- convergence`
//! `cargo run --release -p scopeservo-studies --example calibration -- together --rounds 10`
//!
//! `--method grid` does the same by a grid of dots, of 100, 50 and 20 um at 10x, 20x and 40x.
//!
//! Rounds stand on six pieces of tissue by turns, each at a place and an angle of its own, or on a slide (`--specimen`). Every round is kept as
//! a line of its own: a study that was broken off goes on. Beside the lines lies a page with plots, and the table as CSV.
//! Exit code 1 when a bias exceeds 3 sd / sqrt(rounds), or when truths lie outside of what is stated.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

mod arrival;
mod convergence;
mod instrument;
mod page;
mod record;
mod specimens;
mod table;
mod together;

use clap::{Parser, Subcommand, ValueEnum};
use instrument::{Design, pairwise};
use record::{Record, calibrated};
use scopeservo_servo::CalibrationMethod;
use scopeservo_studies::rounds::{Outcome, rounds, threads};
use specimens::Specimens;
use std::path::PathBuf;

/// Calibrations of simulated instruments against their hidden truth.
#[derive(Parser)]
struct Args {
    #[command(subcommand)]
    study: Study,
    /// joint, the paper's two steps, or by a grid of dots.
    #[arg(long, global = true, default_value = "joint")]
    method: Method,
    /// Threads; all processors unless told.
    #[arg(long, global = true, default_value_t = 0)]
    threads: usize,
    /// Where rounds are kept; what lies there is not run again. A new folder for a new build.
    #[arg(long, global = true, default_value = "target/calibration")]
    out: PathBuf,
}

#[derive(Subcommand)]
enum Study {
    /// The paper's instrument at 10x, 20x and 40x.
    Table2 {
        /// Rounds for each objective.
        #[arg(long, default_value_t = 50)]
        rounds: u64,
        /// Only this objective: 10x, 20x or 40x.
        #[arg(long, value_parser = ["10x", "20x", "40x"])]
        objective: Option<String>,
        /// Over this slide instead of procedural tissue.
        #[arg(long)]
        specimen: Option<PathBuf>,
        /// Size of the slide's pixels, where the file does not say it, um.
        #[arg(long)]
        um_per_px: Option<f64>,
    },
    /// Any mounting, stage, play and scatter.
    Instruments {
        /// Instruments.
        #[arg(long, default_value_t = 400)]
        count: u64,
        /// The number of the first one.
        #[arg(long, default_value_t = 0)]
        first: u64,
    },
    /// How wrong a calibration may be so that the servo still comes back.
    Convergence {
        /// Only this objective: 10x, 20x or 40x.
        #[arg(long, value_parser = OBJECTIVES)]
        objective: Option<String>,
    },
    /// Three objectives of the paper's instrument: where they look beside each other.
    Together {
        /// Rounds.
        #[arg(long, default_value_t = 10)]
        rounds: u64,
        /// Play of x and y, um, and of the rotation at a lever of 100 mm.
        #[arg(long, default_value_t = 0.0)]
        play_um: f64,
        /// Their repeatability, um; the paper's unless told.
        #[arg(long)]
        scatter_um: Option<f64>,
    },
    /// Instruments of which any two properties come together in one at least; each must be calibrated, and be right.
    Pairwise {
        /// How often, each time with other angles.
        #[arg(long, default_value_t = 4)]
        times: u64,
    },
}

#[derive(Clone, Copy, ValueEnum)]
enum Method {
    Joint,
    TwoStep,
    Grid,
}

/// The paper's by turns.
const OBJECTIVES: [&str; 3] = ["10x", "20x", "40x"];

fn main() -> Outcome<()> {
    let args = Args::parse();
    let threads = threads(args.threads)?;
    let (method, method_name) = match args.method {
        Method::Joint => (Some(CalibrationMethod::Joint), "joint"),
        Method::TwoStep => (Some(CalibrationMethod::TwoStep), "two-step"),
        Method::Grid => (None, "grid"),
    };
    type Designer = fn(u64) -> Design;
    let (name, numbers, design): (&str, Vec<u64>, Designer) = match &args.study {
        Study::Table2 {
            rounds, objective, ..
        } => {
            let of = |k: &u64| {
                objective
                    .as_ref()
                    .is_none_or(|o| *o == OBJECTIVES[(k % 3) as usize])
            };
            let numbers = (0..3 * rounds).filter(of).collect();
            ("table2", numbers, Design::of_paper)
        }
        Study::Instruments { count, first } => {
            let numbers = (*first..first + count).collect();
            ("instruments", numbers, Design::any)
        }
        Study::Pairwise { times } => {
            let count = times * pairwise().len() as u64;
            ("pairwise", (0..count).collect(), Design::of_pairs)
        }
        Study::Convergence { objective } => {
            return converges(&args, objective.as_deref(), threads);
        }
        Study::Together {
            rounds,
            play_um,
            scatter_um,
        } => {
            let stage = together::Stage {
                play_um: *play_um,
                scatter_um: *scatter_um,
            };
            return tries_together(&args, *rounds, stage, threads);
        }
    };
    let specimens = match (&args.method, &args.study) {
        (Method::Grid, _) => Specimens::grid()?,
        (
            _,
            Study::Table2 {
                specimen: Some(path),
                um_per_px,
                ..
            },
        ) => Specimens::slide(path, *um_per_px)?,
        _ => Specimens::tissue(),
    };
    // Rounds over another specimen are other rounds.
    let over = match &args.study {
        Study::Table2 {
            specimen: Some(path),
            ..
        } => format!(
            "-{}",
            path.file_stem().unwrap_or_default().to_string_lossy()
        ),
        _ => String::new(),
    };
    let path = args.out.join(format!("{name}{over}-{method_name}.jsonl"));
    let records = rounds(
        &path,
        &numbers,
        threads,
        |r: &Record| r.index,
        |k| calibrated(k, &design(k), method, &specimens),
    )?;
    let failed = match args.study {
        Study::Table2 { .. } => table::of_paper(&records),
        Study::Instruments { .. } | Study::Convergence { .. } | Study::Together { .. } => {
            table::of_any(&records)
        }
        Study::Pairwise { .. } => table::of_any(&records) | table::any_wrong(&records),
    };
    let title = format!("{name}, {method_name}");
    let page = match args.study {
        Study::Table2 { .. } => {
            let all = page::methods_at_hand(&args.out, name, (method_name, &records));
            page::of_paper(&title, method_name, &all)
        }
        _ => page::of_any(&title, &records),
    };
    let page_path = path.with_extension("html");
    std::fs::write(&page_path, page)?;
    std::fs::write(path.with_extension("csv"), table::csv(&records))?;
    println!("\nplots: {}", page_path.display());
    if failed {
        std::process::exit(1);
    }
    Ok(())
}

/// The study of several objectives.
fn tries_together(args: &Args, count: u64, stage: together::Stage, threads: usize) -> Outcome<()> {
    let scatter = stage.scatter_um.map_or("paper".into(), |s| s.to_string());
    let name = format!("together-{}-{scatter}.jsonl", stage.play_um);
    let numbers: Vec<u64> = (0..count).collect();
    let specimens = Specimens::tissue();
    let all = rounds(
        &args.out.join(name),
        &numbers,
        threads,
        |r: &together::Round| r.index,
        |k| together::tried(k, stage, &specimens),
    )?;
    if together::told(&all) {
        std::process::exit(1);
    }
    Ok(())
}

/// The study of the convergence range.
fn converges(args: &Args, objective: Option<&str>, threads: usize) -> Outcome<()> {
    let path = args.out.join("convergence.jsonl");
    let only = objective.and_then(|o| OBJECTIVES.iter().position(|name| *name == o));
    let numbers = convergence::numbers(only);
    let specimens = Specimens::tissue();
    let cells = rounds(
        &path,
        &numbers,
        threads,
        |c: &convergence::Cell| c.index,
        |k| convergence::tried(k, &specimens),
    )?;
    let summary = convergence::summary(&cells);
    println!("{}", summary.words());
    std::fs::write(path.with_extension("html"), convergence::page(&cells))?;
    std::fs::write(path.with_extension("csv"), convergence::csv(&cells))?;
    println!("\nplots: {}", path.with_extension("html").display());
    if summary.is_wrong() {
        std::process::exit(1);
    }
    Ok(())
}

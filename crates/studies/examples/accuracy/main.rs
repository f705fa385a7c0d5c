//! Our SIFT and registration against OpenCV's, on known warps of real slides; see docs/sift-accuracy.md.
//!
//! `cargo run --release -p scopeservo-studies --example accuracy -- --help`

#![expect(
    clippy::print_stdout,
    reason = "a study prints its results, and its images to its peers"
)]

mod measure;
mod page;
mod serve;

use clap::{Parser, Subcommand};
use scopeservo_studies::accuracy::scenes::Slides;
use scopeservo_studies::specimens;
use std::path::PathBuf;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Our SIFT and registration on known warps of real slides, and how OpenCV does on the same pairs.
#[derive(Parser)]
struct Args {
    /// Another seed gives another set of pairs.
    #[arg(long, default_value_t = 1, global = true)]
    seed: u64,
    /// Threads; all processors unless told.
    #[arg(long, default_value_t = 0, global = true)]
    threads: usize,
    /// The Python that has OpenCV.
    #[arg(long, default_value = "target/peers/bin/python", global = true)]
    python: PathBuf,
    #[command(subcommand)]
    mode: Mode,
}

#[derive(Subcommand)]
enum Mode {
    /// Render scenes for another program: it writes a scene's name (4-017) and a line end to stdin and reads from stdout a
    /// line of JSON, then the frames: the target, then a view per condition, one byte per pixel.
    Serve,
    /// Measure ours and append the results to a file; what is there for the same engine is skipped.
    Ours(measure::OursArgs),
    /// Make the page of tables from files of results.
    Table(page::TableArgs),
    /// All methods on one pair, such as 4-blur-017.
    Pair {
        /// The pair.
        id: String,
    },
    /// A few pairs per cell; fails when a clean pair at 1:1 is not found. With the peers when their Python is there.
    Quick,
}

fn main() -> Outcome<()> {
    let args = Args::parse();
    rayon::ThreadPoolBuilder::new()
        .num_threads(args.threads)
        .build_global()?;
    if let Mode::Table(table) = &args.mode {
        return page::run(table, args.seed);
    }
    let slides = Slides::of(specimens().ok_or("set SCOPESERVO_SPECIMENS to the folder of slides")?);
    match &args.mode {
        Mode::Serve => serve::run(slides, args.seed),
        Mode::Ours(ours) => measure::ours(ours, slides, args.seed),
        Mode::Pair { id } => measure::pair(id, slides, args.seed, &args.python),
        Mode::Quick => measure::quick(slides, args.seed, &args.python),
        Mode::Table(_) => unreachable!("it needs no slides and is done above"),
    }
}

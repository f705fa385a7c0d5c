//! Our SIFT and registration against OpenCV's, on known warps of real slides; see docs/sift-accuracy.md.
//!
//! `cargo run --release -p scopeservo-studies --example accuracy -- --help`

#![expect(
    clippy::print_stdout,
    reason = "a study prints its results, and its pictures to its peers"
)]

mod serve;

use clap::{Parser, Subcommand};
use scopeservo_studies::accuracy::scenes::Slides;
use scopeservo_studies::specimens;

/// Our SIFT and registration on known warps of real slides.
#[derive(Parser)]
struct Args {
    /// Another seed gives another set of pairs.
    #[arg(long, default_value_t = 1, global = true)]
    seed: u64,
    /// Threads; all processors unless told.
    #[arg(long, default_value_t = 0, global = true)]
    threads: usize,
    #[command(subcommand)]
    mode: Mode,
}

#[derive(Subcommand)]
enum Mode {
    /// Render scenes for another program: it writes a scene's name (4-017) and a line end to stdin and reads from stdout a
    /// line of JSON, then the frames: the target, then a view per condition, one byte per pixel.
    Serve,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args = Args::parse();
    rayon::ThreadPoolBuilder::new()
        .num_threads(args.threads)
        .build_global()?;
    let slides = Slides::of(specimens().ok_or("set SCOPESERVO_SPECIMENS to the folder of slides")?);
    match args.mode {
        Mode::Serve => serve::run(slides, args.seed),
    }
}

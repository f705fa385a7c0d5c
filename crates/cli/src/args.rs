//! The grammar of the command line. One definition gives help and completion.

use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Brings a motorised microscope back to the exact view you saved.
#[derive(Debug, Parser)]
#[command(
    version,
    about,
    after_help = "Exit codes: 0 arrived or found, 3 not found or refused, 2 bad input or usage, 1 fault or interruption."
)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Run the whole method on a simulated microscope: save a view, move the specimen, find it again.
    Demo(DemoArgs),
    /// Find one image in another: the transform from VIEW to TARGET, with a verdict.
    Register(RegisterArgs),
    /// Calibrate an instrument (no instrument can be configured yet).
    Calibrate,
    /// Focus an instrument (no instrument can be configured yet).
    Focus,
    /// Saved views (no instrument can be configured yet).
    #[command(subcommand)]
    Target(TargetCommand),
    /// Bring an instrument back to a saved view (no instrument can be configured yet).
    Reposition,
}

#[derive(Debug, Subcommand)]
pub(crate) enum TargetCommand {
    /// Save the present view as a target.
    Save,
}

/// Which law moves the stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Method {
    /// The paper's: proportional position-based servoing at each magnification.
    Paper,
}

/// What the simulated microscope gets wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Noise {
    /// The paper's stage repeatability, shot and read noise, nosepiece repeatability.
    Default,
    /// Perfect mechanics and a noiseless sensor. Optics, offsets and 8-bit rounding stay.
    None,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo demo
  scopeservo demo --specimen slide.png --um-per-px 0.5
  scopeservo demo --specimen slide.svs --seed 7 --out run7 --json
  scopeservo demo --start-um 300,-150 --start-deg 4.5 --lambda 0.5")]
pub(crate) struct DemoArgs {
    /// A slide image to put under the microscope: PNG, JPEG, TIFF, tiled or pyramidal TIFF, SVS. Without it, procedural
    /// tissue grown from the seed.
    #[arg(long, value_name = "FILE")]
    pub(crate) specimen: Option<PathBuf>,
    /// Size of a file pixel on the specimen. Needed when the file does not state it.
    #[arg(
        long,
        value_name = "UM",
        requires = "specimen",
        allow_negative_numbers = true
    )]
    pub(crate) um_per_px: Option<f64>,
    /// Seed of everything that is drawn: tissue, places, noise. The same seed gives the same run.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
    /// The control law.
    #[arg(long, value_enum, default_value = "paper")]
    pub(crate) method: Method,
    /// Gain: the share of the error that one iteration takes away, above 0 up to 1.
    #[arg(
        long,
        value_name = "F",
        default_value_t = 0.2,
        allow_negative_numbers = true
    )]
    pub(crate) lambda: f64,
    /// Iterations at each magnification, at most.
    #[arg(long, value_name = "N", default_value_t = 64)]
    pub(crate) max_iterations: usize,
    /// Where the view lies from the target when the slide is back, micrometres on the specimen. Drawn from the seed
    /// by default: at least 100 um, with the target inside the 100x view.
    #[arg(long, value_name = "X,Y", value_parser = parse_pair, allow_hyphen_values = true)]
    pub(crate) start_um: Option<[f64; 2]>,
    /// How far the slide is turned about the target's centre, degrees. Drawn within +-6 by default.
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    pub(crate) start_deg: Option<f64>,
    /// Threads for simulation and vision, 1 to 256; all cores by default. The answer does not depend on it.
    #[arg(long, value_name = "N")]
    pub(crate) threads: Option<usize>,
    /// What the simulated microscope gets wrong.
    #[arg(long, value_enum, default_value = "default")]
    pub(crate) noise: Noise,
    /// Folder for the report. With it, every view is kept too, with its hidden pose in views.json. Without it the
    /// report and result.json are written, to ./scopeservo-demo. What an earlier run left there is replaced.
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Print one JSON object on stdout instead of the summary.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo register view.png target.png
  scopeservo register scanner_a.tif scanner_b.tif --level 2 --json
  scopeservo register scan.tif target.png --features 8000
  scopeservo register view.png target.png --time 50 --threads 1")]
pub(crate) struct RegisterArgs {
    /// The image to find the transform from.
    pub(crate) view: PathBuf,
    /// The image to find the transform to.
    pub(crate) target: PathBuf,
    /// Pyramid level of both files; 0 is the finest. Coordinates are pixels of that level.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) level: usize,
    /// Strongest features of each image to use.
    #[arg(long, value_name = "N", default_value_t = 2000)]
    pub(crate) features: usize,
    /// Also tell how long it takes: the median of N repetitions (1 to 10000) of the view's features, match and fit. Files
    /// are decoded and the target's features made once, before.
    #[arg(long, value_name = "N")]
    pub(crate) time: Option<usize>,
    /// Threads, 1 to 256; all cores by default. The answer does not depend on it.
    #[arg(long, value_name = "T")]
    pub(crate) threads: Option<usize>,
    /// Print one JSON object on stdout instead of the summary.
    #[arg(long)]
    pub(crate) json: bool,
}

fn parse_pair(text: &str) -> Result<[f64; 2], String> {
    let number = |s: &str| {
        s.trim()
            .parse::<f64>()
            .ok()
            .filter(|v| v.is_finite())
            .ok_or_else(|| format!("'{s}' is not a number; give two numbers like 300,-150"))
    };
    match text.split_once(',') {
        Some((x, y)) => Ok([number(x)?, number(y)?]),
        None => Err("give two numbers separated by a comma, like 300,-150".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_grammar_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn pairs_are_two_finite_numbers() {
        assert_eq!(parse_pair("300,-150.5"), Ok([300.0, -150.5]));
        for bad in ["300", "1,x", "nan,1", "inf,0", ""] {
            assert!(parse_pair(bad).is_err(), "{bad}");
        }
    }
}

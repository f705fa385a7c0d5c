//! The simulated microscope, and two images without any.

use super::common::AnswerArgs;
use super::moving::MovingArgs;
use clap::{Args, Subcommand, ValueEnum};
use std::path::PathBuf;
use std::time::Duration;

#[derive(Debug, Subcommand)]
pub(crate) enum TwinCommand {
    /// Offer the simulated microscope to other programs, over the driver protocol, in real time.
    Serve(TwinServeArgs),
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo twin serve                             as a driver on standard input and output
  scopeservo twin serve --listen 127.0.0.1:7414
  scopeservo twin serve --described-in scopeservo.toml   with the dust, text or lattice that the file asks for
  scopeservo twin serve --listen 0.0.0.0:7414 --secret-file secret.txt")]
pub(crate) struct TwinServeArgs {
    /// Listen on this address and port instead of standard input and output.
    #[arg(long, value_name = "ADDRESS")]
    pub(crate) listen: Option<String>,
    /// A file with a secret that callers must know; needed where other machines can call.
    #[arg(long, value_name = "FILE", requires = "listen")]
    pub(crate) secret_file: Option<PathBuf>,
    /// The simulated microscope of this file's [drivers.NAME.twin], instead of what the options below say.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["specimen", "um_per_px", "seed", "centre_um", "turned_deg"])]
    pub(crate) described_in: Option<PathBuf>,
    /// A slide image to put under the microscope. Without it, procedural tissue grown from the seed.
    #[arg(long, value_name = "FILE")]
    pub(crate) specimen: Option<PathBuf>,
    /// Size of a file pixel on the specimen. Needed when the file does not state it.
    #[arg(long, value_name = "UM", requires = "specimen")]
    pub(crate) um_per_px: Option<f64>,
    /// How many times as fast as in life its stage moves, 1 to 1000.
    #[arg(long, value_name = "TIMES", value_parser = parse_speed, default_value = "1")]
    pub(crate) speed: f64,
    /// How much of its time passes at most between two requests. Without it, as much as does: a program that is kept waiting by a busy computer
    /// then finds that the stage has drifted.
    #[arg(long, value_name = "S", value_parser = parse_idle)]
    pub(crate) idle_s: Option<Duration>,
    /// Seed of everything that is drawn.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
    /// What lies under the view's centre at the start, um on the specimen.
    #[arg(long, value_name = "X,Y", value_parser = parse_pair, allow_hyphen_values = true, default_value = "0,0")]
    pub(crate) centre_um: [f64; 2],
    /// How far the specimen is turned.
    #[arg(
        long,
        value_name = "T",
        allow_negative_numbers = true,
        default_value_t = 0.0
    )]
    pub(crate) turned_deg: f64,
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
  scopeservo demo --start-um 300,-150 --start-deg 4.5 --method paper")]
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
    #[command(flatten)]
    pub(crate) moving: MovingArgs,
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
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

fn parse_idle(text: &str) -> Result<Duration, String> {
    let idle = text.parse().ok().filter(|s| (0.01..=3600.0).contains(s));
    idle.map(Duration::from_secs_f64)
        .ok_or_else(|| "seconds, 0.01 to 3600".into())
}

fn parse_speed(text: &str) -> Result<f64, String> {
    let speed = text.parse().ok().filter(|s| (1.0..=1000.0).contains(s));
    speed.ok_or_else(|| "a number from 1 to 1000".into())
}

pub(super) fn parse_pair(text: &str) -> Result<[f64; 2], String> {
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

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo register view.png target.png
  scopeservo register scanner_a.tif scanner_b.tif --level 2 --json
  scopeservo register view.png slide.ome.tif --level 0,2 --channel 0,1      a level and a channel for each file
  scopeservo register scan.tif target.png --features 8000
  scopeservo register view.png target.png --time 50 --threads 1
  scopeservo register before.png after.png --same-place      both show one place, and most of it is blank
  scopeservo register photo.png target.png --mirror

Verdicts: found (exit 0); not found, ambiguous (two places say as much), suspect (what agrees may be fixed to the camera) (exit 3).")]
pub(crate) struct RegisterArgs {
    /// The image to find the transform from.
    pub(crate) view: PathBuf,
    /// The image to find the transform to.
    pub(crate) target: PathBuf,
    /// Pyramid level of both files, or of view and target with a comma between; 0 is the finest. Coordinates are pixels of that level.
    #[arg(long, value_name = "N[,N]", value_delimiter = ',', num_args = 1)]
    pub(crate) level: Vec<usize>,
    /// Page of both files, or of view and target; counted from 0. Without it the finest or first image.
    #[arg(long, value_name = "N[,N]", value_delimiter = ',', num_args = 1)]
    pub(crate) page: Vec<usize>,
    /// Channel of both files, or of view and target; counted from 0. Without it the first, or colour as grey.
    #[arg(long, value_name = "N[,N]", value_delimiter = ',', num_args = 1)]
    pub(crate) channel: Vec<usize>,
    /// Strongest features of each image to use.
    #[arg(long, value_name = "N", default_value_t = 2000)]
    pub(crate) features: usize,
    /// Also tell how long it takes: the median of N repetitions (1 to 10000) of the view's features, match and fit. Files
    /// are decoded and the target's features made once, before.
    #[arg(long, value_name = "N")]
    pub(crate) time: Option<usize>,
    /// Both show the same place: believe what stays where it is in the image, though dust on the camera does that too.
    #[arg(long)]
    pub(crate) same_place: bool,
    /// Accept a view that is a mirror image.
    #[arg(long)]
    pub(crate) mirror: bool,
    /// Threads, 1 to 256; all cores by default. The answer does not depend on it.
    #[arg(long, value_name = "T")]
    pub(crate) threads: Option<usize>,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

//! The grammar of the command line. One definition gives help and completion.

use crate::error::CliError;
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Brings a motorised microscope back to the exact view you saved.
#[derive(Debug, Parser)]
#[command(
    version,
    about,
    after_help = "Exit codes: 0 arrived, found, done or all checks hold; 3 not found, refused, or a check does not hold; 2 bad input or usage, and \
                  nothing was done; 1 a fault, Ctrl-C, or an answer that could not be kept or told. A reader of the answer who goes \
                  away changes nothing."
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
    /// Write a commented scopeservo.toml to describe your instrument in.
    Init(InitArgs),
    /// Check the instrument, device by device. Nothing moves unless you allow it.
    Doctor(DoctorArgs),
    /// Calibrate objectives: how pixels relate to the stage, measured without a pattern.
    Calibrate(CalibrateArgs),
    /// Focus with the objective in the beam.
    Focus(FocusArgs),
    /// The stage, through the rules of your file.
    #[command(subcommand)]
    Stage(StageCommand),
    /// Saved views.
    #[command(subcommand)]
    Target(TargetCommand),
    /// Bring the instrument back to a saved view.
    Reposition(RepositionArgs),
    /// Drivers: programs of yours that speak for devices.
    #[command(subcommand)]
    Driver(DriverCommand),
    /// The simulated microscope.
    #[command(subcommand)]
    Twin(TwinCommand),
}

impl Command {
    /// Whether the answer is a JSON object.
    pub(crate) fn wants_json(&self) -> bool {
        match self {
            Self::Demo(args) => args.json,
            Self::Register(args) => args.json,
            Self::Doctor(args) => args.json,
            Self::Calibrate(args) => args.json,
            Self::Focus(args) => args.json,
            Self::Stage(StageCommand::Go(args)) => args.json,
            Self::Target(TargetCommand::Save(args)) => args.json,
            Self::Target(TargetCommand::List(args)) => args.json,
            Self::Target(TargetCommand::Export(args)) => args.json,
            Self::Target(TargetCommand::Import(args)) => args.json,
            Self::Reposition(args) => args.json,
            Self::Driver(DriverCommand::Check(args)) => args.json,
            Self::Init(_) | Self::Twin(_) => false,
        }
    }
}

/// What is wrong with the command line, and whether the answer to it is a JSON object.
pub(crate) fn misused(error: &clap::Error) -> (CliError, bool) {
    let words = error.render().to_string();
    let words = words.strip_prefix("error: ").unwrap_or(&words);
    // What follows -- is a driver's.
    let mut ours = std::env::args_os().take_while(|a| a != "--");
    let json = ours.any(|a| a == "--json");
    (CliError::Usage(words.trim_end().into()), json)
}

/// Where the instrument is described.
#[derive(Debug, Args)]
pub(crate) struct ConfigArgs {
    /// The description of the instrument.
    #[arg(
        long,
        value_name = "FILE",
        default_value = "scopeservo.toml",
        env = "SCOPESERVO_CONFIG"
    )]
    pub(crate) config: PathBuf,
}

/// Which instrument, and what it may do on opening.
#[derive(Debug, Args)]
pub(crate) struct InstrumentArgs {
    #[command(flatten)]
    pub(crate) description: ConfigArgs,
    /// Allow homing when the stage needs it: it may move anything anywhere.
    #[arg(long)]
    pub(crate) home: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo init                  for your own instrument: edit it, then run `scopeservo doctor`
  scopeservo init --twin           for the simulated microscope, ready to use
  scopeservo init --schema > scopeservo.schema.json      for editors that complete and check TOML")]
pub(crate) struct InitArgs {
    /// The file to write. One that is there is never overwritten.
    #[arg(default_value = "scopeservo.toml")]
    pub(crate) file: PathBuf,
    /// Describe the simulated microscope.
    #[arg(long)]
    pub(crate) twin: bool,
    /// Print a JSON schema of the file on stdout, for editors, and write nothing.
    #[arg(long, conflicts_with = "twin")]
    pub(crate) schema: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo doctor
  scopeservo doctor --json
  scopeservo doctor --allow-motion        also moves every axis a little, over a specimen that does not matter")]
pub(crate) struct DoctorArgs {
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    /// Also run the conformance suite: every axis moves a little and comes back, every objective is brought into the beam. Take
    /// the specimen out first.
    #[arg(long)]
    pub(crate) allow_motion: bool,
    /// Print one JSON object on stdout instead.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo calibrate                       every objective, from the lowest magnification up
  scopeservo calibrate --objective 40x --json")]
pub(crate) struct CalibrateArgs {
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    /// An objective to calibrate; may be repeated. All of them by default.
    #[arg(long, value_name = "ID")]
    pub(crate) objective: Vec<String>,
    /// Do not focus first.
    #[arg(long)]
    pub(crate) no_focus: bool,
    /// Print one JSON object on stdout instead of the summary.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo focus
  scopeservo focus --objective 40x --range-um 20")]
pub(crate) struct FocusArgs {
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    /// Bring this objective into the beam first.
    #[arg(long, value_name = "ID")]
    pub(crate) objective: Option<String>,
    /// How far above and below the present height to look: 40 um, and up to 120 um where the best view lies at an end. A range that is
    /// given is never passed towards the specimen.
    #[arg(long, value_name = "UM")]
    pub(crate) range_um: Option<f64>,
    /// Go to this height first, and focus around it: for a stage that was left retracted.
    #[arg(long, value_name = "UM", allow_negative_numbers = true)]
    pub(crate) near_z_um: Option<f64>,
    /// Print one JSON object on stdout instead of the summary.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Subcommand)]
pub(crate) enum StageCommand {
    /// Go to a place, within the rules. A stage that stands outside its limits is brought back by this, towards the inside only.
    Go(StageGoArgs),
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo stage go --x-um 300 --y-um -150
  scopeservo stage go --z-um -2000        straight away from the specimen: allowed from anywhere
  scopeservo stage go --rz-deg 0 --json

Goals are places of the stage, not distances. An axis that is not named stays where it is. What a rule does not allow is refused
whole, and nothing moves. Ctrl-C stops.")]
pub(crate) struct StageGoArgs {
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    #[command(flatten)]
    pub(crate) to: PlaceArgs,
    /// Print one JSON object on stdout instead of the summary.
    #[arg(long)]
    pub(crate) json: bool,
}

/// Goals of axes, one at least.
#[derive(Debug, Args)]
#[group(required = true, multiple = true)]
pub(crate) struct PlaceArgs {
    /// Along x.
    #[arg(long, value_name = "UM", allow_negative_numbers = true)]
    pub(crate) x_um: Option<f64>,
    /// Along y.
    #[arg(long, value_name = "UM", allow_negative_numbers = true)]
    pub(crate) y_um: Option<f64>,
    /// Focus.
    #[arg(long, value_name = "UM", allow_negative_numbers = true)]
    pub(crate) z_um: Option<f64>,
    /// About x.
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    pub(crate) rx_deg: Option<f64>,
    /// About y.
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    pub(crate) ry_deg: Option<f64>,
    /// About z, in the specimen plane.
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    pub(crate) rz_deg: Option<f64>,
}

#[derive(Debug, Subcommand)]
pub(crate) enum TargetCommand {
    /// Save the present view as a target.
    Save(TargetSaveArgs),
    /// List the saved targets.
    List(TargetListArgs),
    /// Write a saved target into one file, for another microscope or another computer.
    Export(TargetExportArgs),
    /// Take in a target that was exported.
    Import(TargetImportArgs),
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo target save mitosis-3
  scopeservo target save mitosis-3 --objective 40x --focus
  scopeservo target save mitosis-3 --still       nothing moves; the run must prove what belongs to the specimen

The stage steps aside by some pixels and comes back: what does not move with it is on the camera and left out.")]
pub(crate) struct TargetSaveArgs {
    /// A name: letters, digits, '-', '_' and '.'.
    pub(crate) name: String,
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    /// Bring this objective into the beam first.
    #[arg(long, value_name = "ID")]
    pub(crate) objective: Option<String>,
    /// Focus first.
    #[arg(long)]
    pub(crate) focus: bool,
    /// Move nothing, also no step aside that shows what is fixed to the camera.
    #[arg(long, conflicts_with_all = ["focus", "objective"])]
    pub(crate) still: bool,
    /// Print one JSON object on stdout instead of the summary.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo target export mitosis-3 mitosis-3.target")]
pub(crate) struct TargetExportArgs {
    /// The target's name.
    pub(crate) name: String,
    /// The file to write; none is overwritten.
    pub(crate) file: PathBuf,
    #[command(flatten)]
    pub(crate) description: ConfigArgs,
    /// Print one JSON object on stdout instead.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo target import mitosis-3.target
  scopeservo target import mitosis-3.target --name from-upstairs")]
pub(crate) struct TargetImportArgs {
    /// A file that `target export` wrote.
    pub(crate) file: PathBuf,
    /// The name that it gets; that of the file unless told.
    #[arg(long)]
    pub(crate) name: Option<String>,
    #[command(flatten)]
    pub(crate) description: ConfigArgs,
    /// Print one JSON object on stdout instead.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct TargetListArgs {
    #[command(flatten)]
    pub(crate) description: ConfigArgs,
    /// Print one JSON object on stdout instead.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo reposition mitosis-3
  scopeservo reposition mitosis-3 --lambda 0.7 --out run --json
  scopeservo reposition mitosis-3 --calibrate      measure the objectives anew on the way")]
pub(crate) struct RepositionArgs {
    /// The target's name.
    pub(crate) name: String,
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    /// Calibrate each objective on the way, also those that are calibrated.
    #[arg(long)]
    pub(crate) calibrate: bool,
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
    /// Folder for the report; that of an earlier run there is replaced.
    #[arg(long, value_name = "DIR", default_value = "scopeservo-run")]
    pub(crate) out: PathBuf,
    /// Print one JSON object on stdout instead of the summary.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Subcommand)]
pub(crate) enum DriverCommand {
    /// Run the conformance suite against a driver. Take the specimen out first.
    Check(DriverCheckArgs),
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo driver check -- python3 my_driver.py --port /dev/ttyUSB0
  scopeservo driver check --tcp 127.0.0.1:7414
  scopeservo driver check --retract-z-um -2000 -- node driver.mjs")]
pub(crate) struct DriverCheckArgs {
    /// A driver that runs already, in place of a command.
    #[arg(long, value_name = "ADDRESS", conflicts_with = "command")]
    pub(crate) tcp: Option<String>,
    /// A file with the secret that it asks for.
    #[arg(long, value_name = "FILE", requires = "tcp")]
    pub(crate) secret_file: Option<PathBuf>,
    /// The height from which on the nosepiece may turn. Without it objectives are not changed.
    #[arg(long, value_name = "UM", allow_negative_numbers = true)]
    pub(crate) retract_z_um: Option<f64>,
    /// Print one JSON object on stdout instead.
    #[arg(long)]
    pub(crate) json: bool,
    /// The driver's program and its arguments.
    #[arg(last = true, value_name = "COMMAND")]
    pub(crate) command: Vec<String>,
}

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
  scopeservo register view.png target.png --time 50 --threads 1
  scopeservo register before.png after.png --same-place      both show one place, and most of it is blank
  scopeservo register photo.png target.png --mirror

Verdicts: found (exit 0); not found, ambiguous (two places say as much), suspect (what agrees may be fixed to the camera) (exit 3).")]
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
    /// Both show the same place: believe what stays where it is in the picture, though dust on the camera does that too.
    #[arg(long)]
    pub(crate) same_place: bool,
    /// Accept a view that is a mirror image.
    #[arg(long)]
    pub(crate) mirror: bool,
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

//! The grammar of the command line. One definition gives help and completion.

mod common;
mod hands;
mod library;
mod moving;
#[cfg(feature = "serve")]
mod serve;
mod target;
mod twin;
mod work;

pub(crate) use common::*;
pub(crate) use hands::*;
pub(crate) use library::*;
#[cfg(feature = "serve")]
pub(crate) use serve::*;
pub(crate) use target::*;
pub(crate) use twin::*;
pub(crate) use work::*;

use crate::error::CliError;
use clap::{Args, Parser, Subcommand};
use std::path::PathBuf;

#[cfg(test)]
mod pages;

/// Brings a motorised microscope back to the exact view you saved.
#[derive(Debug, Parser)]
#[command(
    name = "scopeservo",
    version,
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
    /// What the instrument says of itself: where the stage stands, which objective is in. Nothing moves.
    Status(StatusArgs),
    /// Take one image and keep it as PNG. Nothing moves.
    Snap(SnapArgs),
    /// Bring an objective into the beam, within the rules; without a name tell which one is in.
    Objective(ObjectiveArgs),
    /// Check the instrument, device by device. Nothing moves unless you allow it.
    Doctor(DoctorArgs),
    /// Calibrate objectives: how pixels relate to the stage, measured without a pattern.
    Calibrate(CalibrateArgs),
    /// Focus with the active objective.
    Focus(FocusArgs),
    /// Check an objective, its calibration and the stage with a pattern slide: a grid of dots, squares or lines of known pitch.
    Grid(GridArgs),
    /// How the view is tilted against the focal plane; with --apply, level it on a stage that tips.
    Level(LevelArgs),
    /// Check kept calibrations by two moves over tissue: good, drifted or to be replaced.
    Check(CheckArgs),
    /// All calibrations that are kept, with what changed from one to the next. Nothing moves.
    Calibrations(CalibrationsArgs),
    /// The stage, through the rules of your file.
    #[command(subcommand)]
    Stage(StageCommand),
    /// Saved views.
    #[command(subcommand)]
    Target(TargetCommand),
    /// What was done: runs with their answers, events and reports.
    #[command(subcommand)]
    Run(RunCommand),
    /// Look after what is kept: check it, back it up, take it elsewhere.
    #[command(subcommand)]
    Library(LibraryCommand),
    /// Bring the instrument back to a saved view.
    Reposition(RepositionArgs),
    /// A page to work at, and an interface for programs: the instrument at an address of this computer.
    #[cfg(feature = "serve")]
    Serve(ServeArgs),
    /// Go on with the job that was under way when the program was killed.
    Resume(ResumeArgs),
    /// End the job that was under way when the program was killed.
    Abandon(AbandonArgs),
    /// Drivers: programs of yours that speak for devices.
    #[command(subcommand)]
    Driver(DriverCommand),
    /// The simulated microscope.
    #[command(subcommand)]
    Twin(TwinCommand),
    /// Print what a shell needs to complete commands and options.
    Completions(CompletionsArgs),
    /// Print the manual page, or write those of all commands into a folder.
    Man(ManArgs),
}

impl Command {
    /// Whether the user may say on how many threads it computes, so that it takes them itself.
    pub(crate) fn takes_threads(&self) -> bool {
        matches!(self, Self::Demo(_) | Self::Register(_))
    }

    /// Whether the answer is a JSON object.
    pub(crate) fn wants_json(&self) -> bool {
        match self {
            Self::Demo(args) => args.answer.json,
            Self::Register(args) => args.answer.json,
            Self::Doctor(args) => args.answer.json,
            Self::Calibrate(args) => args.answer.json,
            Self::Focus(args) => args.answer.json,
            Self::Grid(args) => args.answer.json,
            Self::Level(args) => args.answer.json,
            Self::Check(args) => args.answer.json,
            Self::Calibrations(args) => args.kept.answer.json,
            Self::Resume(args) => args.answer.json,
            Self::Abandon(args) => args.kept.answer.json,
            Self::Stage(StageCommand::Go(args)) => args.answer.json,
            Self::Target(TargetCommand::Save(args)) => args.answer.json,
            Self::Status(args) => args.answer.json,
            Self::Snap(args) => args.answer.json,
            Self::Objective(args) => args.answer.json,
            Self::Target(TargetCommand::List(args)) => args.kept.answer.json,
            Self::Target(TargetCommand::Show(args)) => args.kept.answer.json,
            Self::Target(TargetCommand::Rename(args)) => args.kept.answer.json,
            Self::Target(TargetCommand::Remove(args)) => args.kept.answer.json,
            Self::Target(TargetCommand::Note(args)) => args.kept.answer.json,
            Self::Target(TargetCommand::Restore(args)) => args.kept.answer.json,
            Self::Target(TargetCommand::Purge(args)) => args.kept.answer.json,
            Self::Run(RunCommand::List(args)) => args.kept.answer.json,
            Self::Run(RunCommand::Show(args)) => args.kept.answer.json,
            Self::Run(RunCommand::Pin(args)) => args.kept.answer.json,
            Self::Library(LibraryCommand::Check(args)) => args.kept.answer.json,
            Self::Library(LibraryCommand::Backup(args)) => args.kept.answer.json,
            Self::Library(LibraryCommand::Restore(args)) => args.kept.answer.json,
            Self::Library(LibraryCommand::Export(args)) => args.kept.answer.json,
            Self::Library(LibraryCommand::Rebuild(args)) => args.kept.answer.json,
            Self::Target(TargetCommand::Export(args)) => args.kept.answer.json,
            Self::Target(TargetCommand::Import(args)) => args.kept.answer.json,
            Self::Reposition(args) => args.answer.json,
            Self::Driver(DriverCommand::Check(args)) => args.answer.json,
            #[cfg(feature = "serve")]
            Self::Serve(_) => false,
            Self::Init(_) | Self::Twin(_) | Self::Completions(_) | Self::Man(_) => false,
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

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo completions bash > ~/.local/share/bash-completion/completions/scopeservo
  scopeservo completions zsh > ~/.zfunc/_scopeservo
  scopeservo completions fish > ~/.config/fish/completions/scopeservo.fish
  scopeservo completions powershell >> $PROFILE")]
pub(crate) struct CompletionsArgs {
    /// The shell.
    pub(crate) shell: clap_complete::Shell,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo man | man -l -
  scopeservo man --out ~/.local/share/man/man1")]
pub(crate) struct ManArgs {
    /// A folder for the pages of all commands, one each.
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo init                  for your own instrument: edit it, then run `scopeservo doctor`
  scopeservo init --ask            asks what it is made of, and writes that
  scopeservo init --twin           for the simulated microscope, ready to use
  scopeservo init --schema > scopeservo.schema.json      for editors that complete and check TOML")]
pub(crate) struct InitArgs {
    /// The file to write. One that is there is never overwritten.
    #[arg(default_value = "scopeservo.toml")]
    pub(crate) file: PathBuf,
    /// Describe the simulated microscope.
    #[arg(long)]
    pub(crate) twin: bool,
    /// Ask what the instrument is made of. Enter takes what stands in brackets.
    #[arg(long, conflicts_with = "twin")]
    pub(crate) ask: bool,
    /// Print a JSON schema of the file on stdout, for editors, and write nothing.
    #[arg(long, conflicts_with_all = ["twin", "ask"])]
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
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
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
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
    /// The driver's program and its arguments.
    #[arg(last = true, value_name = "COMMAND")]
    pub(crate) command: Vec<String>,
}

#[cfg(test)]
mod tests {
    use super::twin::parse_pair;
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

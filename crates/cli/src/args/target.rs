//! Saved views.

use super::common::{AnswerArgs, ConfigArgs, FocusingArgs, InstrumentArgs};
use clap::{Args, Subcommand};
use std::path::PathBuf;

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
    /// Focus first. Without it the height stays as it is, and a view that is sharper a little above or below is told.
    #[arg(long)]
    pub(crate) focus: bool,
    #[command(flatten)]
    pub(crate) focusing: FocusingArgs,
    /// Move nothing: no step aside that shows what is fixed to the camera, and none that shows whether the view is in focus.
    #[arg(long, conflicts_with_all = ["focus", "objective"])]
    pub(crate) still: bool,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
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
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
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
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

#[derive(Debug, Args)]
pub(crate) struct TargetListArgs {
    #[command(flatten)]
    pub(crate) description: ConfigArgs,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

//! Saved views.

use super::common::{AnswerArgs, FocusingArgs, InstrumentArgs, KeptArgs};
use clap::{Args, Subcommand};
use std::path::PathBuf;

#[derive(Debug, Subcommand)]
pub(crate) enum TargetCommand {
    /// Save the present view as a target.
    Save(TargetSaveArgs),
    /// List the saved targets.
    List(TargetListArgs),
    /// Everything that is known of a saved target.
    Show(TargetShowArgs),
    /// Give a saved target another name.
    Rename(TargetRenameArgs),
    /// Take a saved target out of the list. Its file is put aside, not deleted.
    Remove(TargetRemoveArgs),
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
    pub(crate) kept: KeptArgs,
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
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo target show mitosis-3
  scopeservo target show mitosis-3 --json")]
pub(crate) struct TargetShowArgs {
    /// The target's name.
    pub(crate) name: String,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo target rename mitosis-3 metaphase-1")]
pub(crate) struct TargetRenameArgs {
    /// The target's name.
    pub(crate) name: String,
    /// The one that it gets: letters, digits, '-', '_' and '.'.
    pub(crate) to: String,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo target remove mitosis-3
  scopeservo target remove mitosis-3 mitosis-4

The files go to targets/removed in the data folder, from where `scopeservo target import` takes them in again. Delete them there for good.")]
pub(crate) struct TargetRemoveArgs {
    /// The names of the targets.
    #[arg(required = true, value_name = "NAME")]
    pub(crate) names: Vec<String>,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo target list
  scopeservo target list --long        also where the stage was, the scale, and the file
  scopeservo target list --json")]
pub(crate) struct TargetListArgs {
    /// Also where the stage was, the size of a pixel, and the file.
    #[arg(long)]
    pub(crate) long: bool,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

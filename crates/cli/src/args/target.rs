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
    /// Say which slide a saved target is on, and what to remember of it.
    Note(TargetNoteArgs),
    /// Put a saved target into the bin.
    Remove(TargetRemoveArgs),
    /// Take a target back out of the bin.
    Restore(TargetRestoreArgs),
    /// Delete targets in the bin for good, with all that was done with them.
    Purge(TargetPurgeArgs),
    /// Write a saved target into one file, for another microscope or another computer.
    Export(TargetExportArgs),
    /// Take in a target that was exported.
    Import(TargetImportArgs),
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo target save mitosis-3
  scopeservo target save mitosis-3 --objective 40x --focus
  scopeservo target save mitosis-3 --slide 17-B --note 'metaphase, at the rim'
  scopeservo target save mitosis-3 --still       nothing moves; the run must prove what belongs to the specimen

The stage steps aside by some pixels and comes back: what does not move with it is on the camera and left out.")]
pub(crate) struct TargetSaveArgs {
    /// A name: letters, digits, '-', '_' and '.'.
    pub(crate) name: String,
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    /// The slide that it is on, as it is labelled.
    #[arg(long, value_name = "NAME")]
    pub(crate) slide: Option<String>,
    /// What to remember of it.
    #[arg(
        long,
        value_name = "TEXT",
        default_value = "",
        hide_default_value = true
    )]
    pub(crate) note: String,
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

They lie in the bin (`target list --bin`), from where `target restore` takes them back and `target purge` deletes them for good.")]
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
  scopeservo target list --slide 17-B
  scopeservo target list --text mitos  those with that in name, note or slide
  scopeservo target list --bin
  scopeservo target list --json")]
pub(crate) struct TargetListArgs {
    /// Also where the stage was, the size of a pixel, and the file.
    #[arg(long)]
    pub(crate) long: bool,
    /// Only those on this slide.
    #[arg(long, value_name = "NAME")]
    pub(crate) slide: Option<String>,
    /// Only those with all of these words in name, note or slide; parts of words will do.
    #[arg(long, value_name = "WORDS")]
    pub(crate) text: Option<String>,
    /// Those in the bin.
    #[arg(long)]
    pub(crate) bin: bool,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo target note mitosis-3 'metaphase, at the rim'
  scopeservo target note mitosis-3 --slide 17-B
  scopeservo target note mitosis-3 --no-slide ''")]
pub(crate) struct TargetNoteArgs {
    /// The target's name.
    pub(crate) name: String,
    /// What to remember of it, in place of what was noted; '' for nothing.
    #[arg(required_unless_present_any = ["slide", "no_slide"])]
    pub(crate) text: Option<String>,
    /// The slide that it is on.
    #[arg(long, value_name = "NAME", conflicts_with = "no_slide")]
    pub(crate) slide: Option<String>,
    /// It is on no slide that has a name.
    #[arg(long)]
    pub(crate) no_slide: bool,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo target restore mitosis-3
  scopeservo target restore mitosis-3 --as mitosis-3b")]
pub(crate) struct TargetRestoreArgs {
    /// The name that it had; of several the one that was removed last.
    pub(crate) name: String,
    /// Another name for it.
    #[arg(long = "as", value_name = "NAME")]
    pub(crate) to: Option<String>,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo target purge mitosis-3
  scopeservo target purge --all

Nothing brings them back: their files and pictures, the runs to them with events and reports, their words in the index, and the files of \
earlier versions that they came from are deleted. Backups keep what they have.")]
pub(crate) struct TargetPurgeArgs {
    /// The names of targets in the bin.
    #[arg(required_unless_present = "all", value_name = "NAME")]
    pub(crate) names: Vec<String>,
    /// All that lies in the bin.
    #[arg(long, conflicts_with = "names")]
    pub(crate) all: bool,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

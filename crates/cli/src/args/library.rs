//! Looking after what is kept, and what was done.

use super::common::KeptArgs;
use clap::{Args, Subcommand};
use std::path::PathBuf;

#[derive(Debug, Subcommand)]
pub(crate) enum LibraryCommand {
    /// Read all that was kept, and tell what is not as it was.
    Check(LibraryCheckArgs),
    /// Write the whole library into one file.
    Backup(LibraryBackupArgs),
    /// Unpack a backup where there is no library yet.
    Restore(LibraryRestoreArgs),
    /// Write everything as plain files, for other programs.
    Export(LibraryExportArgs),
    /// Make a database that was lost anew, from the files beside it.
    Rebuild(LibraryRebuildArgs),
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo library check
  scopeservo library check --repair      also removes what killed programs left
  scopeservo library check --json")]
pub(crate) struct LibraryCheckArgs {
    /// Remove files that nothing names, and make the text index anew. Nothing that was kept is changed.
    #[arg(long)]
    pub(crate) repair: bool,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo library backup monday.tar

Others may go on working meanwhile. The file is a tar archive of the database and of the files beside it.")]
pub(crate) struct LibraryBackupArgs {
    /// The file to write; none is overwritten.
    pub(crate) file: PathBuf,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo library restore monday.tar

The data folder must have no library: move one that is damaged away before. The backup is held to the sums in it before anything is put in \
place.")]
pub(crate) struct LibraryRestoreArgs {
    /// A file that `library backup` wrote.
    pub(crate) file: PathBuf,
    /// Also take one without sums: an earlier version wrote it, or it ends early.
    #[arg(long)]
    pub(crate) without_sums: bool,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo library export everything

Targets and their pictures, calibrations, runs with events, reports and what was seen at arrival, pictures that somebody brought. A data folder of such files is
taken in by this program again, but for brought pictures. What ended early goes on with the same command.")]
pub(crate) struct LibraryExportArgs {
    /// A folder that is empty, not there yet, or holds an export that ended early.
    pub(crate) folder: PathBuf,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo library rebuild

For when library.sqlite3 is damaged and there is no backup: move it away first, with library.sqlite3-wal and -shm. Targets come back under the \
names that they were saved under, and calibrations; notes, slides and runs do not.")]
pub(crate) struct LibraryRebuildArgs {
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Subcommand)]
pub(crate) enum RunCommand {
    /// What was done, the newest first.
    List(RunListArgs),
    /// One run: what was asked, how it came out, and its report.
    Show(RunShowArgs),
    /// Keep the report of a run, whatever room it takes.
    Pin(RunPinArgs),
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo run list
  scopeservo run list --target mitosis-3
  scopeservo run list --limit 100 --json")]
pub(crate) struct RunListArgs {
    /// So many at most.
    #[arg(long, value_name = "N", default_value_t = 20)]
    pub(crate) limit: usize,
    /// Only those before this one.
    #[arg(long, value_name = "RUN")]
    pub(crate) before: Option<String>,
    /// Only those to this target.
    #[arg(long, value_name = "NAME")]
    pub(crate) target: Option<String>,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo run show 000012_2026-11-24T20-15-00Z_reposition
  scopeservo run show 000012_2026-11-24T20-15-00Z_reposition --report page.html
  scopeservo run show 000012_2026-11-24T20-15-00Z_reposition --events --json")]
pub(crate) struct RunShowArgs {
    /// The run, as `run list` tells it.
    pub(crate) id: String,
    /// Write its report into this file; none is overwritten.
    #[arg(long, value_name = "FILE")]
    pub(crate) report: Option<PathBuf>,
    /// Tell all its events too, as JSON.
    #[arg(long)]
    pub(crate) events: bool,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo run pin 000012_2026-11-24T20-15-00Z_reposition
  scopeservo run pin 000012_2026-11-24T20-15-00Z_reposition --off")]
pub(crate) struct RunPinArgs {
    /// The run, as `run list` tells it.
    pub(crate) id: String,
    /// Let it go again when room is needed.
    #[arg(long)]
    pub(crate) off: bool,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

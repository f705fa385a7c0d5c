//! What several commands take: how they answer, and which instrument they work with.

use clap::Args;
use std::path::PathBuf;

/// How a command answers.
#[derive(Debug, Args)]
pub(crate) struct AnswerArgs {
    /// Print one JSON object on stdout, and no lines for people.
    #[arg(long)]
    pub(crate) json: bool,
}

/// Where the report of a run is put.
#[derive(Debug, Args)]
pub(crate) struct ReportArgs {
    /// Folder for the report; that of an earlier run there is replaced.
    #[arg(long, value_name = "DIR", default_value = "scopeservo-run")]
    pub(crate) out: PathBuf,
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

//! What is done by hand, step by step: see where everything is, take an image, change the objective.

use super::common::{AnswerArgs, InstrumentArgs};
use clap::Args;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo status
  scopeservo status --json

Nothing moves, and nothing is homed: a stage that does not know where it is says so.")]
pub(crate) struct StatusArgs {
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo snap before.png
  scopeservo snap before.png --json

The image as the camera gives it, in full depth: samples of 9 to 15 bits lie in the high bits of 16. Nothing moves, and no file is overwritten.")]
pub(crate) struct SnapArgs {
    /// The file to write, a PNG.
    pub(crate) file: PathBuf,
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo objective            which one is in
  scopeservo objective 40x        retracts as [objective_change] says, turns, and comes back to where 40x is expected in focus
  scopeservo objective 100x --immersion oil

What a rule does not allow is refused, and nothing moves. Nothing goes between oil and air unasked. Ctrl-C stops.")]
pub(crate) struct ObjectiveArgs {
    /// The objective.
    #[arg(value_name = "ID")]
    pub(crate) objective: Option<String>,
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

//! What several commands take: how they answer, and which instrument they work with.

use crate::error::CliError;
use clap::{Args, ValueEnum};
use scopeservo_scope::Immersion;
use scopeservo_servo::{FocusOptions, Measure};
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

/// What a command takes that works with what is kept, without the instrument.
#[derive(Debug, Args)]
pub(crate) struct KeptArgs {
    #[command(flatten)]
    pub(crate) description: ConfigArgs,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

/// Which instrument, and what it may do on opening.
#[derive(Debug, Args)]
pub(crate) struct InstrumentArgs {
    #[command(flatten)]
    pub(crate) description: ConfigArgs,
    /// Allow homing when the stage needs it: it may move anything anywhere.
    #[arg(long)]
    pub(crate) home: bool,
    /// What the specimen was made ready for by hand, before this command: one change of objective to this medium is made without asking.
    #[arg(long, value_name = "MEDIUM", value_parser = medium)]
    pub(crate) immersion: Option<Immersion>,
}

/// A medium by its word.
fn medium(word: &str) -> Result<Immersion, String> {
    let known = Immersion::ALL.map(Immersion::word).join(", ");
    Immersion::of_word(word).ok_or_else(|| format!("there are {known}"))
}

/// How a view is brought into focus.
#[derive(Debug, Args)]
pub(crate) struct FocusingArgs {
    /// How far above and below the present height to look for focus. No sweep goes farther, and none that finds nothing ends nearer to the
    /// specimen than it began.
    #[arg(
        long,
        value_name = "UM",
        default_value_t = 200.0,
        allow_negative_numbers = true
    )]
    range_um: f64,
    /// How sharpness is measured. With a noisy camera the paper's measure is mostly noise.
    #[arg(long, value_enum, default_value = "laplacian")]
    measure: MeasureArg,
    /// Look for the focus in one slow motion first, where that is expected to save time. Needs a stage whose speed can be chosen. `[focus]` in the
    /// description says the same for every command.
    #[arg(long)]
    sweep: bool,
}

impl FocusingArgs {
    pub(crate) fn options(&self) -> Result<FocusOptions, CliError> {
        if !(self.range_um > 0.0 && self.range_um <= 2000.0) {
            return Err(CliError::Usage(
                "--range-um must be above 0 and at most 2000".into(),
            ));
        }
        Ok(FocusOptions {
            half_range_um: self.range_um,
            nearest_um: self.range_um,
            measure: self.measure.into(),
            sweep: self.sweep,
            ..FocusOptions::default()
        })
    }
}

/// How sharpness is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum MeasureArg {
    /// Squares of the Laplacian of the smoothed image, the noise taken off.
    Laplacian,
    /// Squares of the gradient of the smoothed image, the noise taken off.
    Tenengrad,
    /// Power of a band of fine detail, the noise taken off.
    BandPower,
    /// Mean size of the Laplacian of the image as it came.
    Paper,
}

impl From<MeasureArg> for Measure {
    fn from(measure: MeasureArg) -> Self {
        match measure {
            MeasureArg::Laplacian => Self::Laplacian,
            MeasureArg::Tenengrad => Self::Tenengrad,
            MeasureArg::BandPower => Self::BandPower,
            MeasureArg::Paper => Self::Paper,
        }
    }
}

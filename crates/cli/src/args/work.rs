//! What is asked of an instrument: to move, focus, calibrate and come back.

use super::common::{AnswerArgs, FocusingArgs, InstrumentArgs, KeptArgs, ReportArgs};
use super::moving::MovingArgs;
use clap::{Args, Subcommand};
use scopeservo_servo::CalibrationMethod;

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo calibrate                       every objective, from the lowest magnification up
  scopeservo calibrate --objective 40x --json
  scopeservo calibrate --out tuesday         the report goes to tuesday/report.html, also when it fails
  scopeservo calibrate --switching 5         and how well the nosepiece brings each objective back
  scopeservo calibrate --method two-step     as in the paper: fewer views, ten times less precise")]
pub(crate) struct CalibrateArgs {
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    /// An objective to calibrate; may be repeated. All of them by default.
    #[arg(long, value_name = "ID")]
    pub(crate) objective: Vec<String>,
    /// Do not focus first.
    #[arg(long)]
    pub(crate) no_focus: bool,
    /// How: a chain of views, solved at once; or the paper's two steps about one view.
    #[arg(long, value_enum, default_value = "joint")]
    pub(crate) method: MethodArg,
    /// Then let each objective come so often in turn with the lowest one of its medium: how far their centres and heights lie apart, and how well the
    /// nosepiece repeats. From 2 on; 0 for none.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) switching: usize,
    #[command(flatten)]
    pub(crate) focusing: FocusingArgs,
    #[command(flatten)]
    pub(crate) report: ReportArgs,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

/// How to calibrate.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub(crate) enum MethodArg {
    Joint,
    TwoStep,
}

impl From<MethodArg> for CalibrationMethod {
    fn from(method: MethodArg) -> Self {
        match method {
            MethodArg::Joint => Self::Joint,
            MethodArg::TwoStep => Self::TwoStep,
        }
    }
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
    #[command(flatten)]
    pub(crate) focusing: FocusingArgs,
    /// Go to this height first, and focus around it: for a stage that was left retracted.
    #[arg(long, value_name = "UM", allow_negative_numbers = true)]
    pub(crate) near_z_um: Option<f64>,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo grid --pitch-um 100 --objective 10x
  scopeservo grid --pitch-um 20 --objective 40x --json
  scopeservo grid --pitch-um 50 --reach-um 500 --no-focus      a small grid, in focus already

Put in a pattern slide, anywhere within the grid and turned by any angle. The answer has kx, ky and the camera's angle, distortion, tilt of the
field, and how far the stage goes beside what it says. A calibration that is kept is compared with it, and stays as it is: exit code 3 when it
disagrees, or when there is no such grid. A period must have 8 pixels or more, and the image three periods each way.")]
pub(crate) struct GridArgs {
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    /// The pitch: the shortest way on which the pattern repeats, from the middle of a dot to the next. On a chequer board that is to the next
    /// square of one colour, the diagonal of a square.
    #[arg(long, value_name = "UM", allow_negative_numbers = true)]
    pub(crate) pitch_um: f64,
    /// Bring this objective into the beam first.
    #[arg(long, value_name = "ID")]
    pub(crate) objective: Option<String>,
    /// How far the stage goes from where it stands, along x and y.
    #[arg(
        long,
        value_name = "UM",
        default_value_t = 2000.0,
        allow_negative_numbers = true
    )]
    pub(crate) reach_um: f64,
    /// Do not focus first.
    #[arg(long)]
    pub(crate) no_focus: bool,
    #[command(flatten)]
    pub(crate) focusing: FocusingArgs,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo level --objective 40x           measures
  scopeservo level --apply                   and levels, on a stage with rx, ry or both
  scopeservo level --no-focus --json

Over tissue all over the field. The height at which each part of the view is sharpest tells how the specimen is tilted against the focal plane, and what
that costs at a corner beside the depth of field. Levelling turns an axis by a little, sees what that does, and believes nothing that the stage
says of its directions; before each turn the stage retreats by what a lever of --lever-mm may bring the slide nearer. A view that did not get better
is put back. Exit code 3 where the tilt could not be seen, or a tilt that --apply should have taken away is left.")]
pub(crate) struct LevelArgs {
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    /// Bring this objective into the beam first.
    #[arg(long, value_name = "ID")]
    pub(crate) objective: Option<String>,
    /// Level the view. Without, nothing moves but the focus.
    #[arg(long)]
    pub(crate) apply: bool,
    /// The farthest that an axis which tips may lie from the view.
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 300.0,
        allow_negative_numbers = true
    )]
    pub(crate) lever_mm: f64,
    /// Do not focus first.
    #[arg(long)]
    pub(crate) no_focus: bool,
    #[command(flatten)]
    pub(crate) focusing: FocusingArgs,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo check                           every objective with a calibration, from the lowest magnification up
  scopeservo check --objective 40x --no-focus
  scopeservo check --json

Over tissue: two moves of a third of the field and, where the stage turns, a rotation of a degree at most, then home again. Each calibration is
good, drifted (runs still converge; calibrate soon) or to be replaced, with what changed and its standard deviation; the objective that alone
disagrees is named, and so is what all of them share. Exit code 3 unless all are good.")]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    /// An objective to check; may be repeated. All with a calibration by default.
    #[arg(long, value_name = "ID")]
    pub(crate) objective: Vec<String>,
    /// Do not focus first.
    #[arg(long)]
    pub(crate) no_focus: bool,
    #[command(flatten)]
    pub(crate) focusing: FocusingArgs,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo calibrations
  scopeservo calibrations --objective 40x --json

Nothing is opened and nothing moves. The oldest come first; the newest of an objective is the one in use. A change is told with how many standard
deviations it is, where both calibrations know their own.")]
pub(crate) struct CalibrationsArgs {
    /// Only those of this objective.
    #[arg(long, value_name = "ID")]
    pub(crate) objective: Option<String>,
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
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
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
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

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo reposition mitosis-3
  scopeservo reposition mitosis-3 --out run --json
  scopeservo reposition mitosis-3 --method paper   a fifth of the way at a time, at every magnification
  scopeservo reposition mitosis-3 --calibrate      measure the objectives anew on the way
  scopeservo reposition mitosis-3 --within-um 2 --within-deg 10   2 um are near enough, and 10 deg may be left of what the stage cannot turn")]
pub(crate) struct RepositionArgs {
    /// The target's name.
    pub(crate) name: String,
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    /// Calibrate each objective on the way, also those that are calibrated.
    #[arg(long)]
    pub(crate) calibrate: bool,
    #[command(flatten)]
    pub(crate) moving: MovingArgs,
    #[command(flatten)]
    pub(crate) focusing: FocusingArgs,
    #[command(flatten)]
    pub(crate) report: ReportArgs,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo resume
  scopeservo resume --out run --json

Every job keeps a journal. When its program is killed, the job can go on from the step where it was, unless the stage was moved
meanwhile. Until then no other job begins.")]
pub(crate) struct ResumeArgs {
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    #[command(flatten)]
    pub(crate) report: ReportArgs,
    #[command(flatten)]
    pub(crate) answer: AnswerArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo abandon

Nothing moves: the stage stays where it was left.")]
pub(crate) struct AbandonArgs {
    #[command(flatten)]
    pub(crate) kept: KeptArgs,
}

//! What the parts of the page read, and what is said about a run beside what happened in it.

use crate::picture::Gallery;
use crate::stored::Stored;
use crate::timeline::Timeline;
use scopeservo_servo::{Calibration, Verdict};
use serde::{Deserialize, Serialize};

/// All that the parts of the page read.
pub(crate) struct Report<'a> {
    pub(crate) timeline: Timeline<'a>,
    pub(crate) gallery: Gallery,
    pub(crate) truth: Option<&'a Truth>,
    pub(crate) context: &'a Context,
}

impl Report<'_> {
    /// Columns and rows of the target, as good as known: its image's, else those of its calibration.
    pub(crate) fn target_size(&self) -> Option<[f64; 2]> {
        let picture = self.gallery.size("target").map(|(w, h)| [w, h]);
        picture.or_else(|| {
            let calibration = self.timeline.target_calibration()?;
            Some(calibration.image_size_px.map(|v| v as f64))
        })
    }

    /// What the simulation knows of a frame.
    pub(crate) fn true_at(&self, sequence: u64) -> Option<&TrueIteration> {
        self.truth?
            .iterations
            .iter()
            .find(|t| t.sequence == sequence)
    }
}

/// The name of a view in the gallery.
pub(crate) fn view_name(sequence: u64) -> String {
    format!("view{sequence}")
}

/// The answer in a word or two.
pub(crate) fn verdict_word(timeline: &Timeline<'_>) -> &'static str {
    match timeline.outcome.map(|o| o.verdict) {
        Some(Verdict::Arrived) => "Arrived",
        Some(Verdict::NotFound) => "Not found",
        Some(Verdict::Refused) => "Refused",
        Some(Verdict::Ambiguous) => "Ambiguous",
        None => "Unfinished",
    }
}

/// What only a simulation can know; absent on a real instrument.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Distance of the view's centre from the target's when the run ended, um.
    pub error_um: f64,
    /// Angle between view and target when the run ended, degrees.
    pub error_deg: f64,
    /// The same at frames of the servo; may be empty.
    pub iterations: Vec<TrueIteration>,
    /// What the calibrations measured; may be empty.
    pub calibrations: Vec<TrueCalibration>,
}

/// Where a view really was.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct TrueIteration {
    /// The frame.
    pub sequence: u64,
    /// Distance of the view's centre from the target's, um.
    pub error_um: f64,
    /// Angle between view and target, degrees.
    pub error_deg: f64,
    /// The distance on the specimen along the target image's columns, um; positive to its right.
    pub x_um: f64,
    /// The distance on the specimen along the target image's rows, um; positive downwards.
    pub y_um: f64,
}

/// What a calibration should have found, in the paper's parameters.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TrueCalibration {
    /// Name of the objective.
    pub objective: String,
    /// Pixels per metre along image x.
    pub kx_px_per_m: f64,
    /// Pixels per metre along image y.
    pub ky_px_per_m: f64,
    /// Angle between camera and stage, degrees.
    pub phi_deg: f64,
    /// Where the image's centre lies from the axis of rotation, mm.
    pub eta_mm: [f64; 2],
}

/// What a report that is not of a run back to a view tells of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Work {
    /// A calibration of one or more objectives.
    Calibration,
    /// A focus.
    Focus,
    /// A look at how the view is tilted, and levelling it.
    Level,
}

/// Why such work failed.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// In a sentence.
    pub message: String,
    /// Whether somebody stopped it.
    pub stopped: bool,
}

/// How such work ended, beside what happened in it.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkEnd {
    /// Which.
    pub work: Work,
    /// Why it failed; `None` where it did what it should.
    pub failed: Option<Failure>,
    /// The calibrations that were in use before, each with when it was made.
    pub before: Vec<(String, Calibration)>,
}

/// When a view counts as arrived, for drawing it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Convergence {
    /// Distance in pixels of the present view.
    pub position_px: f64,
    /// Angle in degrees, times the ratio of view pixel to target pixel size.
    pub angle_deg: f64,
}

/// What the page says about the run beside what happened in it. Empty texts are left out.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Context {
    /// The page's title.
    pub title: String,
    /// What lay under the objective.
    pub specimen: String,
    /// Which microscope.
    pub instrument: String,
    /// The command that made the run.
    pub command: String,
    /// Seed of everything random in a simulated run.
    pub seed: Option<u64>,
    /// Version of the program.
    pub version: String,
    /// Whether the instrument was a simulated one.
    pub simulated: bool,
    /// Whether the instrument's clock was a simulated one.
    pub virtual_time: bool,
    /// How long the program ran.
    pub wall_time_s: Option<f64>,
    /// Whose image or specimen it is.
    pub credit: Option<String>,
    /// The convergence test in force, when its limits are to be drawn.
    pub convergence: Option<Convergence>,
    /// When the run was made, as people read it.
    #[serde(default)]
    pub date: String,
    /// Name of the saved view.
    #[serde(default)]
    pub target: String,
    /// Calibrations that were known before, the newest of each objective last.
    #[serde(default)]
    pub stored: Vec<Stored>,
}

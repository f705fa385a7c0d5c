//! A run as one self-contained HTML file: the answer first, then how it is known.
//!
//! A [`Recorder`] listens while a run happens. [`html`] turns what it heard into a page of inline SVG and embedded
//! pictures that loads nothing from anywhere. What a run did not come to is said in a sentence where it would stand.
//!
//! Known to this crate: events, frames, calibrations. Unknown: how they came about, and files.

mod answer;
mod calibration;
mod focus;
mod making;
mod matches;
mod page;
mod picture;
mod plots;
mod recorder;
mod story;
mod svg;
mod text;
mod views;

pub use page::html;
pub use recorder::Recorder;

use serde::{Deserialize, Serialize};

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
    /// The distance on the specimen along the target picture's columns, um; positive to its right.
    pub x_um: f64,
    /// The distance on the specimen along the target picture's rows, um; positive downwards.
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
    /// Whether the instrument's clock was a simulated one.
    pub virtual_time: bool,
    /// How long the program ran.
    pub wall_time_s: Option<f64>,
    /// Whose picture or specimen it is.
    pub credit: Option<String>,
    /// The convergence test in force, when its limits are to be drawn.
    pub convergence: Option<Convergence>,
}

//! What a focus is asked for, and what it finds.

use super::measure::Measure;
use serde::{Deserialize, Serialize};

/// Settings of the sweep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FocusOptions {
    /// Half-width of the candidate range around the present height, um.
    pub half_range_um: f64,
    /// No sweep goes nearer to the specimen than this from where the focus began, um.
    pub nearest_um: f64,
    /// How sharpness is measured.
    pub measure: Measure,
    /// What is sharper by less than this factor is no focus.
    pub min_contrast: f64,
    /// Whether the coarse scan is one slow motion, during which frames are grabbed, where that is expected to save time.
    pub sweep: bool,
}

impl Default for FocusOptions {
    fn default() -> Self {
        Self {
            half_range_um: 200.0,
            nearest_um: 200.0,
            measure: Measure::default(),
            min_contrast: 1.04,
            sweep: false,
        }
    }
}

/// Where the focus is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FocusResult {
    /// Height of the stage, um. `None` when the stage has no z and nothing was done.
    pub z_um: Option<f64>,
    /// Standard deviation of that, um: by the scatter of the samples about the fitted peak, and what an asymmetric blur moves it by.
    #[serde(default)]
    pub sigma_um: Option<f64>,
    /// Sharpness near there.
    pub sharpness: f64,
    /// Largest over smallest sharpness of the sweep.
    pub contrast: f64,
    /// Frames used.
    pub samples: usize,
}

/// What came of a sweep. Stable words: added to, never renamed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SweepEnd {
    /// A peak was seen, and looked at closer.
    Found,
    /// The camera is too slow, or the stage settles too fast, for a sweep to save time: none was made.
    NoFaster,
    /// The stage has one speed, or refused the move: none was made.
    Refused,
    /// The stage did not tell where it was while it moved, or too few frames came, or their time stamps cannot be: nothing counted.
    Unknown,
    /// No peak was seen.
    NoPeak,
}

/// A coarse scan in motion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FocusSweep {
    /// Lowest and highest z that were swept, um; both where the sweep began when none was made.
    pub range_um: [f64; 2],
    /// How fast, um/s.
    pub um_per_s: f64,
    /// Frames that were taken in motion.
    pub frames: usize,
    /// Those whose height is known.
    pub counted: usize,
    /// What came of it. All but [`SweepEnd::Found`] is followed by the settled scan.
    pub end: SweepEnd,
    /// Where the peak seemed to lie, um.
    pub near_um: Option<f64>,
}

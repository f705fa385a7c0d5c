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

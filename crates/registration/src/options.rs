//! The settings of a registration.

use serde::{Deserialize, Serialize};

/// How minimal hypotheses are made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// From one oriented, scaled match.
    #[default]
    Oriented,
    /// From three matches, as in the paper.
    ThreePoint,
}

/// Settings of a registration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Nearest over second nearest descriptor distance, at most.
    pub ratio: f32,
    /// A match agrees with the transform when it lands this near, in pixels of the coarser image.
    pub threshold_px: f64,
    /// Expected number of false "found" per registration of unrelated images, at most.
    pub false_alarms: f64,
    /// A transform is refused when the predicted standard deviation of a view corner, in target pixels, is larger.
    pub max_corner_sigma_px: f64,
    /// How minimal hypotheses are made.
    pub method: Method,
    /// Seed of the random samples.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            ratio: 0.85,
            threshold_px: 2.5,
            false_alarms: 1e-6,
            max_corner_sigma_px: 12.0,
            method: Method::Oriented,
            seed: 0,
        }
    }
}

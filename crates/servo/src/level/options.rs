//! What levelling is asked for, and what it tells.

use super::tilt::TiltReport;
use crate::focus::FocusOptions;
use serde::{Deserialize, Serialize};

/// Settings of levelling.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LevelOptions {
    /// Whether to level, on a stage with an axis that tips; else the tilt is measured only.
    pub apply: bool,
    /// How to focus after each turn. The range is that of the turn.
    pub focus: FocusOptions,
    /// The farthest that an axis which tips may lie from the view, mm: the stage retreats accordingly.
    pub lever_mm: f64,
    /// Corrections, at most.
    pub rounds: u8,
}

impl Default for LevelOptions {
    fn default() -> Self {
        Self {
            apply: false,
            focus: FocusOptions::default(),
            lever_mm: 300.0,
            rounds: 5,
        }
    }
}

/// What was measured, and what levelling did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LevelReport {
    /// The tilt that was there.
    pub before: TiltReport,
    /// `None` where it was measured only, was level, or the stage has no axis that tips.
    pub levelled: Option<Levelled>,
    /// Whether the stage has an axis that tips.
    pub can_tip: bool,
}

/// What levelling did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Levelled {
    /// The tilt that is left.
    pub after: TiltReport,
    /// Whether that is none that anybody sees; else it is half of what it was, or less.
    pub level: bool,
    /// How far rx and ry stand from where they stood, deg; `None` for one that the stage lacks.
    pub turned_deg: [Option<f64>; 2],
    /// How far the focus goes along z by a turn of rx and ry, um per mrad.
    pub lever_um_per_mrad: [Option<f64>; 2],
    /// Corrections.
    pub rounds: u8,
}

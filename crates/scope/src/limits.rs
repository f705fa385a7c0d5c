//! The stage that the servo side receives: one that refuses what is outside its limits.

use crate::{Axis, Motion, ScopeError, Stage, StageInfo, StagePose};
use serde::{Deserialize, Serialize};

/// An allowed interval of one axis, SI units (m, rad), ends included.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AxisRange {
    /// Which axis.
    pub axis: Axis,
    /// Lower limit.
    pub min: f64,
    /// Upper limit.
    pub max: f64,
}

/// Limits that a user sets, narrower than the stage's travel. An axis not named keeps its travel.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Limits {
    /// The ranges set.
    pub ranges: Vec<AxisRange>,
}

/// A stage behind its limits. There is no way to move an [`crate::Instrument`] but through this type: a request is
/// carried out whole, or refused whole with the reason, and never clipped.
pub struct CheckedStage {
    stage: Box<dyn Stage>,
    ranges: Vec<AxisRange>,
}

impl CheckedStage {
    /// Puts `stage` behind its own travel and the user's limits, whichever is narrower.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] when a range is empty or not finite, [`ScopeError::NoSuchAxis`] when it names an
    /// axis that the stage lacks.
    pub fn new(stage: Box<dyn Stage>, limits: &Limits) -> Result<Self, ScopeError> {
        for range in &limits.ranges {
            if stage.info().axis(range.axis).is_none() {
                return Err(ScopeError::NoSuchAxis { axis: range.axis });
            }
        }
        let mut ranges = Vec::new();
        for info in &stage.info().axes {
            let (mut min, mut max) = (info.min, info.max);
            for range in limits.ranges.iter().filter(|r| r.axis == info.axis) {
                // f64::max would silently drop a NaN limit, so look first.
                if !(range.min.is_finite() && range.max.is_finite()) {
                    return Err(ScopeError::BadSetting {
                        what: format!("the limits of {} must be finite numbers", info.axis),
                    });
                }
                min = min.max(range.min);
                max = max.min(range.max);
            }
            if !(min <= max && min.is_finite() && max.is_finite()) {
                return Err(ScopeError::BadSetting {
                    what: format!(
                        "the limits of {} leave no room to move: {} to {} {}",
                        info.axis,
                        info.axis.to_display(min),
                        info.axis.to_display(max),
                        info.axis.display_unit()
                    ),
                });
            }
            ranges.push(AxisRange {
                axis: info.axis,
                min,
                max,
            });
        }
        Ok(Self { stage, ranges })
    }

    /// What the stage is.
    pub fn info(&self) -> &StageInfo {
        self.stage.info()
    }

    /// The limits in force, one for each axis that the stage has.
    pub fn ranges(&self) -> &[AxisRange] {
        &self.ranges
    }

    /// Whether a move there would be let through.
    ///
    /// # Errors
    /// [`ScopeError::OutsideLimits`], [`ScopeError::NoSuchAxis`] or [`ScopeError::NotFinite`].
    pub fn check(&self, to: &StagePose) -> Result<(), ScopeError> {
        for axis in Axis::ALL {
            let Some(asked) = to.si(axis) else { continue };
            let Some(range) = self.ranges.iter().find(|r| r.axis == axis) else {
                return Err(ScopeError::NoSuchAxis { axis });
            };
            if !asked.is_finite() {
                return Err(ScopeError::NotFinite { axis });
            }
            if asked < range.min || asked > range.max {
                return Err(ScopeError::OutsideLimits {
                    axis,
                    asked: axis.to_display(asked),
                    min: axis.to_display(range.min),
                    max: axis.to_display(range.max),
                });
            }
        }
        Ok(())
    }

    /// Where the stage says it is.
    pub fn position(&self) -> Result<StagePose, ScopeError> {
        self.stage.position()
    }

    /// Starts a move if the limits allow it.
    pub fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.check(to)?;
        self.stage.start_move(to)
    }

    /// What the stage is doing.
    pub fn poll(&self) -> Result<Motion, ScopeError> {
        self.stage.poll()
    }

    /// Stops at once, from any thread.
    pub fn stop(&self) -> Result<(), ScopeError> {
        self.stage.stop()
    }
}

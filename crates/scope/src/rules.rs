//! What a motion gate is told to allow. SI units (m, rad), ends included.

use crate::{Axis, AxisInfo, Objective, ObjectiveId, PositiveZ, ScopeError, StageInfo};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// An allowed interval of one axis.
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

/// The longest way that one move may go along an axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LargestStep {
    /// Which axis.
    pub axis: Axis,
    /// Its length.
    pub step: f64,
}

/// How the axes share their travel.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Workspace {
    /// Each axis has its whole travel wherever the others are: stacked stages.
    #[default]
    Box,
    /// The shares of travel that the axes use, from the middle, add up in squares to 1 at most. A hexapod's legs are shared by
    /// all axes: none has its whole travel while another uses its own. This is a model inside the true workspace of common
    /// hexapods; the controller knows the true one and refuses by itself.
    Ellipsoid,
}

/// A part of the x-y plane in which objectives must stay farther away: a clamp, the edge of a holder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Zone {
    /// What is there, for people.
    pub name: String,
    /// From where to where along x, stage coordinates.
    pub x: [f64; 2],
    /// The same along y.
    pub y: [f64; 2],
    /// The z nearest to the specimen that is allowed there.
    pub closest_z: f64,
    /// The objectives that this is for; empty for all.
    pub objectives: Vec<ObjectiveId>,
}

/// When the nosepiece may turn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChangeRule {
    /// At any height: somebody looked at it and no objective can touch anything on its way.
    Anywhere,
    /// Only from `z` on, away from the specimen.
    Retracted {
        /// The height.
        z: f64,
        /// How far from the height that is expected to be in focus an objective stops whose focus was never found, away from the
        /// specimen.
        margin: f64,
    },
}

/// Everything that a [`crate::MotionGate`] is told.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rules {
    /// For all objectives.
    pub limits: Limits,
    /// Further limits while an objective is active, or may be.
    pub objective_limits: BTreeMap<ObjectiveId, Limits>,
    /// The longest single moves. A retreat along z alone may be longer.
    pub largest_steps: Vec<LargestStep>,
    /// How the axes share their travel.
    pub workspace: Workspace,
    /// Where objectives must stay away.
    pub zones: Vec<Zone>,
    /// When the nosepiece may turn.
    pub change: ChangeRule,
}

impl Rules {
    /// The stage's travel and nothing more.
    pub fn travel_only(change: ChangeRule) -> Self {
        Self {
            limits: Limits::default(),
            objective_limits: BTreeMap::new(),
            largest_steps: Vec::new(),
            workspace: Workspace::Box,
            zones: Vec::new(),
            change,
        }
    }

    /// Whether these rules make sense for a stage and its objectives, and the limits of each axis.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] when a range is empty or not finite or names an unknown objective, or what the stage says of an axis
    /// cannot be; [`ScopeError::NoSuchAxis`] when one names an axis that the stage lacks.
    pub(crate) fn ranges(
        &self,
        stage: &StageInfo,
        objectives: &[ObjectiveId],
    ) -> Result<Vec<AxisRange>, ScopeError> {
        for axis in &stage.axes {
            axis.check()?;
        }
        let travel: Vec<AxisRange> = stage
            .axes
            .iter()
            .map(|i| AxisRange {
                axis: i.axis,
                min: i.min,
                max: i.max,
            })
            .collect();
        let ranges = narrowed(&travel, &self.limits, stage)?;
        self.check_objective_limits(stage, &ranges, objectives)?;
        self.check_largest_steps(stage)?;
        self.check_zones(stage, objectives)?;
        self.check_change(stage, &ranges)?;
        Ok(ranges)
    }

    /// The limits of single objectives are for those that there are, and leave room for the retreat.
    fn check_objective_limits(
        &self,
        stage: &StageInfo,
        ranges: &[AxisRange],
        objectives: &[ObjectiveId],
    ) -> Result<(), ScopeError> {
        for (id, limits) in &self.objective_limits {
            if !objectives.contains(id) {
                return bad(format!(
                    "limits are set for {id}, which is no objective here"
                ));
            }
            let own = narrowed(ranges, limits, stage)?;
            if let ChangeRule::Retracted { z, .. } = self.change
                && let Some(room) = own.iter().find(|r| r.axis == Axis::Z)
                && !holds_retreat(room, z, stage)
            {
                return bad(format!(
                    "the limits of {id} leave out the height at which objectives change, z = {:.1} um, and {:.1} um beyond it, which a \
                     retreat needs",
                    z * 1e6,
                    clearance(stage) * 1e6
                ));
            }
        }
        Ok(())
    }

    fn check_largest_steps(&self, stage: &StageInfo) -> Result<(), ScopeError> {
        for largest in &self.largest_steps {
            needed(stage, largest.axis)?;
            if !(largest.step.is_finite() && largest.step > 0.0) {
                return bad(format!(
                    "the largest step of {} must be above 0",
                    largest.axis
                ));
            }
        }
        Ok(())
    }

    fn check_zones(&self, stage: &StageInfo, objectives: &[ObjectiveId]) -> Result<(), ScopeError> {
        for zone in &self.zones {
            for axis in [Axis::X, Axis::Y, Axis::Z] {
                needed(stage, axis)?;
            }
            let rises = |r: [f64; 2]| r[0].is_finite() && r[1].is_finite() && r[0] <= r[1];
            if !(rises(zone.x) && rises(zone.y) && zone.closest_z.is_finite()) {
                return bad(format!(
                    "the zone '{}' must have x and y from smaller to larger, and a height",
                    zone.name
                ));
            }
            if let Some(id) = zone.objectives.iter().find(|id| !objectives.contains(id)) {
                return bad(format!(
                    "the zone '{}' is for {id}, which is no objective here",
                    zone.name
                ));
            }
        }
        Ok(())
    }

    /// Objectives change where the stage can retreat to.
    fn check_change(&self, stage: &StageInfo, ranges: &[AxisRange]) -> Result<(), ScopeError> {
        let ChangeRule::Retracted { z, margin } = self.change else {
            return Ok(());
        };
        let info = needed(stage, Axis::Z)?;
        let range = ranges.iter().find(|r| r.axis == Axis::Z);
        let inside = range.is_some_and(|r| holds_retreat(r, z, stage));
        if !(margin.is_finite() && margin >= 0.0) {
            return bad("the margin of an objective change must not be negative".into());
        }
        if !inside {
            return bad(format!(
                "objectives are to change from z = {:.1} um on, and a retreat goes {:.1} um beyond that, farther than z repeats to: \
                 this is outside the limits of z, {:.1} to {:.1} um",
                z * 1e6,
                clearance(stage) * 1e6,
                range.map_or(info.min, |r| r.min) * 1e6,
                range.map_or(info.max, |r| r.max) * 1e6
            ));
        }
        Ok(())
    }

    /// Whether these rules make sense for a stage and its objectives.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] and [`ScopeError::NoSuchAxis`].
    pub fn check(&self, stage: &StageInfo, objectives: &[Objective]) -> Result<(), ScopeError> {
        let ids: Vec<ObjectiveId> = objectives.iter().map(|o| o.id.clone()).collect();
        self.ranges(stage, &ids).map(drop)
    }
}

fn clearance(stage: &StageInfo) -> f64 {
    stage.axis(Axis::Z).map_or(0.0, AxisInfo::clearance)
}

/// Whether a range of z holds the height from which on the nosepiece may turn, and where a retreat to it goes.
fn holds_retreat(range: &AxisRange, z: f64, stage: &StageInfo) -> bool {
    let beyond = stage.positive_z.away(z, clearance(stage));
    [z, beyond]
        .iter()
        .all(|z| (range.min..=range.max).contains(z))
}

fn bad(what: String) -> Result<(), ScopeError> {
    Err(ScopeError::BadSetting { what })
}

/// An axis that a rule is about.
fn needed(stage: &StageInfo, axis: Axis) -> Result<&AxisInfo, ScopeError> {
    stage.axis(axis).ok_or(ScopeError::NoSuchAxis { axis })
}

/// `ranges` narrowed by `limits`.
pub(crate) fn narrowed(
    ranges: &[AxisRange],
    limits: &Limits,
    stage: &StageInfo,
) -> Result<Vec<AxisRange>, ScopeError> {
    if let Some(range) = limits
        .ranges
        .iter()
        .find(|range| stage.axis(range.axis).is_none())
    {
        return Err(ScopeError::NoSuchAxis { axis: range.axis });
    }
    ranges
        .iter()
        .map(|&AxisRange { axis, min, max }| {
            let (mut low, mut high) = (min, max);
            for range in limits.ranges.iter().filter(|r| r.axis == axis) {
                // f64::max would silently drop a NaN limit, so look first.
                if !(range.min.is_finite() && range.max.is_finite()) {
                    return Err(ScopeError::BadSetting {
                        what: format!("the limits of {axis} must be finite numbers"),
                    });
                }
                low = low.max(range.min);
                high = high.min(range.max);
            }
            if !(low <= high && low.is_finite() && high.is_finite()) {
                return Err(ScopeError::BadSetting {
                    what: format!(
                        "the limits of {axis} leave no room to move: {} to {} {}",
                        axis.to_display(low),
                        axis.to_display(high),
                        axis.display_unit()
                    ),
                });
            }
            Ok(AxisRange {
                axis,
                min: low,
                max: high,
            })
        })
        .collect()
}

impl PositiveZ {
    /// How much nearer to the specimen `z` is than `reference`, metres; negative when it is farther.
    pub fn nearer_by(self, z: f64, reference: f64) -> f64 {
        match self {
            PositiveZ::Closer => z - reference,
            PositiveZ::Apart => reference - z,
        }
    }

    /// The height `by` metres farther from the specimen than `z`.
    pub fn away(self, z: f64, by: f64) -> f64 {
        match self {
            PositiveZ::Closer => z - by,
            PositiveZ::Apart => z + by,
        }
    }
}

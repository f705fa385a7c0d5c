//! Which objective comes next.

use super::MagnificationResult;
use crate::ServoEnd;
use scopeservo_scope::{Objective, ObjectiveId};
use serde::{Deserialize, Serialize};

/// One objective of a run, and what for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Leg {
    /// Calibration alone.
    Calibrate(ObjectiveId),
    /// The servo, with a calibration before it where there is none.
    Servo(ObjectiveId),
}

impl Leg {
    /// The objective.
    pub fn objective(&self) -> &ObjectiveId {
        match self {
            Self::Calibrate(objective) | Self::Servo(objective) => objective,
        }
    }
}

/// What a policy goes by.
#[derive(Debug, Clone, Copy)]
pub struct SoFar<'a> {
    /// The objectives of the instrument.
    pub objectives: &'a [Objective],
    /// The target's objective.
    pub target: &'a ObjectiveId,
    /// Whether that is calibrated.
    pub target_is_calibrated: bool,
    /// The magnifications that were servoed, in order.
    pub done: &'a [MagnificationResult],
}

/// Chooses the objectives of a run, one after the other.
pub trait LegPolicy {
    /// The next leg; `None` after the last.
    fn next(&self, so_far: &SoFar<'_>) -> Option<Leg>;
    /// The objectives that are likely to be servoed, in order.
    fn outlook(&self, so_far: &SoFar<'_>) -> Vec<ObjectiveId>;
}

/// Algorithm 1, lines 2 and 6: the target's objective first, for K_t, unless that is known; then every objective up to the target's,
/// from the lowest magnification on.
#[derive(Debug, Clone, Copy, Default)]
pub struct Ladder;

impl LegPolicy for Ladder {
    fn next(&self, so_far: &SoFar<'_>) -> Option<Leg> {
        let rungs = self.outlook(so_far);
        if so_far.done.is_empty() && rungs.len() > 1 && !so_far.target_is_calibrated {
            return Some(Leg::Calibrate(so_far.target.clone()));
        }
        rungs.get(so_far.done.len()).cloned().map(Leg::Servo)
    }

    fn outlook(&self, so_far: &SoFar<'_>) -> Vec<ObjectiveId> {
        let rungs = rungs(so_far.objectives, so_far.target);
        rungs.iter().map(|o| o.id.clone()).collect()
    }
}

/// The target's objective and those below it, from the lowest magnification on.
fn rungs<'a>(objectives: &'a [Objective], target: &ObjectiveId) -> Vec<&'a Objective> {
    let Some(last) = objectives.iter().find(|o| o.id == *target) else {
        return Vec::new();
    };
    let mut rungs: Vec<_> = objectives
        .iter()
        .filter(|o| o.id == last.id || o.magnification < last.magnification)
        .collect();
    rungs.sort_by(|a, b| a.magnification.total_cmp(&b.magnification));
    rungs
}

/// Those above one of them.
pub(super) fn rungs_above<'a>(
    objectives: &'a [Objective],
    here: &ObjectiveId,
    target: &ObjectiveId,
) -> Vec<&'a Objective> {
    let mut all = rungs(objectives, target);
    let below = all.iter().position(|o| o.id == *here);
    all.drain(..below.map_or(0, |k| k + 1));
    all
}

/// Direct control: from the lowest magnification to whichever took over, the target's own if possible. What was handed over and is not seen there is
/// looked for once with the objectives that were passed over.
#[derive(Debug, Clone, Copy, Default)]
pub struct Shortest;

impl LegPolicy for Shortest {
    fn next(&self, so_far: &SoFar<'_>) -> Option<Leg> {
        let rungs = self.outlook(so_far);
        if so_far.done.is_empty() && rungs.len() > 1 && !so_far.target_is_calibrated {
            return Some(Leg::Calibrate(so_far.target.clone()));
        }
        let Some(last) = so_far.done.last() else {
            return rungs.first().cloned().map(Leg::Servo);
        };
        let at = rungs.iter().position(|id| *id == last.objective)?;
        let untried = |id: &&ObjectiveId| so_far.done.iter().all(|d| d.objective != **id);
        let next = match &last.end {
            ServoEnd::HandedOver { to, .. } => Some(to),
            // The highest of those that were passed over is the nearest to what was known.
            ServoEnd::Lost(_) => rungs[..at].iter().rev().find(untried).or(rungs.get(at + 1)),
            _ => rungs.get(at + 1),
        };
        next.cloned().map(Leg::Servo)
    }

    fn outlook(&self, so_far: &SoFar<'_>) -> Vec<ObjectiveId> {
        Ladder.outlook(so_far)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ladder_begins_with_the_targets_calibration_and_climbs() {
        let objectives: Vec<Objective> = [("40x", 40.0), ("4x", 4.0), ("10x", 10.0)]
            .map(|(id, magnification)| Objective {
                id: ObjectiveId(id.into()),
                magnification,
                nominal_um_per_px: 4.0 / magnification,
                numerical_aperture: 0.1,
            })
            .into();
        let target = ObjectiveId("10x".into());
        let mut so_far = SoFar {
            objectives: &objectives,
            target: &target,
            target_is_calibrated: false,
            done: &[],
        };
        assert_eq!(Ladder.next(&so_far), Some(Leg::Calibrate(target.clone())));
        so_far.target_is_calibrated = true;
        let lowest = ObjectiveId("4x".into());
        assert_eq!(Ladder.next(&so_far), Some(Leg::Servo(lowest.clone())));
        assert_eq!(Ladder.outlook(&so_far), [lowest, target.clone()]);
        so_far.objectives = &objectives[2..];
        so_far.target_is_calibrated = false;
        assert_eq!(
            Ladder.next(&so_far),
            Some(Leg::Servo(target.clone())),
            "calibrated on the way"
        );
    }
}

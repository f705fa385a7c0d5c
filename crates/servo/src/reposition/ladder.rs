//! Which objective comes next.

use super::MagnificationResult;
use crate::ServoEnd;
use scopeservo_scope::{Immersion, Objective, ObjectiveId};
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
    /// What was on the specimen when the run began, where that is known.
    pub immersion: Option<Immersion>,
    /// The magnifications that were servoed, in order.
    pub done: &'a [MagnificationResult],
}

/// Chooses the objectives of a run, one after the other.
pub trait LegPolicy {
    /// The next leg; `None` after the last.
    fn next(&self, so_far: &SoFar<'_>) -> Option<Leg>;
    /// The objectives that are likely to be servoed, in order.
    fn outlook(&self, so_far: &SoFar<'_>) -> Vec<ObjectiveId>;
    /// Where the run goes on after the target was not seen at all; `None` where it ends.
    fn wider(&self, so_far: &SoFar<'_>) -> Option<Leg>;
}

/// Algorithm 1, lines 2 and 6: the target's objective first, for K_t, unless that is known; then every objective up to the target's,
/// from the lowest magnification on.
///
/// Each change to another medium takes somebody who makes the specimen ready. So a ladder makes one at the most, from what the objective of
/// the lowest magnification works in to what the target's does. Where that is on the specimen already the run begins with the objectives
/// that work in it, and only a target that they do not see is looked for with the whole ladder.
#[derive(Debug, Clone, Copy, Default)]
pub struct Ladder;

impl LegPolicy for Ladder {
    fn next(&self, so_far: &SoFar<'_>) -> Option<Leg> {
        let rungs = self.outlook(so_far);
        if so_far.done.is_empty() && rungs.len() > 1 && !so_far.target_is_calibrated {
            return Some(Leg::Calibrate(so_far.target.clone()));
        }
        let before = widened_at(so_far).unwrap_or(0);
        rungs
            .get(so_far.done.len() - before)
            .cloned()
            .map(Leg::Servo)
    }

    fn outlook(&self, so_far: &SoFar<'_>) -> Vec<ObjectiveId> {
        let [wider, own] = rungs(so_far);
        let as_it_is = so_far.immersion.is_some_and(|now| {
            let there = own.first();
            there.is_some_and(|o| o.immersion == now) && widened_at(so_far).is_none()
        });
        let wider = wider.iter().filter(|_| !as_it_is);
        wider.chain(&own).map(|o| o.id.clone()).collect()
    }

    fn wider(&self, so_far: &SoFar<'_>) -> Option<Leg> {
        let [wider, _] = rungs(so_far);
        let goes_on = widened_at(so_far).is_none().then_some(wider.first());
        goes_on.flatten().map(|o| Leg::Servo(o.id.clone()))
    }
}

/// The objectives up to the target's, from the lowest magnification on: those before the change to the target's medium, and those after it.
fn rungs<'a>(so_far: &SoFar<'a>) -> [Vec<&'a Objective>; 2] {
    let Some(last) = so_far.objectives.iter().find(|o| o.id == *so_far.target) else {
        return [Vec::new(), Vec::new()];
    };
    let up_to_it = |o: &&Objective| o.id == last.id || o.magnification < last.magnification;
    let mut all: Vec<_> = so_far.objectives.iter().filter(up_to_it).collect();
    all.sort_by(|a, b| a.magnification.total_cmp(&b.magnification));
    let (lowest, own) = (all[0].immersion, last.immersion);
    let change = all.iter().position(|o| o.immersion == own).unwrap_or(0);
    let (wider, rest) = all.split_at(change);
    let of = |all: &[&'a Objective], medium: Immersion| {
        let of_it = all.iter().filter(|o| o.immersion == medium);
        of_it.copied().collect()
    };
    [of(wider, lowest), of(rest, own)]
}

/// How many magnifications had been servoed when the run went on with the whole ladder, or began with it; `None` where only objectives of the
/// target's medium were used.
fn widened_at(so_far: &SoFar<'_>) -> Option<usize> {
    let [wider, _] = rungs(so_far);
    let lowest = wider.first()?;
    so_far.done.iter().position(|d| d.objective == lowest.id)
}

/// Direct control: from the lowest magnification to whichever took over, the target's own if possible. What was handed over and is not seen there is
/// looked for once with the objectives that were passed over, and then with the lowest again.
#[derive(Debug, Clone, Copy, Default)]
pub struct Shortest;

impl LegPolicy for Shortest {
    fn next(&self, so_far: &SoFar<'_>) -> Option<Leg> {
        let rungs = self.outlook(so_far);
        if so_far.done.is_empty() && rungs.len() > 1 && !so_far.target_is_calibrated {
            return Some(Leg::Calibrate(so_far.target.clone()));
        }
        let done = &so_far.done[widened_at(so_far).unwrap_or(0)..];
        let Some(last) = done.last() else {
            return rungs.first().cloned().map(Leg::Servo);
        };
        let at = rungs.iter().position(|id| *id == last.objective)?;
        let untried = |id: &&ObjectiveId| done.iter().all(|d| d.objective != **id);
        let next = match &last.end {
            ServoEnd::HandedOver { to, .. } => Some(to),
            // The highest of those that were passed over is the nearest to what was known.
            ServoEnd::Lost(_) => {
                let passed = rungs[..at].iter().rev().find(untried);
                // Where it was seen first it is looked for once more.
                let lowest = rungs.first().filter(|id| {
                    let handed = matches!(done[0].end, ServoEnd::HandedOver { .. });
                    at > 0 && handed && done.iter().filter(|d| d.objective == **id).count() == 1
                });
                passed.or(rungs.get(at + 1).filter(untried)).or(lowest)
            }
            _ => rungs.get(at + 1),
        };
        next.cloned().map(Leg::Servo)
    }

    fn outlook(&self, so_far: &SoFar<'_>) -> Vec<ObjectiveId> {
        Ladder.outlook(so_far)
    }

    fn wider(&self, so_far: &SoFar<'_>) -> Option<Leg> {
        Ladder.wider(so_far)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Calibration, PoseError, ServoEnd, ServoResult};
    use scopeservo_geometry::Mat2;
    use scopeservo_registration::NotFound;

    fn nosepiece(objectives: &[(&str, f64, Immersion)]) -> Vec<Objective> {
        let of = |(id, magnification, immersion): &(&str, f64, Immersion)| Objective {
            id: ObjectiveId((*id).into()),
            magnification: *magnification,
            nominal_um_per_px: 4.0 / magnification,
            numerical_aperture: 0.1,
            immersion: *immersion,
        };
        objectives.iter().map(of).collect()
    }

    /// A magnification at which nothing was seen.
    fn lost(objective: &str) -> MagnificationResult {
        MagnificationResult {
            objective: ObjectiveId(objective.into()),
            magnification: 1.0,
            end: ServoEnd::Lost(NotFound::TooFewFeatures {
                view: 0,
                target: 0,
                needed: 1,
            }),
            calibration: Calibration {
                schema: crate::CALIBRATION_SCHEMA,
                objective: ObjectiveId(objective.into()),
                image_size_px: [640, 480],
                stage_from_pixel: Mat2::IDENTITY,
                rotation_centre_m: None,
                covariance: None,
                backlash: None,
                scatter: None,
            },
        }
    }

    fn names(all: &[ObjectiveId]) -> Vec<&str> {
        all.iter().map(|id| id.0.as_str()).collect()
    }

    #[test]
    fn a_ladder_begins_with_the_targets_calibration_and_climbs() {
        let objectives = nosepiece(&[
            ("40x", 40.0, Immersion::Air),
            ("4x", 4.0, Immersion::Air),
            ("10x", 10.0, Immersion::Air),
        ]);
        let target = ObjectiveId("10x".into());
        let mut so_far = SoFar {
            objectives: &objectives,
            target: &target,
            target_is_calibrated: false,
            immersion: Some(Immersion::Air),
            done: &[],
        };
        assert_eq!(Ladder.next(&so_far), Some(Leg::Calibrate(target.clone())));
        so_far.target_is_calibrated = true;
        let lowest = ObjectiveId("4x".into());
        assert_eq!(Ladder.next(&so_far), Some(Leg::Servo(lowest.clone())));
        assert_eq!(Ladder.outlook(&so_far), [lowest, target.clone()]);
        assert_eq!(Ladder.wider(&so_far), None);
        so_far.objectives = &objectives[2..];
        so_far.target_is_calibrated = false;
        assert_eq!(
            Ladder.next(&so_far),
            Some(Leg::Servo(target.clone())),
            "calibrated on the way"
        );
    }

    #[test]
    fn a_ladder_changes_the_medium_once_at_the_most_and_not_before_it_has_to() {
        use Immersion::{Air, Oil, Water};
        let objectives = nosepiece(&[
            ("10x", 10.0, Air),
            ("20x", 20.0, Water),
            ("40x", 40.0, Air),
            ("60x", 60.0, Oil),
            ("63x", 63.0, Air),
            ("100x", 100.0, Oil),
        ]);
        let outlook = |target: &str, immersion| {
            let target = ObjectiveId(target.into());
            let so_far = SoFar {
                objectives: &objectives,
                target: &target,
                target_is_calibrated: true,
                immersion,
                done: &[],
            };
            names(&Ladder.outlook(&so_far)).join(" ")
        };
        // Whatever dry objective is in: those that work in water are left out.
        assert_eq!(outlook("63x", Some(Air)), "10x 40x 63x");
        assert_eq!(outlook("63x", Some(Oil)), "10x 40x 63x");
        assert_eq!(outlook("20x", Some(Air)), "10x 20x");
        // Dry until the first objective of the target's medium, and then in that.
        for now in [None, Some(Air), Some(Water)] {
            assert_eq!(outlook("100x", now), "10x 40x 60x 100x");
        }
        assert_eq!(outlook("100x", Some(Oil)), "60x 100x");
    }

    #[test]
    fn in_oil_already_a_run_looks_there_first_and_widens_where_nothing_was_seen() {
        use Immersion::{Air, Oil};
        let objectives = nosepiece(&[("10x", 10.0, Air), ("40x", 40.0, Air), ("100x", 100.0, Oil)]);
        let target = ObjectiveId("100x".into());
        let leg = |id: &str| Some(Leg::Servo(ObjectiveId(id.into())));
        let mut so_far = SoFar {
            objectives: &objectives,
            target: &target,
            target_is_calibrated: true,
            immersion: Some(Oil),
            done: &[],
        };
        assert_eq!(Ladder.next(&so_far), leg("100x"));
        let done: Vec<_> = ["100x", "10x", "40x", "100x"].map(lost).into();
        let then = [
            (None, leg("10x")),
            (leg("40x"), None),
            (leg("100x"), None),
            (None, None),
        ];
        for (count, then) in then.into_iter().enumerate() {
            so_far.done = &done[..=count];
            assert_eq!(
                (Ladder.next(&so_far), Ladder.wider(&so_far)),
                then,
                "{count}"
            );
        }
    }

    #[test]
    fn the_shortest_way_leaves_out_what_is_handed_over_past_and_tries_it_once_where_the_target_is_lost()
     {
        use Immersion::Air;
        let objectives = nosepiece(&[("10x", 10.0, Air), ("20x", 20.0, Air), ("40x", 40.0, Air)]);
        let target = ObjectiveId("40x".into());
        let handed = |from: &str, to: &str| MagnificationResult {
            end: ServoEnd::HandedOver {
                to: ObjectiveId(to.into()),
                lands_within_um: 10.0,
                last: ServoResult {
                    iterations: 1,
                    inliers: 50,
                    error: PoseError {
                        t_m: [1e-4; 2],
                        theta_rad: 0.0,
                    },
                    sigma_um: 0.1,
                    sigma_deg: 0.001,
                    limited_by: None,
                    angle_is_left: false,
                },
            },
            ..lost(from)
        };
        let next = |done: &[MagnificationResult]| {
            let so_far = SoFar {
                objectives: &objectives,
                target: &target,
                target_is_calibrated: true,
                immersion: Some(Air),
                done,
            };
            Shortest.next(&so_far).map(|leg| leg.objective().0.clone())
        };
        let past = || handed("10x", "40x");
        assert_eq!(next(&[]).as_deref(), Some("10x"));
        assert_eq!(next(&[past()]).as_deref(), Some("40x"));
        assert_eq!(next(&[past(), lost("40x")]).as_deref(), Some("20x"));
        let lowest = [past(), lost("40x"), lost("20x")];
        assert_eq!(next(&lowest).as_deref(), Some("10x"));
        let anew = |end| next(&[&lowest[..], &[past(), end]].concat());
        assert_eq!(
            next(&[&lowest[..], &[past()]].concat()).as_deref(),
            Some("40x")
        );
        assert_eq!(anew(lost("40x")), None, "once");
        assert_eq!(next(&[&lowest[..], &[lost("10x")]].concat()), None);
        let again = [past(), lost("40x"), handed("20x", "40x")];
        assert_eq!(next(&again).as_deref(), Some("40x"));
        let lost_again = [again.as_slice(), &[lost("40x")]].concat();
        assert_eq!(next(&lost_again).as_deref(), Some("10x"));
    }
}

//! The view's centre, kept when the objective changes: what is known of where each objective looks beside the others.

use super::MagnificationResult;
use crate::kinematics::{Motion2, PlanarPose, pose_after};
use crate::{Calibration, Known, Parcentric, ServoEnd, ServoError, SwitchingReport};
use scopeservo_scope::{ErrorKind, Instrument, ObjectiveId};
use std::collections::BTreeMap;

/// An offset that is known worse than to half of itself is none.
const SIGMAS: f64 = 2.0;
/// One below this share of the field's shorter side costs the servo nothing.
const SHARE: f64 = 0.1;

/// Objectives of one nosepiece look at places that are nearer to each other than this, um: rotation centres that are farther apart are those of a
/// calibration that has drifted.
const PARCENTRIC_UM: f64 = 1000.0;

/// Whether rotation centres are trusted with where objectives look beside each other: a target that was handed over and was not there says that
/// they may not be, as centres that are 0.2 mm off are no hindrance but for this.
pub(super) fn centres_hold(done: &[MagnificationResult]) -> bool {
    let missed = |pair: &[MagnificationResult]| {
        matches!(pair[0].end, ServoEnd::HandedOver { .. })
            && matches!(pair[1].end, ServoEnd::Lost(_))
    };
    !done.windows(2).any(missed)
}

/// What tells where objectives look beside each other.
#[derive(Clone, Copy, Default)]
pub(super) struct Beside<'a> {
    /// What switching has shown.
    pub(super) switchings: &'a [SwitchingReport],
    /// What calibrations that were made together know.
    pub(super) parcentric: &'a [Parcentric],
    /// Calibrations that are trusted with it.
    pub(super) trusted: Option<&'a BTreeMap<ObjectiveId, Calibration>>,
}

impl<'a> Beside<'a> {
    pub(super) fn of(
        switchings: &'a [SwitchingReport],
        parcentric: &'a [Parcentric],
        trusted: Option<&'a BTreeMap<ObjectiveId, Calibration>>,
    ) -> Self {
        Self {
            switchings,
            parcentric,
            trusted,
        }
    }
}

/// Where the centre of `to` lies beside that of `from`, um in stage axes: by switching between them or from a third one to both; by what
/// calibrations that were made together know, where they still are the ones in use; else by their rotation centres, as if these were off
/// independently.
pub(super) fn offset_um([from, to]: [&ObjectiveId; 2], beside: &Beside<'_>) -> Option<[Known; 2]> {
    let Beside {
        switchings,
        parcentric,
        trusted,
    } = *beside;
    let seen = |a: &ObjectiveId, b: &ObjectiveId| {
        let of = |report: &&SwitchingReport| report.from == *a && report.to == *b;
        Some(switchings.iter().find(of)?.expected_um())
    };
    let back = |known: [Known; 2]| {
        known.map(|k| Known {
            value: -k.value,
            ..k
        })
    };
    let by_a_third = || {
        let mut firsts = switchings.iter().map(|report| &report.from);
        firsts.find_map(|first| Some(between(&seen(first, from)?, &seen(first, to)?)))
    };
    let together = || {
        let [a, b] = [trusted?.get(from)?, trusted?.get(to)?];
        let forth = parcentric.iter().find(|p| p.is_of(a, b));
        let over = || parcentric.iter().find(|p| p.is_of(b, a));
        forth
            .map(|p| p.offset_um)
            .or_else(|| Some(back(over()?.offset_um)))
    };
    let by_centres = || {
        let centre = |id: &ObjectiveId| {
            let calibration = trusted?.get(id)?;
            let (centre, covariance) = (calibration.rotation_centre_m?, calibration.covariance?);
            Some([0, 1].map(|k| Known {
                value: 1e6 * centre[k],
                sigma: 1e6 * covariance[4 + k][4 + k].sqrt(),
            }))
        };
        let offset = between(&centre(from)?, &centre(to)?);
        let [x, y] = offset.map(|k| k.value);
        (f64::hypot(x, y) <= PARCENTRIC_UM).then_some(offset)
    };
    seen(from, to)
        .or_else(|| seen(to, from).map(back))
        .or_else(by_a_third)
        .or_else(together)
        .or_else(by_centres)
}

fn between(from: &[Known; 2], to: &[Known; 2]) -> [Known; 2] {
    [0, 1].map(|k| Known {
        value: to[k].value - from[k].value,
        sigma: to[k].sigma.hypot(from[k].sigma),
    })
}

/// Brings what was in the middle of the view of one objective, where the stage stood at `ended_at`, into the middle of the next one's, which is
/// active now, where it would lie aside by a good part of the field: however often that is asked. `um_per_px` is that of the view.
pub(super) fn keep_centre(
    scope: &Instrument,
    ended_at: Option<PlanarPose>,
    offset_um: [Known; 2],
    um_per_px: f64,
) -> Result<(), ServoError> {
    let length = |of: fn(&Known) -> f64| f64::hypot(of(&offset_um[0]), of(&offset_um[1]));
    let (aside_um, sigma_um) = (length(|k| k.value), length(|k| k.sigma));
    let info = scope.camera().info();
    let field_um = info.width.min(info.height) as f64 * um_per_px;
    if aside_um <= SIGMAS * sigma_um || aside_um <= SHARE * field_um {
        return Ok(());
    }
    let here = scope.gate().position()?;
    // What is now in the middle was there before: c0 = c1 + d for the centre of the new objective and that of the old one.
    let motion = Motion2 {
        alpha_rad: 0.0,
        d_m: offset_um.map(|k| -1e-6 * k.value),
    };
    let kinematics = scope.gate().info().kinematics;
    let from = ended_at.unwrap_or_else(|| PlanarPose::from(&here));
    let goal = pose_after(kinematics, &from, &motion);
    match scope.move_to(&goal.request(&here)) {
        // The servo goes as far as it may.
        Err(error) if error.kind() == ErrorKind::Refused => Ok(()),
        ended => Ok(ended.map(drop)?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known(value: f64, sigma: f64) -> Known {
        Known { value, sigma }
    }

    fn report(from: &str, to: &str, x_um: f64) -> SwitchingReport {
        SwitchingReport {
            from: ObjectiveId(from.into()),
            to: ObjectiveId(to.into()),
            arrivals: [5, 5],
            offset_um: [known(x_um, 0.3), known(0.0, 0.3)],
            repeatability_um: [known(0.0, 0.0); 2],
            repeatability_deg: known(0.0, 0.0),
            focus: None,
        }
    }

    #[test]
    fn an_offset_is_known_either_way_and_by_a_third_objective() {
        let all = [report("10x", "20x", 5.0), report("10x", "40x", -8.0)];
        let offset = |from: &str, to: &str| {
            let [from, to] = [from, to].map(|id| ObjectiveId(id.into()));
            let beside = Beside {
                switchings: &all,
                ..Beside::default()
            };
            offset_um([&from, &to], &beside).map(|[x, _]| x)
        };
        assert_eq!(offset("10x", "40x"), Some(known(-8.0, 0.3)));
        assert_eq!(offset("40x", "10x"), Some(known(8.0, 0.3)));
        let third = offset("20x", "40x").unwrap();
        assert!((third.value + 13.0).abs() < 1e-12 && (third.sigma - 0.18f64.sqrt()).abs() < 1e-12);
        assert_eq!(offset("20x", "100x"), None);
    }

    fn calibration(id: &str, x_m: f64) -> Calibration {
        Calibration {
            schema: crate::CALIBRATION_SCHEMA,
            objective: ObjectiveId(id.into()),
            image_size_px: [640, 480],
            stage_from_pixel: scopeservo_geometry::Mat2([[0.0, 2e-6], [2e-6, 0.0]]),
            rotation_centre_m: Some([x_m, 0.0]),
            covariance: Some([[1e-12; 6]; 6]),
            backlash: None,
            scatter: None,
        }
    }

    #[test]
    fn what_calibrations_know_together_counts_while_they_are_in_use() {
        let ids = ["10x", "40x"].map(|id| ObjectiveId(id.into()));
        let made = [("10x", 0.125), ("40x", 0.125_02)].map(|(id, x_m)| calibration(id, x_m));
        let parcentric = [Parcentric {
            from: ids[0].clone(),
            to: ids[1].clone(),
            maps: [0, 1].map(|k| made[k].stage_from_pixel),
            offset_um: [known(19.0, 0.4), known(1.0, 0.5)],
        }];
        let offset = |[from, to]: [usize; 2], made: &[Calibration; 2]| {
            let all = made.clone().map(|c| (c.objective.clone(), c)).into();
            let beside = Beside {
                parcentric: &parcentric,
                trusted: Some(&all),
                ..Beside::default()
            };
            offset_um([&ids[from], &ids[to]], &beside).unwrap()
        };
        assert_eq!(offset([0, 1], &made), [known(19.0, 0.4), known(1.0, 0.5)]);
        assert_eq!(offset([1, 0], &made), [known(-19.0, 0.4), known(-1.0, 0.5)]);
        // One of them was made anew: what the two say by themselves is left, each with its own uncertainty.
        let mut anew = made;
        anew[1].stage_from_pixel = anew[1].stage_from_pixel * 1.0001;
        let [x, _] = offset([0, 1], &anew);
        assert!((x.value - 20.0).abs() < 1e-6 && (x.sigma - 2f64.sqrt()).abs() < 1e-6);
        // Nothing counts where they are not trusted, and switching counts first.
        let seen = [report("10x", "40x", -8.0)];
        let beside = Beside {
            parcentric: &parcentric,
            ..Beside::default()
        };
        assert_eq!(offset_um([&ids[0], &ids[1]], &beside), None);
        let beside = Beside {
            switchings: &seen,
            ..beside
        };
        let [x, _] = offset_um([&ids[0], &ids[1]], &beside).unwrap();
        assert_eq!(x.value, -8.0);
    }

    #[test]
    fn centres_farther_apart_than_objectives_can_be_tell_no_offset() {
        let [low, high] = ["10x", "40x"].map(|id| ObjectiveId(id.into()));
        for (off_m, known) in [(1e-5, true), (-4e-4, true), (2.3e-3, false), (-9e-3, false)] {
            let all = [(&low, 0.125), (&high, 0.125 + off_m)];
            let all = all.map(|(id, x_m)| (id.clone(), calibration(&id.0, x_m)));
            let all = all.into();
            let beside = Beside {
                trusted: Some(&all),
                ..Beside::default()
            };
            let offset = offset_um([&low, &high], &beside);
            let x = offset.map(|[x, _]| x.value);
            assert_eq!(x.is_some(), known, "{off_m}");
            assert!(x.is_none_or(|x| (x - 1e6 * off_m).abs() < 1e-6), "{x:?}");
        }
    }
}

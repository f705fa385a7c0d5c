//! The places that are looked at, and what was seen there.

use crate::law::error_after;
use crate::servo::places::{MayLie, MayLieAt};
use crate::{Calibration, PlanarPose, PoseError, motion_between};
use scopeservo_scope::Kinematics;
use serde::{Deserialize, Serialize};

/// A place that is less likely than this share of one where the target is seen does not make that doubtful.
const AS_LIKELY: f32 = 0.75;
/// What is seen from two places within this of each other is one thing, m and rad;
const ONE_M: f64 = 10e-6;
const ONE_RAD: f64 = 0.05;
/// and so is what was seen and what may lie somewhere, which is known less well.
const NEAR_M: f64 = 60e-6;
const NEAR_RAD: f64 = 0.2;

/// The places, and what was seen there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Visit {
    pub(super) at: MayLieAt,
    /// So many were looked at.
    pub(super) looked: usize,
    /// The objective that looks is in focus.
    #[serde(default)]
    pub(super) in_focus: bool,
    /// Where the target was seen: each once, from whichever place.
    pub(super) seen: Vec<Seen>,
}

/// The target, seen from a place.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Seen {
    pub(super) from: MayLie,
    /// Where the stage brings it back.
    pub(super) goal: PlanarPose,
}

impl Visit {
    /// Nothing was looked at yet.
    pub(super) fn of(at: MayLieAt) -> Self {
        Self {
            at,
            looked: 0,
            in_focus: false,
            seen: Vec::new(),
        }
    }

    /// Takes what was seen at the next place.
    pub(super) fn take(&mut self, seen: Option<Seen>, kinematics: Kinematics, here: &Calibration) {
        let is_another = |seen: &Seen| {
            let known = self.seen.iter();
            known
                .map(|k| k.beside(&seen.goal, kinematics, here))
                .all(|off| is_apart(&off, ONE_M, ONE_RAD))
        };
        let another = seen.filter(is_another);
        self.looked += 1;
        self.seen.extend(another);
    }

    /// Takes that at the next place nothing is in focus.
    pub(super) fn pass_by(&mut self) {
        self.looked += 1;
        self.in_focus = false;
    }

    /// Takes that the next place cannot be looked at.
    pub(super) fn give_up(&mut self) {
        self.at.beyond.extend(self.at.places.get(self.looked));
        self.pass_by();
    }

    /// Where another one may lie that nobody looked at, and which is as likely.
    pub(super) fn unseen(
        &self,
        seen: &Seen,
        kinematics: Kinematics,
        here: &Calibration,
    ) -> Option<PoseError> {
        let as_likely = |m: &&MayLie| m.height >= AS_LIKELY * seen.from.height;
        let beside = |m: &MayLie| seen.beside(&m.stage, kinematics, here);
        let mut all = self.at.beyond.iter().filter(as_likely).map(beside);
        all.find(|off| is_apart(off, NEAR_M, NEAR_RAD))
    }

    /// The next place that is worth a look.
    pub(super) fn next(&self) -> Option<&MayLie> {
        let next = self.at.places.get(self.looked)?;
        match self.seen[..] {
            [] => Some(next),
            [seen] => (next.height >= AS_LIKELY * seen.from.height).then_some(next),
            _ => None,
        }
    }
}

/// Whether two things are two.
fn is_apart(off: &PoseError, by_m: f64, by_rad: f64) -> bool {
    off.distance_um() > 1e6 * by_m || off.theta_rad.abs() > by_rad
}

impl Seen {
    /// Where what is seen back at another place of the stage lies from this one, and how it is turned, as the camera sees it.
    pub(super) fn beside(
        &self,
        other: &PlanarPose,
        kinematics: Kinematics,
        here: &Calibration,
    ) -> PoseError {
        let there = PoseError {
            t_m: [0.0; 2],
            theta_rad: 0.0,
        };
        let motion = motion_between(kinematics, &self.goal, other);
        let off = error_after(&there, &motion, here);
        PoseError {
            theta_rad: off.theta_rad.sin().atan2(off.theta_rad.cos()),
            ..off
        }
    }
}

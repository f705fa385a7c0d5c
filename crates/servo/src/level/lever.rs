//! How far the focus goes when an axis tips: the lever, learned from what was seen.

use scopeservo_scope::AxisInfo;
use serde::{Deserialize, Serialize};

/// A lever that was seen is believed to this share of it, and never better than this, m.
const SHARE: f64 = 0.25;
const LEAST_M: f64 = 5e-3;
/// Half the width of a front lens, m: what lies there rises, too.
const LENS_M: f64 = 10e-3;
/// One turn changes the height by no more than so much beyond what is expected, um.
const SURPRISE_UM: f64 = 100.0;

/// Of one axis: by how much z in focus changes, m per rad.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Lever {
    /// Sums of turn times change, and of turns squared.
    sums: [f64; 2],
}

/// The longest lever that there can be, and how far from its goal the axis may say that it is, rad.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Bounds {
    pub(super) lever_m: f64,
    pub(super) slack_rad: f64,
}

impl Bounds {
    pub(super) fn new(lever_mm: f64, axis: Option<&AxisInfo>) -> Self {
        Self {
            lever_m: 1e-3 * lever_mm,
            slack_rad: axis.map_or(0.0, AxisInfo::tolerance),
        }
    }
}

impl Lever {
    pub(super) fn learn(&mut self, by_rad: f64, change_m: f64) {
        self.sums[0] += by_rad * change_m;
        self.sums[1] += by_rad * by_rad;
    }

    pub(super) fn m(&self) -> f64 {
        match self.sums[1] > 0.0 {
            true => self.sums[0] / self.sums[1],
            false => 0.0,
        }
    }

    /// How wrong that may be, m. What the axis may have missed by, it may make up for with the next turn.
    fn unsure_m(&self, bounds: &Bounds) -> f64 {
        match self.sums[1] > 0.0 {
            true => {
                let missed = bounds.lever_m * bounds.slack_rad / self.sums[1].sqrt();
                let share = SHARE * self.m().abs();
                share.max(LEAST_M + missed).min(bounds.lever_m)
            }
            false => bounds.lever_m,
        }
    }

    /// The longest next turn, rad.
    pub(super) fn longest_rad(&self, bounds: &Bounds) -> f64 {
        1e-6 * SURPRISE_UM / self.unsure_m(bounds)
    }

    /// How far from where it is expected the focus may be after a turn, um.
    pub(super) fn unsure_um(&self, bounds: &Bounds, by_rad: f64) -> f64 {
        1e6 * self.unsure_m(bounds) * by_rad.abs()
    }

    /// How much nearer anything under the objective may come by a turn, um.
    pub(super) fn nearer_um(&self, bounds: &Bounds, by_rad: f64) -> f64 {
        1e6 * (self.m().abs() + self.unsure_m(bounds) + LENS_M) * by_rad.abs()
    }

    /// Whether the longest lever explains what a turn did.
    pub(super) fn explains(bounds: &Bounds, by_rad: f64, change_um: f64) -> bool {
        // An axis may make up for what it missed before.
        let turned = by_rad.abs() + 2.0 * bounds.slack_rad;
        change_um.abs() <= 1e6 * (bounds.lever_m + LENS_M) * turned + 5.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_grow_as_the_lever_becomes_known_and_never_surprise() {
        for (lever_m, play_rad) in [
            (0.0, 0.0),
            (0.125, 0.0),
            (-0.3, 0.0),
            (0.3, 8e-5),
            (0.05, 8e-5),
        ] {
            let bounds = Bounds {
                lever_m: 0.3,
                slack_rad: 9e-5,
            };
            let (mut lever, mut turned, mut turns) = (Lever::default(), 0.0, 0);
            let goes = |at: f64| lever_m * (at - play_rad).max(0.0);
            while turned < 5e-3 {
                let by = lever.longest_rad(&bounds).min(5e-3 - turned);
                let change = goes(turned + by) - goes(turned);
                let surprise = 1e6 * (change - lever.m() * by).abs();
                assert!(
                    surprise <= lever.unsure_um(&bounds, by) + 1e-6,
                    "{lever_m} {turns}"
                );
                assert!(1e6 * change.abs() <= lever.nearer_um(&bounds, by));
                assert!(Lever::explains(&bounds, by, 1e6 * change));
                lever.learn(by, change);
                turned += by;
                turns += 1;
            }
            assert!(turns <= 8, "{lever_m}: {turns}");
        }
    }
}

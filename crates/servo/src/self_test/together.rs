//! What self-tests of several objectives say together.

use super::changes::{Change, Changing, SelfTestReport, SelfTestVerdict};
use scopeservo_scope::ObjectiveId;
use serde::{Deserialize, Serialize};

/// Two changes are the same when they differ by less than so many of their joint standard deviations, or by this share.
const SIGMAS: f64 = 3.0;
const SHARE: f64 = 0.1;

/// Which calibrations disagree with what is seen now.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "disagree", rename_all = "snake_case")]
pub enum Together {
    /// None.
    None,
    /// One, where others were tested and hold: it is the objective's.
    Alone {
        /// Which.
        objective: ObjectiveId,
    },
    /// All, two at least, by the same: it is the camera or the stage.
    Alike {
        /// In these numbers.
        what: Vec<Changing>,
    },
    /// Some, or all by different amounts, or the only one that was tested.
    Some {
        /// Which.
        objectives: Vec<ObjectiveId>,
    },
}

/// Of reports of different objectives, which disagree and whether they do alike.
pub fn together(reports: &[SelfTestReport]) -> Together {
    let off: Vec<&SelfTestReport> = reports
        .iter()
        .filter(|r| r.verdict != SelfTestVerdict::Good)
        .collect();
    let alike = alike(&off);
    match off.as_slice() {
        [] => Together::None,
        [one] if reports.len() > 1 => Together::Alone {
            objective: one.objective.clone(),
        },
        [_, _, ..] if off.len() == reports.len() && !alike.is_empty() => {
            Together::Alike { what: alike }
        }
        some => Together::Some {
            objectives: some.iter().map(|r| r.objective.clone()).collect(),
        },
    }
}

/// In what the first is surely off, and all others by the same.
fn alike(off: &[&SelfTestReport]) -> Vec<Changing> {
    let Some((first, others)) = off.split_first() else {
        return Vec::new();
    };
    let same = |a: &Change, b: &Change| {
        let apart = (a.by - b.by).abs();
        apart < SIGMAS * a.sigma.hypot(b.sigma) || apart < SHARE * a.by.abs()
    };
    // Scale and angle are of all objectives; where the axis of rotation lies is each one's own.
    let of_all = [Changing::ScalePercent, Changing::AngleDeg];
    let sure = |what: &Changing| {
        let mut all = off.iter().map(|r| r.change(*what));
        all.all(|c| c.is_some_and(|c| c.sigmas() > SIGMAS))
    };
    let alike = |what: &Changing| {
        let mut others = others.iter().map(|r| r.change(*what));
        let first = first.change(*what);
        sure(what) && others.all(|c| first.zip(c).is_some_and(|(a, b)| same(a, b)))
    };
    of_all.into_iter().filter(alike).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(id: &str, scale: f64, angle: f64) -> SelfTestReport {
        let change = |what, by| Change {
            what,
            by,
            sigma: 0.1,
        };
        let off = scale.abs() > 0.3 || angle.abs() > 0.3;
        SelfTestReport {
            objective: ObjectiveId(id.into()),
            verdict: match off {
                true => SelfTestVerdict::Drifted,
                false => SelfTestVerdict::Good,
            },
            broken: None,
            changes: vec![
                change(Changing::ScalePercent, scale),
                change(Changing::AngleDeg, angle),
            ],
            chi_square: 0.0,
            misses_um: 0.0,
            expected_error_um: 0.0,
        }
    }

    #[test]
    fn one_alone_is_named_and_what_all_share_is_told() {
        let [good, off] = [of("10x", 0.1, 0.0), of("40x", 5.0, 0.0)];
        let alone = Together::Alone {
            objective: ObjectiveId("40x".into()),
        };
        assert_eq!(together(&[good.clone(), off.clone()]), alone);
        assert_eq!(together(std::slice::from_ref(&good)), Together::None);
        let some = |ids: &[&str]| Together::Some {
            objectives: ids.iter().map(|id| ObjectiveId((*id).into())).collect(),
        };
        assert_eq!(together(std::slice::from_ref(&off)), some(&["40x"]));
        let turned = [
            of("10x", 0.0, 2.1),
            of("20x", 0.1, 2.0),
            of("40x", 0.0, 1.9),
        ];
        let what = vec![Changing::AngleDeg];
        assert_eq!(together(&turned), Together::Alike { what });
        let each = [of("10x", 3.0, 0.0), of("40x", 5.0, 0.0)];
        assert_eq!(together(&each), some(&["10x", "40x"]));
    }
}

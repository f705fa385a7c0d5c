//! What a run tries, once each, where it cannot go on as it is.

use scopeservo_scope::ObjectiveId;
use serde::{Deserialize, Serialize};
use std::mem::discriminant;

/// Something that a run tried. Stable words: added to, never renamed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "attempt", rename_all = "snake_case")]
pub enum Attempt {
    /// The view was too dark or too bright: the camera exposed differently, until the run ended.
    ExposureAdapted {
        /// Before, ms.
        from_ms: f64,
        /// From then on, ms.
        to_ms: f64,
    },
    /// Nothing was in focus: the focus was looked for in a wider range, on the side away from the specimen and within the gate's rules.
    FocusWidened {
        /// Its half-width, um.
        half_range_um: f64,
    },
    /// The view drifted: the stage stood until it rested.
    DriftWaitedFor {
        /// How fast it drifted at first, um/s.
        um_per_s: f64,
    },
    /// The view was less sharp than the saved one: another height was looked for.
    FocusedAgain {
        /// So far from focus a view is as blurred, um.
        defocus_um: f64,
    },
    /// Moves came no nearer: each axis goes to its goal from below since, so that its play is taken up.
    OtherSide,
    /// The target was not seen: it was looked for with another objective.
    AnotherObjective {
        /// Which.
        to: ObjectiveId,
    },
    /// The target could not be told from what is around it: a higher objective looked at places that are like it.
    PlacesVisited {
        /// Which.
        with: ObjectiveId,
        /// Places, at most.
        most: usize,
    },
}

/// What was tried so far: each only once.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub(crate) struct Tried(Vec<Attempt>);

impl Tried {
    /// Takes an attempt; whether it is the first of its kind.
    pub(crate) fn first(&mut self, attempt: &Attempt) -> bool {
        let is_first = !self
            .0
            .iter()
            .any(|a| discriminant(a) == discriminant(attempt));
        if is_first {
            self.0.push(attempt.clone());
        }
        is_first
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_is_tried_once_whatever_its_figures() {
        let mut tried = Tried::default();
        let drift = |um_per_s| Attempt::DriftWaitedFor { um_per_s };
        assert!(tried.first(&drift(1.0)) && !tried.first(&drift(2.0)));
        assert!(tried.first(&Attempt::OtherSide) && !tried.first(&Attempt::OtherSide));
        let stored = serde_json::to_string(&tried).unwrap();
        let mut again: Tried = serde_json::from_str(&stored).unwrap();
        assert!(!again.first(&drift(3.0)));
    }

    #[test]
    fn a_remark_tells_it_by_a_word() {
        let remark = crate::Remark::Tried {
            objective: ObjectiveId("40x".into()),
            attempt: Attempt::ExposureAdapted {
                from_ms: 10.0,
                to_ms: 40.0,
            },
        };
        let stored = serde_json::to_string(&remark).unwrap();
        assert_eq!(
            stored,
            r#"{"remark":"tried","objective":"40x","attempt":"exposure_adapted","from_ms":10.0,"to_ms":40.0}"#
        );
        assert_eq!(
            serde_json::from_str::<crate::Remark>(&stored).unwrap(),
            remark
        );
    }
}

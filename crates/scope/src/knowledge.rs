//! What an instrument has learnt beside what its devices tell: whether images bear out which objective is active, and where each
//! objective was last in focus.

use crate::{Immersion, ImmersionChange, KnownBy, Length, ObjectiveId};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Of one instrument, whatever its nosepiece.
#[derive(Debug)]
pub(crate) struct Knowledge {
    known_by: KnownBy,
    objective: Mutex<Objective>,
    focus: Mutex<BTreeMap<ObjectiveId, Length>>,
    parfocal: Mutex<Parfocal>,
    medium: Mutex<Medium>,
}

/// How high objectives focus beside each other, from an earlier session, whose specimen lay at another height.
#[derive(Debug, Default)]
pub(crate) struct Parfocal {
    /// The height of the second less that of the first.
    pub(crate) offsets: BTreeMap<[ObjectiveId; 2], Length>,
    /// The objective that was focused last: offsets count from there.
    pub(crate) last: Option<ObjectiveId>,
}

/// What is on the specimen, beside what the active objective works in.
#[derive(Debug, Default)]
struct Medium {
    /// What it was made ready for since an objective came in.
    made_ready: BTreeSet<Immersion>,
    /// The change that somebody agreed to last, until one begins.
    agreed: Option<ImmersionChange>,
}

/// What images have shown of the objective that the nosepiece reports.
#[derive(Debug, Clone, Default)]
struct Objective {
    confirmed: bool,
    contradicted: bool,
    /// The change that was begun, and nobody has seen its end.
    changing: Option<ObjectiveId>,
}

impl Knowledge {
    /// Nothing was seen yet.
    pub(crate) fn new(known_by: KnownBy) -> Self {
        Self {
            known_by,
            objective: Mutex::default(),
            focus: Mutex::default(),
            parfocal: Mutex::default(),
            medium: Mutex::default(),
        }
    }

    fn objective(&self) -> MutexGuard<'_, Objective> {
        self.objective
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether which objective is active is only reported: neither sensed nor borne out by an image.
    pub(crate) fn is_reported(&self) -> bool {
        self.known_by != KnownBy::Sensor && !self.objective().confirmed
    }

    /// Whether somebody who turns it says so.
    pub(crate) fn is_turned_by_hand(&self) -> bool {
        self.known_by == KnownBy::Report
    }

    /// Whether an image has shown that it is another one than reported.
    pub(crate) fn is_contradicted(&self) -> bool {
        self.objective().contradicted
    }

    /// An image has shown that the report is true.
    pub(crate) fn confirm(&self) {
        self.objective().confirmed = true;
    }

    /// An image has shown that it is not. Returns whether another change to the same objective may bring it in.
    pub(crate) fn contradict(&self) -> bool {
        let mut objective = self.objective();
        objective.confirmed = false;
        // Whoever turned it can be asked again; what counts would turn to the same place.
        objective.contradicted = self.is_turned_by_hand();
        objective.contradicted
    }

    /// A change was begun.
    pub(crate) fn change_begun(&self, to: &ObjectiveId) {
        self.medium().agreed = None;
        let mut objective = self.objective();
        objective.changing = Some(to.clone());
        objective.contradicted = false;
        if self.is_turned_by_hand() {
            objective.confirmed = false;
        }
    }

    /// Whether a change was begun of which nobody has seen the end.
    pub(crate) fn is_changing(&self) -> bool {
        self.objective().changing.is_some()
    }

    /// A change ended, at its goal or on its way. `settled`: the objective at which the nosepiece has come to rest.
    pub(crate) fn change_ended(&self, settled: Option<&ObjectiveId>) {
        let mut objective = self.objective();
        let Some(to) = objective.changing.take() else {
            return;
        };
        match settled == Some(&to) {
            // The specimen was made ready for this one, which may not be the one that came.
            true => self.medium().made_ready.clear(),
            // What was counted may have run on uncounted.
            false => objective.confirmed = false,
        }
    }

    fn medium(&self) -> MutexGuard<'_, Medium> {
        self.medium.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Somebody has made the specimen ready for this change.
    pub(crate) fn agree(&self, change: &ImmersionChange) {
        let mut medium = self.medium();
        medium.made_ready.insert(change.to);
        medium.agreed = Some(change.clone());
    }

    /// The change that may begin.
    pub(crate) fn agreed(&self) -> Option<ImmersionChange> {
        self.medium().agreed.clone()
    }

    /// What the specimen was made ready for without that objective having come.
    pub(crate) fn made_ready(&self) -> BTreeSet<Immersion> {
        self.medium().made_ready.clone()
    }

    pub(crate) fn parfocal(&self) -> MutexGuard<'_, Parfocal> {
        self.parfocal.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Where each objective was last in focus.
    pub(crate) fn focus(&self) -> MutexGuard<'_, BTreeMap<ObjectiveId, Length>> {
        self.focus.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ten() -> ObjectiveId {
        ObjectiveId("10x".into())
    }

    #[test]
    fn what_a_sensor_tells_needs_no_picture() {
        let knowledge = Knowledge::new(KnownBy::Sensor);
        knowledge.change_begun(&ten());
        knowledge.change_ended(None);
        assert!(!knowledge.is_reported() && !knowledge.contradict());
        assert!(!knowledge.is_contradicted());
    }

    #[test]
    fn what_is_counted_stays_shown_from_change_to_change_until_one_is_stopped() {
        let knowledge = Knowledge::new(KnownBy::Count);
        assert!(knowledge.is_reported());
        knowledge.confirm();
        knowledge.change_begun(&ten());
        knowledge.change_ended(Some(&ten()));
        // A stop of what stands changes nothing.
        knowledge.change_ended(None);
        assert!(!knowledge.is_reported());
        knowledge.change_begun(&ten());
        knowledge.change_ended(None);
        assert!(knowledge.is_reported());
        // It would turn to the same place again.
        assert!(!knowledge.contradict() && !knowledge.is_contradicted());
    }

    #[test]
    fn whoever_turns_by_hand_is_believed_anew_after_each_picture() {
        let knowledge = Knowledge::new(KnownBy::Report);
        knowledge.confirm();
        assert!(!knowledge.is_reported());
        knowledge.change_begun(&ten());
        assert!(knowledge.is_reported());
        knowledge.change_ended(Some(&ten()));
        assert!(knowledge.contradict() && knowledge.is_contradicted());
        knowledge.change_begun(&ten());
        assert!(!knowledge.is_contradicted() && knowledge.is_reported());
    }
}

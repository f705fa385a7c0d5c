//! The active objective: what is reported, what images have shown, and which rules follow.

use super::MotionGate;
use crate::{Objective, ObjectiveId, ScopeError};

impl MotionGate {
    /// The objectives there are.
    pub fn objectives(&self) -> &[Objective] {
        self.nosepiece.objectives()
    }

    /// The data of one objective.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchObjective`].
    pub fn objective(&self, id: &ObjectiveId) -> Result<&Objective, ScopeError> {
        let all = self.objectives();
        all.iter()
            .find(|o| o.id == *id)
            .ok_or_else(|| ScopeError::NoSuchObjective {
                asked: id.clone(),
                available: all
                    .iter()
                    .map(|o| o.id.0.as_str())
                    .collect::<Vec<_>>()
                    .join(", "),
            })
    }

    /// The active objective; `None` while turning or unknown, and after an image has contradicted what is reported.
    pub fn current_objective(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        let told = self.nosepiece.current()?;
        Ok(told.filter(|_| !self.knowledge.is_contradicted()))
    }

    /// Whether the active objective is only reported: no sensor tells, and no image has borne it out.
    pub fn objective_is_reported(&self) -> bool {
        self.knowledge.is_reported()
    }

    /// Whether somebody is asked to change the objective, and says when it is done.
    pub fn objective_is_turned_by_hand(&self) -> bool {
        self.knowledge.is_turned_by_hand()
    }

    /// An image has shown that the active objective is the one that [`MotionGate::current_objective`] tells.
    pub fn confirm_objective(&self) {
        self.knowledge.confirm();
    }

    /// An image has shown that it is another. Returns whether changing to it once more may help.
    pub fn contradict_objective(&self) -> bool {
        self.knowledge.contradict()
    }

    /// Whether a rule depends on the objective.
    fn narrows(&self) -> bool {
        !self.rules.objective_limits.is_empty() || !self.rules.zones.is_empty()
    }

    /// Objectives that may be active: all of them when nobody knows, or it is only reported.
    pub(super) fn in_beam(&self) -> Result<Vec<ObjectiveId>, ScopeError> {
        if !self.narrows() {
            // Nobody asks.
            return Ok(Vec::new());
        }
        self.may_be_active()
    }

    /// The active objective where it is known, else all.
    pub(super) fn may_be_active(&self) -> Result<Vec<ObjectiveId>, ScopeError> {
        let told = self.current_objective()?;
        Ok(match told.filter(|_| !self.objective_is_reported()) {
            Some(id) => vec![id],
            None => self.objectives().iter().map(|o| o.id.clone()).collect(),
        })
    }
}

//! The medium between objective and specimen: when a change of the objective asks for another one, somebody must have agreed to it.

use super::MotionGate;
use crate::{Immersion, ImmersionChange, ObjectiveId, ScopeError};
use std::collections::BTreeSet;

impl MotionGate {
    /// What somebody must agree to before this objective may come; `None` where the medium stays what it is. It counts what may be: all
    /// media of the nosepiece where it is not known which objective is active, and what the specimen was made ready for without that
    /// objective having come.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchObjective`], and what the nosepiece reports.
    pub fn immersion_change(
        &self,
        to: &ObjectiveId,
    ) -> Result<Option<ImmersionChange>, ScopeError> {
        let objective = self.objective(to)?;
        let from = self.immersions()?;
        let stays = from.iter().all(|medium| *medium == objective.immersion);
        Ok((!stays).then(|| ImmersionChange {
            objective: to.clone(),
            to: objective.immersion,
            from,
        }))
    }

    /// What may be on the specimen now.
    ///
    /// # Errors
    /// What the nosepiece reports.
    pub fn immersions(&self) -> Result<BTreeSet<Immersion>, ScopeError> {
        let all = self.objectives();
        let mut media: BTreeSet<Immersion> = all.iter().map(|o| o.immersion).collect();
        if media.len() > 1 {
            let may_be = self.may_be_active()?;
            let active = all.iter().filter(|o| may_be.contains(&o.id));
            let known: BTreeSet<Immersion> = active.map(|o| o.immersion).collect();
            // An objective that the nosepiece does not list may work in anything.
            if !known.is_empty() {
                media = known;
            }
            media.extend(self.knowledge.made_ready());
        }
        Ok(media)
    }

    /// Somebody has made the specimen ready and agreed to this change: it may begin once, unless something else was agreed to or begun
    /// before. If the objective does not come all the same, it is remembered that what is on the specimen is no more what the one
    /// before it works in.
    pub fn agree_to_immersion(&self, change: &ImmersionChange) {
        self.knowledge.agree(change);
    }

    /// Refuses a change to another medium that nobody agreed to.
    pub(super) fn check_immersion(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        let agreed = self.knowledge.agreed();
        match self.immersion_change(to)? {
            Some(change) if !agreed.is_some_and(|a| is_same(&a, &change)) => {
                Err(ScopeError::ImmersionNotAgreed { change })
            }
            _ => Ok(()),
        }
    }
}

/// Whether what was agreed to is the change that is needed. That the specimen was made ready for it is no reason to ask again.
fn is_same(agreed: &ImmersionChange, needed: &ImmersionChange) -> bool {
    let before = |c: &ImmersionChange| {
        let media = c.from.iter().copied().filter(|m| *m != c.to);
        media.collect::<BTreeSet<_>>()
    };
    agreed.objective == needed.objective
        && agreed.to == needed.to
        && before(agreed) == before(needed)
}

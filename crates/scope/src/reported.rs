//! Where the stage last said it was, for whoever wants to know without asking it: a question may cost a round trip to a controller.

use crate::{Motion, StagePose};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// The last place that was reported by a stage at rest. Departures are counted, so that a report from before one never counts after it.
#[derive(Debug, Default)]
pub(crate) struct Reported {
    /// Motions that were begun.
    departures: AtomicU64,
    /// How many of them had been when the stage was last seen to stand.
    rests_since: AtomicU64,
    at: Mutex<Option<(u64, StagePose)>>,
}

impl Reported {
    /// A motion is about to begin.
    pub(crate) fn departs(&self) {
        self.departures.fetch_add(1, Ordering::SeqCst);
    }

    /// Asks what the stage does.
    pub(crate) fn motion<E>(&self, ask: impl FnOnce() -> Result<Motion, E>) -> Result<Motion, E> {
        let departures = self.departures.load(Ordering::SeqCst);
        let motion = ask()?;
        if motion != Motion::Moving {
            self.rests_since.store(departures, Ordering::SeqCst);
        }
        Ok(motion)
    }

    /// Asks where the stage is.
    pub(crate) fn place<E>(
        &self,
        ask: impl FnOnce() -> Result<StagePose, E>,
    ) -> Result<StagePose, E> {
        let departures = self.departures.load(Ordering::SeqCst);
        let at = ask()?;
        if self.rests_since.load(Ordering::SeqCst) == departures {
            *self.at.lock().unwrap_or_else(PoisonError::into_inner) = Some((departures, at));
        }
        Ok(at)
    }

    /// The last place, unless a motion has begun since.
    pub(crate) fn last(&self) -> Option<StagePose> {
        let last = *self.at.lock().unwrap_or_else(PoisonError::into_inner);
        let now = self.departures.load(Ordering::SeqCst);
        last.filter(|(then, _)| *then == now).map(|(_, at)| at)
    }
}

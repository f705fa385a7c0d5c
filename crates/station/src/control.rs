//! The control block of a job: what its thread and its handles share.

use crate::{JobInfo, JobState, Kept, Lease, lock};
use scopeservo_scope::CancelToken;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How often one who waits looks whether the whole instrument was stopped, which wakes nobody.
pub(crate) const LOOK: Duration = Duration::from_millis(50);

/// What a job's thread and its handles share.
pub(crate) struct Control {
    pub(crate) info: JobInfo,
    pub(crate) cancel: CancelToken,
    pub(crate) kept: Mutex<Vec<Kept>>,
    standing: Mutex<Standing>,
    changed: Condvar,
}

pub(crate) struct Standing {
    pub(crate) state: JobState,
    pub(crate) pause_asked: bool,
    /// The number of the lease that it runs under.
    pub(crate) lease: u64,
}

impl Control {
    pub(crate) fn new(info: JobInfo, lease: &Lease, cancel: CancelToken) -> Self {
        Self {
            info,
            cancel,
            kept: Mutex::default(),
            standing: Mutex::new(Standing {
                state: JobState::Queued,
                pause_asked: false,
                lease: lease.number(),
            }),
            changed: Condvar::new(),
        }
    }

    pub(crate) fn standing(&self) -> MutexGuard<'_, Standing> {
        lock(&self.standing)
    }

    pub(crate) fn set(&self, state: JobState) {
        self.standing().state = state;
        self.changed.notify_all();
    }

    /// Waits until something about it changed, or a moment has passed.
    pub(crate) fn wait_change<'a>(&self, at: MutexGuard<'a, Standing>) -> MutexGuard<'a, Standing> {
        let waited = self.changed.wait_timeout(at, LOOK);
        waited.unwrap_or_else(PoisonError::into_inner).0
    }

    pub(crate) fn wake(&self) {
        self.changed.notify_all();
    }

    pub(crate) fn wait_end(&self, limit: Option<Duration>) -> bool {
        let at = self.standing();
        let goes_on = |at: &mut Standing| !matches!(at.state, JobState::Ended(_));
        match limit {
            None => {
                let waited = self.changed.wait_while(at, goes_on);
                drop(waited.unwrap_or_else(PoisonError::into_inner));
                true
            }
            Some(limit) => {
                let waited = self.changed.wait_timeout_while(at, limit, goes_on);
                !waited.unwrap_or_else(PoisonError::into_inner).1.timed_out()
            }
        }
    }
}

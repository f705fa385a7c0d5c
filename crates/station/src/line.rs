//! Jobs one after the other, in the order in which they came.

use crate::job::{Core, JobId, LOOK};
use crate::lock;
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, PoisonError};

#[derive(Default)]
pub(crate) struct Line {
    state: Mutex<State>,
    turned: Condvar,
}

#[derive(Default)]
struct State {
    /// The first one works.
    jobs: VecDeque<Arc<Core>>,
    given: u64,
    /// Stops on their way to the devices: a job that began now would be stopped in place of the one that was meant.
    stops: usize,
}

impl Line {
    /// Puts a job at the end.
    pub(crate) fn enter(&self, make: impl FnOnce(JobId) -> Core) -> Arc<Core> {
        let mut state = lock(&self.state);
        let core = Arc::new(make(JobId(state.given)));
        state.given += 1;
        state.jobs.push_back(core.clone());
        core
    }

    /// Waits for this job's turn; `false` when it was stopped before.
    pub(crate) fn wait_turn(&self, core: &Arc<Core>) -> bool {
        let mut state = lock(&self.state);
        loop {
            if core.cancel.is_cancelled() {
                return false;
            }
            if state.stops == 0 && state.jobs.front().is_some_and(|j| Arc::ptr_eq(j, core)) {
                return true;
            }
            let waited = self.turned.wait_timeout(state, LOOK);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    pub(crate) fn leave(&self, core: &Arc<Core>) {
        lock(&self.state).jobs.retain(|j| !Arc::ptr_eq(j, core));
        self.turned.notify_all();
    }

    pub(crate) fn jobs(&self) -> Vec<Arc<Core>> {
        lock(&self.state).jobs.iter().cloned().collect()
    }

    /// No job begins until the guard is dropped. Also all jobs, the one under way first.
    pub(crate) fn stopping(&self) -> (Stopping<'_>, Vec<Arc<Core>>) {
        let mut state = lock(&self.state);
        state.stops += 1;
        (Stopping(self), state.jobs.iter().cloned().collect())
    }
}

/// A stop on its way.
pub(crate) struct Stopping<'a>(&'a Line);

impl Drop for Stopping<'_> {
    fn drop(&mut self) {
        lock(&self.0.state).stops -= 1;
        self.0.turned.notify_all();
    }
}

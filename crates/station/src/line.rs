//! Jobs one after the other, in the order in which they came.

use crate::control::{Control, LOOK};
use crate::{JobId, lock};
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
    jobs: VecDeque<Arc<Control>>,
    given: u64,
    /// Stops on their way to the devices: a job that began now would be stopped in place of the one that was meant.
    stops: usize,
}

impl Line {
    /// Puts a job at the end.
    pub(crate) fn enter(&self, make: impl FnOnce(JobId) -> Control) -> Arc<Control> {
        let mut state = lock(&self.state);
        let control = Arc::new(make(JobId(state.given)));
        state.given += 1;
        state.jobs.push_back(control.clone());
        control
    }

    /// Waits for this job's turn; `false` when it was stopped before.
    pub(crate) fn wait_turn(&self, control: &Arc<Control>) -> bool {
        let mut state = lock(&self.state);
        loop {
            if control.cancel.is_cancelled() {
                return false;
            }
            if state.stops == 0 && state.jobs.front().is_some_and(|j| Arc::ptr_eq(j, control)) {
                return true;
            }
            let waited = self.turned.wait_timeout(state, LOOK);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    pub(crate) fn leave(&self, control: &Arc<Control>) {
        lock(&self.state).jobs.retain(|j| !Arc::ptr_eq(j, control));
        self.turned.notify_all();
    }

    pub(crate) fn jobs(&self) -> Vec<Arc<Control>> {
        lock(&self.state).jobs.iter().cloned().collect()
    }

    /// No job begins until the guard is dropped. Also all jobs, the one under way first.
    pub(crate) fn stopping(&self) -> (Stopping<'_>, Vec<Arc<Control>>) {
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

//! A job as others see it: how it stands, and how it is stopped, paused and waited for.

use crate::control::Control;
use crate::shared::Shared;
use crate::{JobError, JobId, JobInfo, JobState, Kept, Lease, Refusal, lock};
use scopeservo_scope::ScopeError;
use std::ops::Deref;
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

/// A job, whatever its answer is. Clones are the same job; dropping it changes nothing.
#[derive(Clone)]
pub struct JobHandle {
    control: Arc<Control>,
    shared: Weak<Shared>,
}

impl JobHandle {
    pub(crate) fn new(control: Arc<Control>, shared: &Arc<Shared>) -> Self {
        Self {
            control,
            shared: Arc::downgrade(shared),
        }
    }

    /// Its number.
    pub fn id(&self) -> JobId {
        self.control.info.id
    }

    /// What it is.
    pub fn info(&self) -> &JobInfo {
        &self.control.info
    }

    /// How it stands.
    pub fn state(&self) -> JobState {
        let state = self.control.standing().state.clone();
        let asks = |s: Arc<Shared>| s.questions.open().iter().any(|q| q.job == Some(self.id()));
        match state {
            JobState::Running if self.shared.upgrade().is_some_and(asks) => JobState::Asking,
            state => state,
        }
    }

    /// What it has made so far that is worth keeping, however it ends.
    pub fn kept(&self) -> Vec<Kept> {
        lock(&self.control.kept).clone()
    }

    /// Stops it, and what moves for it; its question to people is not asked any more. Needs no lease. The next job runs as if nothing
    /// had been. A job that had made its last step already has its answer all the same.
    ///
    /// # Errors
    /// What a device answers that does not take the stop; the job was told all the same.
    pub fn stop(&self) -> Result<(), ScopeError> {
        self.control.cancel.cancel();
        match self.shared.upgrade() {
            Some(shared) => shared.stop(Some(&self.control)),
            None => Ok(()),
        }
    }

    /// Lets it wait before its next step. Needs no lease.
    pub fn pause(&self) {
        self.control.standing().pause_asked = true;
        self.control.wake();
    }

    /// Lets it go on, under this lease.
    ///
    /// # Errors
    /// [`Refusal::LeaseLost`], [`Refusal::NoSuchJob`] when the session has ended.
    pub fn resume(&self, lease: &Lease) -> Result<(), Refusal> {
        let shared = self.shared.upgrade();
        let shared = shared.ok_or(Refusal::NoSuchJob { id: self.id() })?;
        shared.leases.check(lease)?;
        let mut at = self.control.standing();
        at.pause_asked = false;
        at.lease = lease.number();
        drop(at);
        self.control.wake();
        Ok(())
    }

    /// Waits for its end, so long at most. Whether it has ended.
    pub fn wait_timeout(&self, limit: Duration) -> bool {
        self.control.wait_end(Some(limit))
    }

    pub(crate) fn wait_end(&self) {
        self.control.wait_end(None);
    }
}

pub(crate) type Slot<T> = Arc<Mutex<Option<Result<T, JobError>>>>;

/// A job with its answer to come. Dropping it changes nothing: the job goes on.
pub struct Job<T> {
    handle: JobHandle,
    slot: Slot<T>,
}

impl<T> Job<T> {
    pub(crate) fn new(handle: JobHandle, slot: Slot<T>) -> Self {
        Self { handle, slot }
    }

    /// The job, without its answer.
    pub fn handle(&self) -> &JobHandle {
        &self.handle
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// What it ended with that is no answer.
    pub fn wait(self) -> Result<T, JobError> {
        self.handle.wait_end();
        let answer = lock(&self.slot).take();
        answer.unwrap_or_else(|| {
            Err(JobError::Mistake {
                what: "its answer is lost".into(),
            })
        })
    }
}

impl<T> Deref for Job<T> {
    type Target = JobHandle;

    fn deref(&self) -> &JobHandle {
        &self.handle
    }
}

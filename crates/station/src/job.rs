//! A job as others see it: what it is, how it stands, and how it is stopped, paused and waited for.

use crate::question::Questions;
use crate::session::Shared;
use crate::{JobError, Kept, Lease, Refusal, lock};
use scopeservo_scope::{CancelToken, ScopeError, StagePose};
use scopeservo_servo::ErrorKind;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::Deref;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

/// How often one who waits looks whether the whole instrument was stopped, which wakes nobody.
pub(crate) const LOOK: Duration = Duration::from_millis(50);

/// Counts the jobs of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct JobId(pub u64);

impl fmt::Display for JobId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// What a job is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobInfo {
    /// Its number in the session.
    pub id: JobId,
    /// The use case: a word for programs.
    pub kind: String,
    /// Who started it.
    pub owner: String,
}

/// Why a job waits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pause {
    /// Somebody asked for it.
    Asked,
    /// The lease it ran under has expired or was given back. Whoever has the lease resumes it, or stops it.
    LeaseLost,
}

/// How a job ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "how", rename_all = "snake_case")]
pub enum Ended {
    /// With an answer, be it "not found".
    Answered,
    /// Somebody stopped it.
    Stopped {
        /// Where the stage was seen to stand still; `None` when nobody looked.
        at: Option<StagePose>,
    },
    /// With an error.
    Failed {
        /// For people.
        message: String,
        /// What kind of trouble it was, for programs.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        kind: Option<ErrorKind>,
    },
}

/// How a job stands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "state", rename_all = "snake_case")]
pub enum JobState {
    /// Others come first.
    Queued,
    /// It works.
    Running,
    /// It waits before its next step.
    Paused {
        /// Why.
        why: Pause,
    },
    /// It waits for somebody's answer.
    Asking,
    /// It is over.
    Ended(Ended),
}

impl Ended {
    pub(crate) fn of<T>(result: &Result<T, JobError>) -> Self {
        match result {
            Ok(_) => Self::Answered,
            Err(JobError::Stopped { at }) => Self::Stopped { at: *at },
            Err(error) => Self::Failed {
                message: error.to_string(),
                kind: Some(error.kind()),
            },
        }
    }
}

/// What a job's thread and its handles share.
pub(crate) struct Core {
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

impl Core {
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

    fn wait_end(&self, limit: Option<Duration>) -> bool {
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

    fn asks(&self, questions: &Questions) -> bool {
        let id = Some(self.info.id);
        questions.open().iter().any(|q| q.job == id)
    }
}

/// A job, whatever its answer is. Clones are the same job; dropping it changes nothing.
#[derive(Clone)]
pub struct JobHandle {
    core: Arc<Core>,
    shared: Weak<Shared>,
}

impl JobHandle {
    pub(crate) fn new(core: Arc<Core>, shared: &Arc<Shared>) -> Self {
        Self {
            core,
            shared: Arc::downgrade(shared),
        }
    }

    /// Its number.
    pub fn id(&self) -> JobId {
        self.core.info.id
    }

    /// What it is.
    pub fn info(&self) -> &JobInfo {
        &self.core.info
    }

    /// How it stands.
    pub fn state(&self) -> JobState {
        let state = self.core.standing().state.clone();
        let asks = |s: Arc<Shared>| self.core.asks(&s.questions);
        match state {
            JobState::Running if self.shared.upgrade().is_some_and(asks) => JobState::Asking,
            state => state,
        }
    }

    /// What it has made so far that is worth keeping, however it ends.
    pub fn kept(&self) -> Vec<Kept> {
        lock(&self.core.kept).clone()
    }

    /// Stops it, and what moves for it; its question to people is not asked any more. Needs no lease. The next job runs as if nothing
    /// had been. A job that had made its last step already has its answer all the same.
    ///
    /// # Errors
    /// What a device answers that does not take the stop; the job was told all the same.
    pub fn stop(&self) -> Result<(), ScopeError> {
        self.core.cancel.cancel();
        match self.shared.upgrade() {
            Some(shared) => shared.stop(Some(&self.core)),
            None => Ok(()),
        }
    }

    /// Lets it wait before its next step. Needs no lease.
    pub fn pause(&self) {
        self.core.standing().pause_asked = true;
        self.core.wake();
    }

    /// Lets it go on, under this lease.
    ///
    /// # Errors
    /// [`Refusal::LeaseLost`], [`Refusal::NoSuchJob`] when the session has ended.
    pub fn resume(&self, lease: &Lease) -> Result<(), Refusal> {
        let shared = self.shared.upgrade();
        let shared = shared.ok_or(Refusal::NoSuchJob { id: self.id() })?;
        shared.leases.check(lease)?;
        let mut at = self.core.standing();
        at.pause_asked = false;
        at.lease = lease.number();
        drop(at);
        self.core.wake();
        Ok(())
    }

    /// Waits for its end, so long at most. Whether it has ended.
    pub fn wait_timeout(&self, limit: Duration) -> bool {
        self.core.wait_end(Some(limit))
    }

    pub(crate) fn wait_end(&self) {
        self.core.wait_end(None);
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

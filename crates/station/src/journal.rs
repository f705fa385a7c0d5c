//! What is written before each step, so that a killed job can go on.

use crate::{Ended, JobInfo, Kept, lock};
use std::sync::Mutex;
use thiserror::Error;

/// The state could not be kept.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("the state of the job could not be kept: {0}")]
pub struct JournalError(pub String);

/// Where the state of jobs goes. Called on the job's own thread, one job at a time, and nothing moves meanwhile.
pub trait Journal: Send + Sync {
    /// Before the step of that number, from 0: `state` makes the bytes (JSON) from which the job can be made again, when it is asked. Most
    /// steps are followed by a move, so what is kept must be on the disk when this returns.
    ///
    /// # Errors
    /// Then the job ends, and the step is not made.
    fn before_step(
        &self,
        job: &JobInfo,
        step: u64,
        state: &dyn Fn() -> Result<Vec<u8>, JournalError>,
    ) -> Result<(), JournalError>;

    /// The job has made something that is worth keeping, however it ends.
    ///
    /// # Errors
    /// Told as an event; the job goes on.
    fn kept(&self, job: &JobInfo, kept: &Kept) -> Result<(), JournalError> {
        let _ = (job, kept);
        Ok(())
    }

    /// The job has ended, before that is told; whether its state is of use still is for whoever keeps the answer to say. Not called when
    /// the program is killed.
    ///
    /// # Errors
    /// Told as an event; the answer stands.
    fn ended(&self, job: &JobInfo, how: &Ended) -> Result<(), JournalError>;
}

/// Keeps nothing.
#[derive(Debug, Default)]
pub struct NoJournal;

impl Journal for NoJournal {
    fn before_step(
        &self,
        _: &JobInfo,
        _: u64,
        _: &dyn Fn() -> Result<Vec<u8>, JournalError>,
    ) -> Result<(), JournalError> {
        Ok(())
    }
    fn ended(&self, _: &JobInfo, _: &Ended) -> Result<(), JournalError> {
        Ok(())
    }
}

/// Keeps the last state in memory.
#[derive(Debug, Default)]
pub struct MemoryJournal(Mutex<Option<(JobInfo, u64, Vec<u8>)>>);

impl MemoryJournal {
    /// The job that is under way or was left so, the number of its next step, and its state.
    pub fn last(&self) -> Option<(JobInfo, u64, Vec<u8>)> {
        lock(&self.0).clone()
    }
}

impl Journal for MemoryJournal {
    fn before_step(
        &self,
        job: &JobInfo,
        step: u64,
        state: &dyn Fn() -> Result<Vec<u8>, JournalError>,
    ) -> Result<(), JournalError> {
        let state = state()?;
        *lock(&self.0) = Some((job.clone(), step, state));
        Ok(())
    }
    fn ended(&self, _: &JobInfo, _: &Ended) -> Result<(), JournalError> {
        *lock(&self.0) = None;
        Ok(())
    }
}

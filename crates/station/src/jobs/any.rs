//! Any of the jobs, for front ends that take them as data, and for stored ones that go on.

use super::{
    CalibrateInput, CalibrateJob, CalibrateOutput, CheckInput, CheckJob, CheckOutput, DoctorInput,
    DoctorJob, DoctorOutput, FocusInput, FocusJob, FocusOutput, GridInput, GridJob, GridOutput,
    IdentifyInput, IdentifyJob, IdentifyOutput, LevelInput, LevelJob, LevelOutput, RepositionInput,
    RepositionJob, RepositionOutput, SaveTargetInput, SaveTargetJob, SaveTargetOutput,
};
use crate::{JobError, UseCase, Work};
use scopeservo_scope::Instrument;
use scopeservo_servo::{Progress, Target};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use thiserror::Error;

/// What is asked of a station.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "job", content = "input", rename_all = "snake_case")]
#[allow(missing_docs, reason = "each is the job of its name")]
pub enum Request {
    Focus(FocusInput),
    Calibrate(CalibrateInput),
    Grid(GridInput),
    Level(LevelInput),
    Check(CheckInput),
    SaveTarget(SaveTargetInput),
    Reposition(RepositionInput),
    Identify(IdentifyInput),
    Doctor(DoctorInput),
}

/// What it answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "job", content = "output", rename_all = "snake_case")]
#[allow(missing_docs, reason = "each is of the job of its name")]
pub enum Answer {
    Focus(FocusOutput),
    Calibrate(CalibrateOutput),
    Grid(Box<GridOutput>),
    Level(Box<LevelOutput>),
    Check(CheckOutput),
    SaveTarget(Box<SaveTargetOutput>),
    Reposition(Box<RepositionOutput>),
    Identify(IdentifyOutput),
    Doctor(DoctorOutput),
}

/// A job of any kind. Its state is that of the job itself, so that what was stored comes back by its kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
#[allow(missing_docs, reason = "each is the job of its name")]
pub enum AnyJob {
    Focus(Box<FocusJob>),
    Calibrate(Box<CalibrateJob>),
    Grid(Box<GridJob>),
    Level(Box<LevelJob>),
    Check(Box<CheckJob>),
    SaveTarget(Box<SaveTargetJob>),
    Reposition(Box<RepositionJob>),
    Identify(Box<IdentifyJob>),
    Doctor(Box<DoctorJob>),
}

impl AnyJob {
    /// Does what is asked. `target` finds the target of a reposition by its identifier.
    ///
    /// # Errors
    /// Those of `target`.
    pub fn new<E>(
        request: Request,
        target: impl FnOnce(&str) -> Result<Target, E>,
    ) -> Result<Self, E> {
        Ok(match request {
            Request::Focus(input) => Self::Focus(Box::new(FocusJob::new(input))),
            Request::Calibrate(input) => Self::Calibrate(Box::new(CalibrateJob::new(input))),
            Request::Grid(input) => Self::Grid(Box::new(GridJob::new(input))),
            Request::Level(input) => Self::Level(Box::new(LevelJob::new(input))),
            Request::Check(input) => Self::Check(Box::new(CheckJob::new(input))),
            Request::SaveTarget(input) => Self::SaveTarget(Box::new(SaveTargetJob::new(input))),
            Request::Identify(input) => Self::Identify(Box::new(IdentifyJob::new(input))),
            Request::Doctor(input) => Self::Doctor(Box::new(DoctorJob::new(input))),
            Request::Reposition(input) => {
                let target = target(&input.target_id)?;
                Self::Reposition(Box::new(RepositionJob::new(target, input)))
            }
        })
    }

    /// A job that goes on, from its kind and the state that a [`crate::Journal`] kept. One that names a target is whole again with it
    /// ([`AnyJob::target_id`], [`AnyJob::with_target`]).
    ///
    /// # Errors
    /// [`StoredError`].
    pub fn stored(kind: &str, state: &[u8]) -> Result<Self, StoredError> {
        fn read<'a, T: Deserialize<'a>>(state: &'a [u8]) -> Result<Box<T>, StoredError> {
            let job = serde_json::from_slice(state).map(Box::new);
            job.map_err(|error| StoredError::State(error.to_string()))
        }
        Ok(match kind {
            "focus" => Self::Focus(read(state)?),
            "calibrate" => Self::Calibrate(read(state)?),
            "grid" => Self::Grid(read(state)?),
            "level" => Self::Level(read(state)?),
            "check" => Self::Check(read(state)?),
            "save_target" => Self::SaveTarget(read(state)?),
            "identify" => Self::Identify(read(state)?),
            "reposition" => Self::Reposition(read(state)?),
            other => return Err(StoredError::Kind(other.to_owned())),
        })
    }

    /// By what the target is found that it needs to go on.
    pub fn target_id(&self) -> Option<&str> {
        match self {
            Self::Reposition(job) => Some(job.target_id()),
            _ => None,
        }
    }

    /// A stored job with its target.
    #[must_use]
    pub fn with_target(self, target: impl Into<Arc<Target>>) -> Self {
        match self {
            Self::Reposition(job) => Self::Reposition(Box::new(job.with_target(target))),
            other => other,
        }
    }
}

/// Why a stored job is none.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum StoredError {
    /// Its state is damaged, or that of another version.
    #[error("its state cannot be read: {0}")]
    State(String),
    /// There is no such job here, or none that can go on.
    #[error("this version knows no {0} that could")]
    Kind(String),
}

impl UseCase for AnyJob {
    type Output = Answer;

    fn kind(&self) -> &'static str {
        match self {
            Self::Focus(job) => job.kind(),
            Self::Calibrate(job) => job.kind(),
            Self::Grid(job) => job.kind(),
            Self::Level(job) => job.kind(),
            Self::Check(job) => job.kind(),
            Self::SaveTarget(job) => job.kind(),
            Self::Reposition(job) => job.kind(),
            Self::Identify(job) => job.kind(),
            Self::Doctor(job) => job.kind(),
        }
    }

    fn can_go_on(&self) -> bool {
        match self {
            Self::Focus(job) => job.can_go_on(),
            Self::Calibrate(job) => job.can_go_on(),
            Self::Grid(job) => job.can_go_on(),
            Self::Level(job) => job.can_go_on(),
            Self::Check(job) => job.can_go_on(),
            Self::SaveTarget(job) => job.can_go_on(),
            Self::Reposition(job) => job.can_go_on(),
            Self::Identify(job) => job.can_go_on(),
            Self::Doctor(job) => job.can_go_on(),
        }
    }

    fn leave(&mut self, scope: &Instrument) {
        // No other sets anything until it ends.
        if let Self::Reposition(job) = self {
            job.leave(scope);
        }
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<Answer>, JobError> {
        Ok(match self {
            Self::Focus(job) => answer(job.step(work)?, Answer::Focus),
            Self::Calibrate(job) => answer(job.step(work)?, Answer::Calibrate),
            Self::Grid(job) => answer(job.step(work)?, |told| Answer::Grid(Box::new(told))),
            Self::Level(job) => answer(job.step(work)?, |told| Answer::Level(Box::new(told))),
            Self::Check(job) => answer(job.step(work)?, Answer::Check),
            Self::SaveTarget(job) => {
                answer(job.step(work)?, |saved| Answer::SaveTarget(Box::new(saved)))
            }
            Self::Reposition(job) => answer(job.step(work)?, |output| {
                Answer::Reposition(Box::new(output))
            }),
            Self::Identify(job) => answer(job.step(work)?, Answer::Identify),
            Self::Doctor(job) => answer(job.step(work)?, Answer::Doctor),
        })
    }
}

fn answer<T>(progress: Progress<T>, of: impl FnOnce(T) -> Answer) -> Progress<Answer> {
    match progress {
        Progress::Continue => Progress::Continue,
        Progress::Done(output) => Progress::Done(of(output)),
    }
}

//! The use cases, for every front end: the command line, a server, a page, a program.
//!
//! A [`Session`] is one open instrument. Whoever holds its [`Lease`] starts [`Job`]s, which run one after the other, each on a thread of
//! its own and with a stop of its own. What happens goes over the [`Bus`] to any number of [`Listener`]s; [`Questions`] to people are
//! news with an answer; a [`Journal`] is told the whole state before each step, so that a killed job can go on. The jobs themselves
//! are [`jobs`]: one file each.
//!
//! Nothing here prints, reads files or the wall clock, or keeps global state.

#![warn(clippy::too_many_lines)]
#![cfg_attr(
    not(test),
    warn(
        clippy::disallowed_methods,
        clippy::disallowed_types,
        clippy::disallowed_macros
    )
)]

mod bus;
mod control;
mod error;
mod job;
mod job_state;
pub mod jobs;
mod journal;
mod kept;
mod lease;
mod lifecycle;
mod line;
mod news;
mod question;
mod questions;
mod session;
mod shared;
mod work;

pub use bus::{Bus, FrameKeeper, Heard, Keeper, LOG_BYTES, Listener, Shown};
pub use error::{JobError, Refusal};
pub use job::{Job, JobHandle};
pub use job_state::{Ended, JobId, JobInfo, JobState, Pause};
pub use journal::{Journal, JournalError, MemoryJournal, NoJournal};
pub use kept::{Kept, MadeCalibration};
pub use lease::Lease;
pub use news::{News, Record, StationEvent};
pub use question::{Question, QuestionId, QuestionKind};
pub use questions::{Ask, Questions};
pub use session::{Parts, Session};
pub use work::{UseCase, Work};

/// What a panic left behind a lock is whole: every value is replaced in one go.
fn lock<T: ?Sized>(mutex: &std::sync::Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
}

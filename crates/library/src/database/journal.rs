//! The journal of the job under way stays files: a step is one file that is replaced, which hundreds of kills have proved.

use crate::database::store::Database;
use crate::{Journal, JournalHead, JournalStep, Journalled, LibraryError};
use scopeservo_scope::StagePose;
use std::path::PathBuf;

impl Journal for Database {
    fn begin_journal(&self, instrument: &str, head: &JournalHead) -> Result<(), LibraryError> {
        self.folder().begin_journal(instrument, head)
    }

    fn journal_step(&self, instrument: &str, step: &JournalStep) -> Result<usize, LibraryError> {
        self.folder().journal_step(instrument, step)
    }

    fn journal_goal(&self, instrument: &str, to: &StagePose) -> Result<(), LibraryError> {
        self.folder().journal_goal(instrument, to)
    }

    fn end_journal(&self, instrument: &str) -> Result<(), LibraryError> {
        self.folder().end_journal(instrument)
    }

    fn journal(&self, instrument: &str) -> Result<Option<Journalled>, LibraryError> {
        self.folder().journal(instrument)
    }

    fn set_journal_aside(&self, instrument: &str) -> Result<Option<PathBuf>, LibraryError> {
        self.folder().set_journal_aside(instrument)
    }
}

//! What a job told and answered, in the library; and the end of its journal after that.

use crate::{Asked, FileJournal, Made, Workbench};
use scopeservo_library::{LibraryError, RunHead, RunLog, Runs as _};
use scopeservo_station::Record;
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;

/// The record of a job under way. A library that takes none does not keep the job from its work.
pub struct RunRecord {
    log: Option<Box<dyn RunLog>>,
    journal: Arc<FileJournal>,
}

impl Workbench {
    /// Begins the record of the job that is started next, and says to the journal that it comes. Also what was wrong with the former.
    pub fn record(&self, kind: &str, asked: Asked) -> (RunRecord, Option<LibraryError>) {
        let head = RunHead {
            job: kind.into(),
            instrument: self.config.name.clone(),
            version: format!("scopeservo {}", env!("CARGO_PKG_VERSION")),
            inputs: asked.inputs.clone(),
        };
        self.journal.comes(kind, asked);
        let (log, lost) = match self.library.begin_run(&head) {
            Ok(log) => (Some(log), None),
            Err(lost) => (None, Some(lost)),
        };
        let journal = self.journal.clone();
        (RunRecord { log, journal }, lost)
    }
}

impl RunRecord {
    /// Adds an event.
    pub fn event(&mut self, event: &Record) {
        if let (Some(log), Ok(line)) = (&mut self.log, serde_json::to_string(event)) {
            log.event(&line);
        }
    }

    /// Where it lies, if it does.
    pub fn place(&self) -> Option<&Path> {
        self.log.as_ref().map(|log| log.place())
    }

    /// What the job made so far, and where that is kept.
    pub fn made(&self) -> Vec<Made> {
        self.journal.made()
    }

    /// Keeps the answer, and the page where there is one. Only then the journal ends: whoever is killed before has the answer given again.
    /// Returns what could not be kept.
    pub fn end(mut self, page: Option<&str>, answer: &Value) -> Vec<LibraryError> {
        let mut lost = Vec::new();
        if let Some(log) = &mut self.log {
            if let Some(page) = page {
                lost.extend(log.attach("report.html", page.as_bytes()).err());
            }
            lost.extend(log.end(answer).err());
        }
        lost.extend(self.journal.close().err());
        lost
    }
}

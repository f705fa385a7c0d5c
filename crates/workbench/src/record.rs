//! What a job told and answered, in the library; and the end of its journal after that.

use crate::{Asked, FileJournal, Made, Workbench};
use scopeservo_library::{Database, Label, LibraryError, RunHead, RunLog, Runs as _};
use scopeservo_station::Record;
use serde_json::Value;
use std::sync::Arc;

/// The record of a job under way. A library that takes none does not keep the job from its work.
pub struct RunRecord {
    log: Option<Box<dyn RunLog>>,
    library: Arc<Database>,
    frames_bytes: u64,
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
        let record = RunRecord {
            log,
            library: self.library.clone(),
            frames_bytes: (1e9 * self.config.library.frames_gb) as u64,
            journal: self.journal.clone(),
        };
        (record, lost)
    }
}

/// What is said of a target, by what its saving was asked.
pub fn label_of(inputs: &Value) -> Label {
    Label {
        slide: inputs["slide"]
            .as_str()
            .filter(|s| !s.is_empty())
            .map(Into::into),
        note: inputs["note"].as_str().unwrap_or_default().into(),
    }
}

impl RunRecord {
    /// Adds an event.
    pub fn event(&mut self, event: &Record) {
        if let (Some(log), Ok(line)) = (&mut self.log, serde_json::to_string(event)) {
            log.event(&line);
        }
    }

    /// Keeps what the view looked like when the run arrived, beside its report; as long as there is room for such.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    pub fn arrived(&mut self, seen: &[u8]) -> Result<(), LibraryError> {
        match &mut self.log {
            Some(log) => log.attach("arrival.jpg", seen),
            None => Ok(()),
        }
    }

    /// By what it is asked for later, if it is kept.
    pub fn id(&self) -> Option<&str> {
        self.log.as_ref().map(|log| log.id())
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
        // Room for the next ones.
        let within = self.library.keep_frames_within(self.frames_bytes);
        lost.extend(within.err());
        lost
    }
}

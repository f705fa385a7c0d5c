//! What every run did: a folder for each, with what it was asked, its events as they came, and its answer.

use crate::LibraryError;
use crate::files::{self, make_folder};
use crate::folder::{Folder, SCHEMA, entries, no_number, to_json};
use crate::names::{file_name, next_number, number_of, utc};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::fs::{self, File};
use std::io::Write as _;
use std::path::PathBuf;
use std::time::SystemTime;

/// What a run was asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunHead {
    /// What was done: `reposition`, `calibrate`, ...
    pub job: String,
    /// The instrument's name.
    pub instrument: String,
    /// The program and its version.
    pub version: String,
    /// What it was asked to do.
    pub inputs: Value,
}

/// A run's name: its number, when it began and what it is.
pub(crate) fn run_name(number: u64, began: &str, job: &str) -> String {
    format!("{number:06}_{}_{}", began.replace(':', "-"), file_name(job))
}

/// What a run was asked, in its folder.
#[derive(Serialize, Deserialize)]
pub(crate) struct KeptRun {
    pub(crate) schema: u32,
    pub(crate) began: String,
    #[serde(flatten)]
    pub(crate) head: RunHead,
}

/// The runs of a library.
pub trait Runs {
    /// Begins the record of a run.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    fn begin_run(&self, head: &RunHead) -> Result<Box<dyn RunLog>, LibraryError>;
}

/// The record of one run.
pub trait RunLog: Send {
    /// By what it is asked for later, as 000012_2026-11-24T20-15-00Z_reposition.
    fn id(&self) -> &str;

    /// Adds an event, as JSON on one line. What cannot be written is told at the end, and keeps nothing up.
    fn event(&mut self, line: &str);

    /// Adds a file, such as a report.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    fn attach(&mut self, name: &str, bytes: &[u8]) -> Result<(), LibraryError>;

    /// Writes the answer, and makes the events last.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`], also for events that could not be written.
    fn end(&mut self, answer: &Value) -> Result<(), LibraryError>;
}

struct Record {
    id: String,
    folder: PathBuf,
    events: File,
    lost: Option<LibraryError>,
}

impl Folder {
    pub(crate) fn run_folder(&self) -> PathBuf {
        self.path().join("runs")
    }

    /// Where the runs lie, the oldest first.
    pub(crate) fn runs(&self) -> Result<Vec<PathBuf>, LibraryError> {
        let all = entries(&self.run_folder())?.into_iter();
        let mut all: Vec<PathBuf> = all.filter(|p| p.is_dir()).collect();
        all.sort_by_key(|p| (number_of(p), p.clone()));
        Ok(all)
    }
}

impl Runs for Folder {
    fn begin_run(&self, head: &RunHead) -> Result<Box<dyn RunLog>, LibraryError> {
        let runs = self.run_folder();
        make_folder(&runs).map_err(LibraryError::not_kept(&runs))?;
        let began = utc(SystemTime::now());
        let folder = loop {
            let last = self.runs()?.iter().map(|p| number_of(p)).max();
            let number = next_number(last)
                .ok_or_else(|| no_number(&runs))
                .map_err(LibraryError::not_kept(&runs))?;
            let folder = runs.join(run_name(number, &began, &head.job));
            // Another program may begin one at the same time: whichever comes second takes the next number.
            match fs::create_dir(&folder) {
                Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
                made => {
                    made.map_err(LibraryError::not_kept(&folder))?;
                    break folder;
                }
            }
        };
        let kept = KeptRun {
            schema: SCHEMA,
            began,
            head: head.clone(),
        };
        let file = folder.join("run.json");
        files::replace(&file, &to_json(&kept)?).map_err(LibraryError::not_kept(&file))?;
        let events = folder.join("events.jsonl");
        let events = File::create_new(&events).map_err(LibraryError::not_kept(&events))?;
        let id = folder.file_name().unwrap_or_default();
        Ok(Box::new(Record {
            id: id.to_string_lossy().into_owned(),
            folder,
            events,
            lost: None,
        }))
    }
}

impl RunLog for Record {
    fn id(&self) -> &str {
        &self.id
    }

    fn event(&mut self, line: &str) {
        let file = self.folder.join("events.jsonl");
        let written = self.events.write_all(format!("{line}\n").as_bytes());
        if let (Err(error), None) = (written, &self.lost) {
            self.lost = Some(LibraryError::not_kept(&file)(error));
        }
    }

    fn attach(&mut self, name: &str, bytes: &[u8]) -> Result<(), LibraryError> {
        let file = self.folder.join(name);
        files::replace(&file, bytes).map_err(LibraryError::not_kept(&file))
    }

    fn end(&mut self, answer: &Value) -> Result<(), LibraryError> {
        let bytes = to_json(answer)?;
        self.attach("answer.json", &bytes)?;
        let events = self.folder.join("events.jsonl");
        self.events
            .sync_all()
            .map_err(LibraryError::not_kept(&events))?;
        self.lost.take().map_or(Ok(()), Err)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_run_has_a_folder_with_what_was_asked_what_happened_and_the_answer() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::new(dir.path().into());
        let head = RunHead {
            job: "reposition".into(),
            instrument: "lab".into(),
            version: "scopeservo 0.1.0".into(),
            inputs: json!({"target": "mitosis-3"}),
        };
        for n in 1..=3 {
            let mut run = folder.begin_run(&head).unwrap();
            run.event(&json!({"event": n}).to_string());
            run.event("{}");
            run.end(&json!({"verdict": "arrived"})).unwrap();
        }
        let runs = folder.runs().unwrap();
        assert_eq!(
            runs.iter().map(|r| number_of(r)).collect::<Vec<_>>(),
            [1, 2, 3]
        );
        let events = fs::read_to_string(runs[2].join("events.jsonl")).unwrap();
        assert_eq!(events, "{\"event\":3}\n{}\n");
        let asked: Value =
            serde_json::from_slice(&fs::read(runs[0].join("run.json")).unwrap()).unwrap();
        assert_eq!(asked["inputs"]["target"], "mitosis-3");
        assert!(runs[0].join("answer.json").exists());
    }
}

//! The journal of the job under way: what a killed program was at, so that the next one can go on with it or end it.
//!
//! `head.json` tells the job; `state.json` is replaced before each step. Long strings of the state, such as the features of a reference
//! frame, and what lists begin with, such as the views of a calibration, are files of their own under their checksum, written once, so that a
//! step writes little.

use crate::LibraryError;
use crate::files::{self, checksum, make_folder};
use crate::folder::{Folder, SCHEMA, read, to_json};
use crate::names::{file_name, utc};
use scopeservo_scope::{ObjectiveId, StagePose};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::fs::{self, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// A longer string of a state is a file of its own.
const LONG: usize = 512;
const BLOB: &str = "$blob";
/// Elements of a list, as many as are this long together, are a file: what a list that grows had before is not written again, bytes.
const PART: usize = 2048;
const PARTS: &str = "$part";
/// No file of a journal is larger, bytes.
const LARGEST: u64 = 256 << 20;
/// Where the stage was sent since the last step, a line each.
const GOALS: &str = "goals.jsonl";

/// The job under way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JournalHead {
    /// What is done: `reposition`, `calibrate`, ...
    pub job: String,
    /// When it began, UTC.
    pub began: String,
    /// What it was asked to do.
    pub inputs: Value,
    /// Name and id of the target that it refers to.
    pub target: Option<[String; 2]>,
}

/// Where it stood before a step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JournalStep {
    /// Counts the steps.
    pub step: u64,
    /// Where the stage said it was.
    pub stage: StagePose,
    /// Whether it knew where it is.
    pub homed: bool,
    /// The active objective.
    pub objective: Option<ObjectiveId>,
    /// The state of the procedure.
    pub state: Value,
}

/// What a killed program left.
#[derive(Debug, Clone, PartialEq)]
pub struct Journalled {
    /// The job.
    pub head: JournalHead,
    /// Its last step; `None` when it did not come to one.
    pub step: Option<JournalStep>,
    /// Where the stage was sent since.
    pub goals: Vec<StagePose>,
}

#[derive(Serialize, Deserialize)]
struct Kept<T> {
    schema: u32,
    #[serde(flatten)]
    what: T,
}

/// The journal of an instrument. There is one job at a time.
pub trait Journal {
    /// Begins the journal of a job, in place of what may be there.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    fn begin_journal(&self, instrument: &str, head: &JournalHead) -> Result<(), LibraryError>;

    /// Replaces the state, before a step. Returns how many bytes were written.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    fn journal_step(&self, instrument: &str, step: &JournalStep) -> Result<usize, LibraryError>;

    /// Adds a place where the stage is about to be sent. It need not outlive a power cut, after which the stage stands anyway.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    fn journal_goal(&self, instrument: &str, to: &StagePose) -> Result<(), LibraryError>;

    /// The job has ended.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    fn end_journal(&self, instrument: &str) -> Result<(), LibraryError>;

    /// What was under way when a program was killed; `None` when nothing was.
    ///
    /// # Errors
    /// [`LibraryError::DamagedJournal`].
    fn journal(&self, instrument: &str) -> Result<Option<Journalled>, LibraryError>;

    /// Puts a journal that cannot be read aside, whole, so that nothing waits any longer and nothing of it is lost. Returns where it lies;
    /// `None` when there is none.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    fn set_journal_aside(&self, instrument: &str) -> Result<Option<PathBuf>, LibraryError>;
}

impl Folder {
    fn journal_of(&self, instrument: &str) -> PathBuf {
        self.path().join("journal").join(file_name(instrument))
    }

    /// Name and id of the targets of all jobs that are under way or were left, of whatever instrument. A journal that cannot be read tells none.
    pub(crate) fn journalled_targets(&self) -> Vec<[String; 2]> {
        let all = crate::folder::entries(&self.path().join("journal")).unwrap_or_default();
        // What was put aside is nobody's any more.
        let all = all
            .into_iter()
            .filter(|folder| folder.extension().is_none());
        let head = |folder: PathBuf| read::<Kept<JournalHead>>(&folder.join("head.json")).ok();
        all.filter_map(|folder| head(folder)?.what.target).collect()
    }
}

impl Journal for Folder {
    fn begin_journal(&self, instrument: &str, head: &JournalHead) -> Result<(), LibraryError> {
        self.end_journal(instrument)?;
        let folder = self.journal_of(instrument);
        make_folder(&folder).map_err(LibraryError::not_kept(&folder))?;
        let file = folder.join("head.json");
        let kept = Kept {
            schema: SCHEMA,
            what: head,
        };
        files::replace(&file, &to_json(&kept)?).map_err(LibraryError::not_kept(&file))
    }

    fn journal_step(&self, instrument: &str, step: &JournalStep) -> Result<usize, LibraryError> {
        let folder = self.journal_of(instrument);
        let mut written = 0;
        let mut blobs = Vec::new();
        let state = without_long(step.state.clone(), &mut blobs);
        for (name, text) in blobs {
            let file = folder.join(&name);
            if !file.exists() {
                files::renew(&file, text.as_bytes()).map_err(LibraryError::not_kept(&file))?;
                written += text.len();
            }
        }
        let kept = Kept {
            schema: SCHEMA,
            what: JournalStep {
                state,
                ..step.clone()
            },
        };
        let bytes = serde_json::to_vec(&kept).map_err(|e| LibraryError::Encode(e.to_string()))?;
        let file = folder.join("state.json");
        files::renew(&file, &bytes).map_err(LibraryError::not_kept(&file))?;
        // Only now: goals of the step before do no harm to this one.
        let goals = folder.join(GOALS);
        if goals.exists() {
            fs::write(&goals, "").map_err(LibraryError::not_kept(&goals))?;
        }
        Ok(written + bytes.len())
    }

    fn journal_goal(&self, instrument: &str, to: &StagePose) -> Result<(), LibraryError> {
        let file = self.journal_of(instrument).join(GOALS);
        let line = serde_json::to_string(to).map_err(|e| LibraryError::Encode(e.to_string()))?;
        let opened = OpenOptions::new().create(true).append(true).open(&file);
        opened
            .and_then(|mut f| f.write_all(format!("{line}\n").as_bytes()))
            .map_err(LibraryError::not_kept(&file))
    }

    fn end_journal(&self, instrument: &str) -> Result<(), LibraryError> {
        let folder = self.journal_of(instrument);
        // The head first: without it there is no journal, whatever else is left.
        let gone = |path: &Path| match fs::remove_file(path) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                Err(LibraryError::not_kept(path)(e))
            }
            _ => Ok(()),
        };
        gone(&folder.join("head.json"))?;
        for file in crate::folder::entries(&folder)? {
            gone(&file)?;
        }
        Ok(())
    }

    fn journal(&self, instrument: &str) -> Result<Option<Journalled>, LibraryError> {
        let folder = self.journal_of(instrument);
        read_journal(&folder).map_err(|error| LibraryError::DamagedJournal {
            path: folder,
            what: match error {
                // Its end is how to make it again, which nobody can.
                LibraryError::Damaged { what, .. } => first_sentence(&what).into(),
                error => error.to_string(),
            },
        })
    }

    fn set_journal_aside(&self, instrument: &str) -> Result<Option<PathBuf>, LibraryError> {
        let folder = self.journal_of(instrument);
        if !files::is_there(&folder) {
            return Ok(None);
        }
        let when = utc(SystemTime::now()).replace(':', "-");
        // No instrument's journal is called so: a dot in a name is written as its number.
        let named = |k: u32| match k {
            0 => folder.with_extension(format!("damaged-{when}")),
            k => folder.with_extension(format!("damaged-{when}_{k}")),
        };
        let aside = (0..).map(named).find(|to| !files::is_there(to));
        let aside = aside.unwrap_or_default();
        fs::rename(&folder, &aside).map_err(LibraryError::not_kept(&aside))?;
        Ok(Some(aside))
    }
}

fn first_sentence(text: &str) -> &str {
    text.split_once(". ").map_or(text, |(first, _)| first)
}

/// What is in the folder of a journal.
fn read_journal(folder: &Path) -> Result<Option<Journalled>, LibraryError> {
    let (head, state) = (folder.join("head.json"), folder.join("state.json"));
    if !head.exists() {
        return Ok(None);
    }
    let Kept { what: head, .. } = read::<Kept<JournalHead>>(&head)?;
    let mut step = None;
    if state.exists() {
        let Kept { what, .. } = read::<Kept<JournalStep>>(&state)?;
        let state = with_long(what.state, folder)?;
        step = Some(JournalStep { state, ..what });
    }
    let goals = match scopeservo_files::read_text(&folder.join(GOALS), LARGEST) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => String::new(),
        text => text.map_err(LibraryError::read(folder))?,
    };
    // A last line that is cut off was never sent.
    let goals = goals
        .lines()
        .filter_map(|l| serde_json::from_str(l).ok())
        .collect();
    Ok(Some(Journalled { head, step, goals }))
}

/// Takes the long strings and the beginnings of long lists out, each with the name of its file.
fn without_long(value: Value, blobs: &mut Vec<(String, String)>) -> Value {
    match value {
        Value::String(text) if text.len() > LONG => json!({BLOB: own_file(text, blobs)}),
        Value::Array(all) => {
            let all: Vec<Value> = all.into_iter().map(|v| without_long(v, blobs)).collect();
            Value::Array(in_parts(all, blobs))
        }
        Value::Object(all) => {
            let all = all.into_iter();
            let all = all.map(|(key, v)| (key, without_long(v, blobs)));
            Value::Object(all.collect())
        }
        other => other,
    }
}

/// A text becomes a file, whose name it is.
fn own_file(text: String, blobs: &mut Vec<(String, String)>) -> String {
    let name = format!("{}.txt", checksum(text.as_bytes()));
    blobs.push((name.clone(), text));
    name
}

/// A list whose elements are files from its beginning on, [`PART`] by `PART`, and its last few themselves: where one is added the files stay.
fn in_parts(all: Vec<Value>, blobs: &mut Vec<(String, String)>) -> Vec<Value> {
    let (mut parts, mut last, mut length) = (Vec::new(), Vec::new(), 0);
    for value in all {
        length += value.to_string().len() + 1;
        last.push(value);
        if length >= PART && last.len() > 1 {
            let text = Value::Array(std::mem::take(&mut last)).to_string();
            parts.push(json!({PARTS: own_file(text, blobs)}));
            length = 0;
        }
    }
    parts.append(&mut last);
    parts
}

/// The only entry of an object, where that is its key.
fn only<'a>(value: &'a Value, key: &str) -> Option<&'a str> {
    let all = value.as_object().filter(|all| all.len() == 1)?;
    all.get(key)?.as_str()
}

/// What is in a file of the state.
fn file_of_state(name: &str, folder: &Path) -> Result<String, LibraryError> {
    let known: BTreeSet<char> = "0123456789abcdef.txt".chars().collect();
    if !name.chars().all(|c| known.contains(&c)) {
        return Err(LibraryError::damaged(
            folder,
            "its state names no file of its own",
        ));
    }
    let file = folder.join(name);
    let text = scopeservo_files::read_text(&file, LARGEST).map_err(LibraryError::read(&file))?;
    if name != format!("{}.txt", checksum(text.as_bytes())) {
        return Err(LibraryError::damaged(&file, "its checksum is another"));
    }
    Ok(text)
}

/// Puts the long strings and the beginnings of lists back.
fn with_long(value: Value, folder: &Path) -> Result<Value, LibraryError> {
    Ok(match value {
        Value::Array(all) => {
            let mut whole = Vec::with_capacity(all.len());
            for value in all {
                let Some(name) = only(&value, PARTS) else {
                    whole.push(with_long(value, folder)?);
                    continue;
                };
                let part = file_of_state(name, folder)?;
                let part: Vec<Value> = serde_json::from_str(&part)
                    .map_err(|e| LibraryError::damaged(&folder.join(name), e))?;
                for value in part {
                    whole.push(with_long(value, folder)?);
                }
            }
            Value::Array(whole)
        }
        Value::Object(all) if all.len() == 1 && all.contains_key(BLOB) => {
            match only(&Value::Object(all.clone()), BLOB) {
                Some(name) => Value::String(file_of_state(name, folder)?),
                None => Value::Object(all),
            }
        }
        Value::Object(all) => {
            let all = all.into_iter();
            let all = all.map(|(key, v)| Ok((key, with_long(v, folder)?)));
            Value::Object(all.collect::<Result<_, LibraryError>>()?)
        }
        other => other,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head() -> JournalHead {
        JournalHead {
            job: "reposition".into(),
            began: "2026-11-26T04:00:00Z".into(),
            inputs: json!({"lambda": 0.7}),
            target: Some(["mitosis-3".into(), "ab12".into()]),
        }
    }

    fn step(n: u64) -> JournalStep {
        JournalStep {
            step: n,
            stage: StagePose::default(),
            homed: true,
            objective: Some(ObjectiveId("20x".into())),
            state: json!({"iteration": n, "reference": "f".repeat(100_000), "short": "abc"}),
        }
    }

    #[test]
    fn a_state_comes_back_and_a_step_writes_what_is_new() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::new(dir.path().into());
        assert_eq!(folder.journal("lab").unwrap(), None);
        folder.begin_journal("lab", &head()).unwrap();
        assert_eq!(folder.journal("lab").unwrap().unwrap().step, None);
        assert!(folder.journal_step("lab", &step(1)).unwrap() > 100_000);
        assert!(folder.journal_step("lab", &step(2)).unwrap() < 1000);
        let goal = StagePose::default().with_si(scopeservo_scope::Axis::X, 1e-5);
        folder.journal_goal("lab", &goal).unwrap();
        let back = folder.journal("lab").unwrap().unwrap();
        assert_eq!((back.head, back.step), (head(), Some(step(2))));
        assert_eq!(back.goals, [goal]);
        folder.journal_step("lab", &step(3)).unwrap();
        assert_eq!(folder.journal("lab").unwrap().unwrap().goals, []);
        assert_eq!(folder.journal("other").unwrap(), None);
        folder.end_journal("lab").unwrap();
        assert_eq!(folder.journal("lab").unwrap(), None);
        // The next job begins with nothing of this one.
        folder.begin_journal("lab", &head()).unwrap();
        assert_eq!(folder.journal("lab").unwrap().unwrap().step, None);
    }

    /// What a list had before is not written again, and no step of a long job writes more than the others.
    #[test]
    fn a_list_that_grows_is_written_once() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::new(dir.path().into());
        folder.begin_journal("lab", &head()).unwrap();
        let view = |k: usize| {
            let at = [0.1 * k as f64; 12];
            json!({"k": k, "at": at.as_slice(), "features": "f".repeat(600 + k)})
        };
        let mut views = Vec::new();
        let mut most = 0;
        for n in 0..200 {
            views.push(view(n));
            let state = json!({"views": views, "of each": [[1, 2], [3, n]], "none": []});
            let state = JournalStep {
                state,
                ..step(n as u64)
            };
            let written = folder.journal_step("lab", &state).unwrap();
            most = most.max(written);
            if n % 37 == 0 || n == 199 {
                let back = folder.journal("lab").unwrap().unwrap();
                assert_eq!(back.step, Some(state));
            }
        }
        // One view and its features, a part of the list that is full, and the places of the parts.
        assert!(most < 8000, "{most}");
    }

    #[test]
    fn a_damaged_journal_is_told_and_put_aside_whole() {
        for (file, now) in [
            ("txt", "other"),
            ("state.json", "{\"schema\": 1, \"step\""),
            ("head.json", ""),
            ("head.json", "{\"schema\": 99}"),
        ] {
            let dir = tempfile::tempdir().unwrap();
            let folder = Folder::new(dir.path().into());
            assert_eq!(folder.set_journal_aside("my lab").unwrap(), None);
            let mut aside = Vec::new();
            // A second one of the same second has a place too.
            for _ in 0..2 {
                folder.begin_journal("my lab", &head()).unwrap();
                folder.journal_step("my lab", &step(1)).unwrap();
                let all = crate::folder::entries(&folder.journal_of("my lab")).unwrap();
                let one = |p: &&PathBuf| p.to_string_lossy().ends_with(file);
                fs::write(all.iter().find(one).unwrap(), now).unwrap();
                let error = folder.journal("my lab").unwrap_err();
                let told = error.to_string();
                assert!(
                    matches!(error, LibraryError::DamagedJournal { .. }),
                    "{told}"
                );
                assert!(!told.contains("make it again"), "{told}");
                let to = folder.set_journal_aside("my lab").unwrap().unwrap();
                assert_eq!(crate::folder::entries(&to).unwrap().len(), all.len());
                assert_eq!(folder.journal("my lab").unwrap(), None);
                aside.push(to);
            }
            assert_ne!(aside[0], aside[1]);
        }
    }
}

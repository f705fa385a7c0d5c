//! A library as plain files, as versions without a database kept it: whoever wants to leave takes all along.

use crate::database::measured_rows::Kind;
use crate::database::store::Database;
use crate::files::make_folder;
use crate::folder::{Folder, SCHEMA, entries, to_json};
use crate::runs::KeptRun;
use crate::targets::{ENDING, is_first};
use crate::{LibraryError, RunHead, RunQuery, TargetQuery, keep_new};
use scopeservo_scope::ObjectiveId;
use serde::Serialize;
use std::io;
use std::path::{Path, PathBuf};

/// What was written.
#[derive(Debug, Default, Serialize)]
pub struct Exported {
    /// Targets.
    pub targets: usize,
    /// Calibrations and the like.
    pub measurements: usize,
    /// Runs.
    pub runs: usize,
    /// What could not be written, and why.
    #[serde(skip)]
    pub left: Vec<LibraryError>,
}

impl Database {
    /// Writes all but the bin and brought pictures into a folder that is empty or not there yet. `progress` hears how many targets and runs of how many are done.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`], those of the database. Files that are damaged or gone are told in the answer.
    pub fn export(
        &self,
        to: &Path,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Exported, LibraryError> {
        if !entries(to)?.is_empty() {
            return Err(LibraryError::not_kept(to)(io::Error::other(
                "the folder is not empty",
            )));
        }
        let out = Folder::new(to.into());
        let targets = self.find_targets(&TargetQuery::default())?;
        let runs = self.runs(&RunQuery {
            limit: usize::MAX,
            ..RunQuery::default()
        })?;
        let all = targets.len() + runs.len();
        let mut done = Exported::default();
        for (k, row) in targets.iter().enumerate() {
            progress(k, all);
            let file = match is_first(Path::new(&row.file)) {
                true => out.targets().join(format!("{}.json", row.name)),
                false => out.targets().join(format!("{}.{ENDING}", row.name)),
            };
            if let Some(picture) = &row.picture {
                done.left
                    .extend(self.copy(picture, &file.with_extension("png")).err());
            }
            out.put_label(&row.name, &row.label)?;
            match self.copy(&row.file, &file) {
                Ok(()) => done.targets += 1,
                Err(error) => done.left.push(error),
            }
        }
        for (number, row) in self.measurements()?.into_iter().enumerate() {
            let place = row.place(&out, number as u64 + 1);
            match self.copy(&row.file, &place) {
                Ok(()) => done.measurements += 1,
                Err(error) => done.left.push(error),
            }
        }
        for (k, row) in runs.iter().enumerate() {
            progress(targets.len() + k, all);
            self.export_run(&row.id, &out.run_folder().join(&row.id), &mut done)?;
        }
        progress(all, all);
        Ok(done)
    }

    /// A whole file, never over another.
    fn copy(&self, object: &str, to: &Path) -> Result<(), LibraryError> {
        put(to, &self.objects().get(object)?)
    }

    fn export_run(&self, id: &str, to: &Path, done: &mut Exported) -> Result<(), LibraryError> {
        let row = self.run(id)?;
        let (inputs, answer) = self.run_said(id)?;
        let kept = KeptRun {
            schema: SCHEMA,
            began: row.began,
            head: RunHead {
                job: row.job,
                instrument: row.instrument,
                version: self.run_version(id)?,
                inputs,
            },
        };
        put(&to.join("run.json"), &to_json(&kept)?)?;
        let events: String = self
            .run_events(id)?
            .iter()
            .map(|line| format!("{line}\n"))
            .collect();
        put(&to.join("events.jsonl"), events.as_bytes())?;
        for (name, object) in self.run_files(id)? {
            done.left.extend(self.copy(&object, &to.join(name)).err());
        }
        if let Some(answer) = answer {
            put(&to.join("answer.json"), &to_json(&answer)?)?;
        }
        done.runs += 1;
        Ok(())
    }

    fn run_version(&self, id: &str) -> Result<String, LibraryError> {
        self.read(|c| {
            Ok(
                c.query_row("SELECT version FROM runs WHERE name = ?1", [id], |r| {
                    r.get(0)
                })?,
            )
        })
    }

    fn run_files(&self, id: &str) -> Result<Vec<(String, String)>, LibraryError> {
        self.read(|c| {
            let mut all = c.prepare(
                "SELECT attachments.name, file FROM attachments JOIN runs ON runs.id = run WHERE runs.name = ?1",
            )?;
            let all = all.query_map([id], |row| Ok((row.get(0)?, row.get(1)?)))?;
            Ok(all.collect::<Result<_, _>>()?)
        })
    }

    fn measurements(&self) -> Result<Vec<Measurement>, LibraryError> {
        self.read(|c| {
            let mut all = c.prepare(
                "SELECT kind, name, of, made, file FROM measurements JOIN instruments ON instruments.id = instrument
                 ORDER BY measurements.id",
            )?;
            let all = all.query_map([], |row| {
                Ok(Measurement {
                    kind: row.get(0)?,
                    instrument: row.get(1)?,
                    of: row.get(2)?,
                    made: row.get(3)?,
                    file: row.get(4)?,
                })
            })?;
            Ok(all.collect::<Result<_, _>>()?)
        })
    }
}

struct Measurement {
    kind: String,
    instrument: String,
    of: String,
    made: String,
    file: String,
}

impl Measurement {
    fn place(&self, out: &Folder, number: u64) -> PathBuf {
        let file = format!("{number:06}_{}.json", self.made.replace(':', "-"));
        match self.kind.as_str() {
            kind if kind == Kind::Calibration.word() => out
                .calibrations_of(&ObjectiveId(self.of.clone()))
                .join(file),
            kind if kind == Kind::Set.word() => out.sets_of(&self.instrument).join(file),
            kind if kind == Kind::Switching.word() => {
                out.switchings_of(&self.instrument).join(file)
            }
            _ => {
                let size = self
                    .of
                    .split_once('x')
                    .and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
                out.shadows_of(&self.instrument, size.unwrap_or_default())
            }
        }
    }
}

fn put(path: &Path, bytes: &[u8]) -> Result<(), LibraryError> {
    if let Some(folder) = path.parent() {
        make_folder(folder).map_err(LibraryError::not_kept(folder))?;
    }
    keep_new(path, bytes)
}

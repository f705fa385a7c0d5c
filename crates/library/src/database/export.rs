//! A library as plain files, as versions without a database kept it: whoever wants to leave takes all along.
//!
//! An export that ended early says so in its folder (`UNFINISHED.txt`), and the next one into it goes on: what is there already stays.

use crate::database::measured_rows::Kind;
use crate::database::pictures::PictureRow;
use crate::database::store::Database;
use crate::database::target_rows::TargetRow;
use crate::files::{self, is_there, make_folder};
use crate::folder::{Folder, SCHEMA, entries, to_json};
use crate::runs::KeptRun;
use crate::targets::{ENDING, LABEL, is_first};
use crate::{Label, LibraryError, RunHead, RunQuery, TargetQuery};
use scopeservo_scope::ObjectiveId;
use serde::Serialize;
use serde_json::json;
use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Component, Path, PathBuf};

/// Lies in the folder until all is there.
const UNFINISHED: &str = "UNFINISHED.txt";

/// What was written.
#[derive(Debug, Default, Serialize)]
pub struct Exported {
    /// Targets.
    pub targets: usize,
    /// Calibrations and the like.
    pub measurements: usize,
    /// Runs.
    pub runs: usize,
    /// Pictures: those of targets, of arrivals, and those that somebody brought.
    pub pictures: usize,
    /// What could not be written, and why.
    #[serde(skip)]
    pub left: Vec<LibraryError>,
}

/// An export that is under way.
struct Export<'a> {
    library: &'a Database,
    to: &'a Path,
    done: Exported,
    /// All that belongs there.
    written: BTreeSet<PathBuf>,
}

impl Database {
    /// Writes all but the bin into a folder that is empty, not there yet, or holds an export that ended early. `progress` hears how many
    /// targets and runs of how many are done.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`], as where there is no room: nothing further is written then, and the folder says that it is not whole; those of
    /// the database. Files that are damaged or gone are told in the answer, each by what it is of.
    pub fn export(
        &self,
        to: &Path,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Exported, LibraryError> {
        let mark = to.join(UNFINISHED);
        if !entries(to)?.is_empty() && !is_there(&mark) {
            return Err(LibraryError::not_kept(to)(io::Error::other(
                "the folder is not empty",
            )));
        }
        let mut export = Export {
            library: self,
            to,
            done: Exported::default(),
            written: BTreeSet::new(),
        };
        export.put(
            &mark,
            b"This export has not ended. The same command into this folder goes on with it.\n",
        )?;
        export.all(progress)?;
        export.tell_others()?;
        fs::remove_file(&mark).map_err(LibraryError::not_kept(&mark))?;
        Ok(export.done)
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

impl Export<'_> {
    fn all(&mut self, progress: &mut dyn FnMut(usize, usize)) -> Result<(), LibraryError> {
        let library = self.library;
        let out = Folder::new(self.to.into());
        let targets = library.find_targets(&TargetQuery::default())?;
        let runs = library.runs(&RunQuery {
            limit: usize::MAX,
            ..RunQuery::default()
        })?;
        let all = targets.len() + runs.len();
        for (k, row) in targets.iter().enumerate() {
            progress(k, all);
            self.target(&out, row)?;
        }
        for (number, row) in library.measurements()?.into_iter().enumerate() {
            let place = row.place(&out, number as u64 + 1);
            let what = format!("the {} of {} for {}", row.kind, row.of, row.instrument);
            self.done.measurements += usize::from(self.copy(&what, &row.file, &place)?);
        }
        for picture in library.pictures()? {
            self.picture(&picture)?;
        }
        for (k, row) in runs.iter().enumerate() {
            progress(targets.len() + k, all);
            match self.run(&row.id, &out.run_folder()) {
                // It was purged meanwhile.
                Err(LibraryError::NoRun { .. }) => {}
                told => told?,
            }
        }
        progress(all, all);
        Ok(())
    }

    /// The file that makes it exist comes last.
    fn target(&mut self, out: &Folder, row: &TargetRow) -> Result<(), LibraryError> {
        let name = &row.name;
        let what = format!("the target '{name}'");
        if !self.is_plain(&what, name) {
            return Ok(());
        }
        let ending = match is_first(Path::new(&row.file)) {
            true => "json",
            false => ENDING,
        };
        let at = |ending: &str| out.targets().join(format!("{name}.{ending}"));
        if let Some(picture) = &row.picture {
            let whole = self.copy(&format!("the picture of '{name}'"), picture, &at("png"))?;
            self.done.pictures += usize::from(whole);
        }
        if row.label != Label::default() {
            self.put(&at(LABEL), &to_json(&row.label)?)?;
        }
        let whole = self.copy(&what, &row.file, &at(ending))?;
        self.done.targets += usize::from(whole);
        Ok(())
    }

    /// One that somebody brought, with what was said of it.
    fn picture(&mut self, row: &PictureRow) -> Result<(), LibraryError> {
        let what = format!("the picture '{}' that was brought", row.name);
        let folder = self.to.join("pictures");
        let ending = Path::new(&row.file).extension().unwrap_or_default();
        let ending = ending.to_string_lossy();
        if !self.is_plain(&what, &row.name) {
            return Ok(());
        }
        let at = |ending: &str| folder.join(format!("{}.{ending}", row.name));
        let said = json!({"um_per_px": row.um_per_px, "user": row.user, "brought": row.brought});
        self.put(&at("json"), &to_json(&said)?)?;
        let whole = self.copy(&what, &row.file, &at(&ending))?;
        self.done.pictures += usize::from(whole);
        Ok(())
    }

    fn run(&mut self, id: &str, runs: &Path) -> Result<(), LibraryError> {
        let library = self.library;
        let what = format!("the run '{id}'");
        if !self.is_plain(&what, id) {
            return Ok(());
        }
        let to = runs.join(id);
        let row = library.run(id)?;
        let (inputs, answer) = library.run_said(id)?;
        let kept = KeptRun {
            schema: SCHEMA,
            began: row.began,
            head: RunHead {
                job: row.job,
                instrument: row.instrument,
                version: library.run_version(id)?,
                inputs,
            },
        };
        self.put(&to.join("run.json"), &to_json(&kept)?)?;
        let events = library.run_events(id)?.into_iter();
        let events: String = events.map(|line| format!("{line}\n")).collect();
        self.put(&to.join("events.jsonl"), events.as_bytes())?;
        for (name, object) in library.run_files(id)? {
            let what = format!("{name} of {what}");
            if self.is_plain(&what, &name) && self.copy(&what, &object, &to.join(&name))? {
                self.done.pictures += usize::from(name == "arrival.jpg");
            }
        }
        if let Some(answer) = answer {
            self.put(&to.join("answer.json"), &to_json(&answer)?)?;
        }
        self.done.runs += 1;
        Ok(())
    }

    /// Whether a name is that of one file in its folder, whoever wrote the library; what is not is told.
    fn is_plain(&mut self, what: &str, name: &str) -> bool {
        let mut parts = Path::new(name).components();
        let is_one = matches!(parts.next(), Some(Component::Normal(part)) if part == name)
            && parts.next().is_none();
        if !is_one {
            let why = "its name leads elsewhere".to_owned();
            self.left(what, why);
        }
        is_one
    }

    fn left(&mut self, what: &str, why: String) {
        let what = what.to_owned();
        self.done.left.push(LibraryError::NotExported { what, why });
    }

    /// A whole file; one that is damaged or gone is told by what it is, and is not there then.
    fn copy(&mut self, what: &str, object: &str, to: &Path) -> Result<bool, LibraryError> {
        match self.library.objects().get(object) {
            Ok(bytes) => self.put(to, &bytes).map(|()| true),
            Err(error) => {
                self.left(what, error.to_string());
                Ok(false)
            }
        }
    }

    /// Only a folder of our own is written to: what lies there of another content is of an export before.
    fn put(&mut self, path: &Path, bytes: &[u8]) -> Result<(), LibraryError> {
        if let Some(folder) = path.parent() {
            make_folder(folder).map_err(LibraryError::not_kept(folder))?;
        }
        let limit = bytes.len() as u64;
        if !scopeservo_files::read(path, limit).is_ok_and(|there| there == bytes) {
            files::replace(path, bytes).map_err(LibraryError::not_kept(path))?;
        }
        self.written.insert(path.into());
        Ok(())
    }

    /// What lies there beside: of an export before, and called otherwise or purged by now.
    fn tell_others(&mut self) -> Result<(), LibraryError> {
        let mut folders = vec![self.to.to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in entries(&folder)? {
                if entry.is_dir() {
                    folders.push(entry);
                } else if !self.written.contains(&entry) {
                    let why = "it is of an export before, and the library has no such thing any more: remove it";
                    self.left(&entry.display().to_string(), why.into());
                }
            }
        }
        Ok(())
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

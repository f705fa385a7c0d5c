//! What every run did: a row with what it was asked and how it ended, a row for each event, and its report beside.

use crate::database::objects::Objects;
use crate::database::rows::{Lasting, within};
use crate::database::run_rows::{self, COLUMNS, NewRun, RunRow};
use crate::database::store::Database;
use crate::database::under_way::UnderWay;
use crate::database::wrong::Done;
use crate::names::utc;
use crate::runs::run_name;
use crate::{LibraryError, RunHead, RunLog, Runs};
use rusqlite::{Connection, OptionalExtension as _, params};
use serde_json::Value;
use std::path::PathBuf;
use std::time::SystemTime;

/// Which runs are wanted, the newest first.
#[derive(Debug, Clone, Default)]
pub struct RunQuery<'a> {
    /// So many at most.
    pub limit: usize,
    /// Only those before this one.
    pub before: Option<&'a str>,
    /// Only those to this target.
    pub target: Option<&'a str>,
}

impl Database {
    /// Runs, the newest first.
    ///
    /// # Errors
    /// [`LibraryError::NoRun`] for the one before which they were wanted; those of the database.
    pub fn runs(&self, wanted: &RunQuery<'_>) -> Result<Vec<RunRow>, LibraryError> {
        let before = wanted.before.map(|id| self.run_number(id)).transpose()?;
        self.read(|c| {
            let mut rows = c.prepare_cached(&format!(
                "SELECT {COLUMNS} FROM runs JOIN instruments ON instruments.id = runs.instrument
                 WHERE runs.id < ?1 AND (?2 IS NULL OR target = (SELECT id FROM targets WHERE name = ?2 AND binned IS NULL))
                 ORDER BY runs.id DESC LIMIT ?3"
            ))?;
            let limit = i64::try_from(wanted.limit).unwrap_or(i64::MAX);
            let rows = rows.query_map(params![before.unwrap_or(i64::MAX), wanted.target, limit], RunRow::of)?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    fn run_number(&self, id: &str) -> Result<i64, LibraryError> {
        let number: Option<i64> = self.read(|c| {
            let number = c.query_row("SELECT id FROM runs WHERE name = ?1", [id], |row| {
                row.get(0)
            });
            Ok(number.optional()?)
        })?;
        number.ok_or_else(|| LibraryError::NoRun { id: id.into() })
    }

    /// One run.
    ///
    /// # Errors
    /// [`LibraryError::NoRun`], those of the database.
    pub fn run(&self, id: &str) -> Result<RunRow, LibraryError> {
        let row = self.read(|c| {
            let row = c.query_row(
                &format!("SELECT {COLUMNS} FROM runs JOIN instruments ON instruments.id = runs.instrument WHERE runs.name = ?1"),
                [id],
                RunRow::of,
            );
            Ok(row.optional()?)
        })?;
        row.ok_or_else(|| LibraryError::NoRun { id: id.into() })
    }

    /// What a run was asked and what it answered, where it ended.
    ///
    /// # Errors
    /// [`LibraryError::NoRun`], those of the database.
    pub fn run_said(&self, id: &str) -> Result<(Value, Option<Value>), LibraryError> {
        let run = self.run_number(id)?;
        let (inputs, answer): (String, Option<String>) = self.read(|c| {
            Ok(c.query_row(
                "SELECT inputs, answer FROM runs LEFT JOIN answers ON run = id WHERE id = ?1",
                [run],
                |row| Ok((row.get(0)?, row.get(1)?)),
            )?)
        })?;
        let value = |text: &str| serde_json::from_str(text).unwrap_or_default();
        Ok((value(&inputs), answer.as_deref().map(value)))
    }

    /// The events of a run, each as JSON on one line, in the order in which they came.
    ///
    /// # Errors
    /// [`LibraryError::NoRun`], those of the database.
    pub fn run_events(&self, id: &str) -> Result<Vec<String>, LibraryError> {
        let run = self.run_number(id)?;
        self.read(|c| {
            let mut events =
                c.prepare_cached("SELECT event FROM events WHERE run = ?1 ORDER BY number")?;
            let events = events.query_map([run], |row| row.get(0))?;
            Ok(events.collect::<Result<_, _>>()?)
        })
    }

    /// Where a file of a run lies, such as `report.html`; `None` where it has none of that name.
    ///
    /// # Errors
    /// [`LibraryError::NoRun`], those of the database.
    pub fn run_file(&self, id: &str, name: &str) -> Result<Option<PathBuf>, LibraryError> {
        let run = self.run_number(id)?;
        let file: Option<String> = self.read(|c| {
            let file = c.query_row(
                "SELECT file FROM attachments WHERE run = ?1 AND name = ?2",
                params![run, name],
                |row| row.get(0),
            );
            Ok(file.optional()?)
        })?;
        Ok(file.map(|file| self.objects().place(&file)))
    }

    /// Keeps the frames of a run whatever room they take, or no longer.
    ///
    /// # Errors
    /// [`LibraryError::NoRun`], those of the database.
    pub fn pin_run(&self, id: &str, pinned: bool) -> Result<(), LibraryError> {
        let run = self.run_number(id)?;
        self.write(|change| {
            change.execute(
                "UPDATE runs SET pinned = ?2 WHERE id = ?1",
                params![run, pinned],
            )?;
            Ok(())
        })
    }
}

/// The record of a run under way, by a connection of its own.
struct Record {
    connection: Connection,
    objects: Objects,
    database: PathBuf,
    run: i64,
    id: String,
    events: i64,
    lost: Option<LibraryError>,
    _under_way: Option<UnderWay>,
}

impl Runs for Database {
    fn begin_run(&self, head: &RunHead) -> Result<Box<dyn RunLog>, LibraryError> {
        let began = utc(SystemTime::now());
        let (run, id, under_way) = self.write(|change| {
            let id = run_rows::next(change)?;
            let name = run_name(id as u64, &began, &head.job);
            let under_way = UnderWay::begin(self.path(), &name);
            NewRun {
                id,
                name: &name,
                began: &began,
                head,
            }
            .insert(change)?;
            Ok((id, name, under_way))
        })?;
        Ok(Box::new(Record {
            // An event that came is there when the program is killed; that it is when power fails nobody waits for.
            connection: self.connect(Lasting::Program)?,
            objects: self.objects().clone(),
            database: self.file(),
            run,
            id,
            events: 0,
            lost: None,
            _under_way: under_way,
        }))
    }
}

impl Record {
    fn write<T>(
        &mut self,
        change: impl FnOnce(&rusqlite::Transaction<'_>, i64) -> Done<T>,
    ) -> Result<T, LibraryError> {
        let run = self.run;
        let written = within(&mut self.connection, |c| change(c, run));
        written.map_err(|wrong| wrong.of(&self.database))
    }
}

impl RunLog for Record {
    fn id(&self) -> &str {
        &self.id
    }

    fn event(&mut self, line: &str) {
        self.events += 1;
        let written = run_rows::event(&self.connection, self.run, self.events, line);
        if let (Err(wrong), None) = (written, &self.lost) {
            self.lost = Some(wrong.of(&self.database));
        }
    }

    fn attach(&mut self, name: &str, bytes: &[u8]) -> Result<(), LibraryError> {
        let _held = self.objects.hold()?;
        let ending = name.rsplit_once('.').map_or("bin", |(_, ending)| ending);
        let file = self.objects.put(bytes, ending)?;
        self.write(|change, run| run_rows::attach(change, run, name, &file))
    }

    fn end(&mut self, answer: &Value) -> Result<(), LibraryError> {
        let full = self.connection.pragma_update(None, "synchronous", "FULL");
        full.map_err(|e| crate::database::wrong::Wrong::from(e).of(&self.database))?;
        let ended = utc(SystemTime::now());
        self.write(|change, run| run_rows::end(change, run, &ended, answer))?;
        self.lost.take().map_or(Ok(()), Err)
    }
}

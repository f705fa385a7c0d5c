//! The rows of runs.

use crate::RunHead;
use crate::database::objects::Stored;
use crate::database::rows::{instrument, row_of};
use crate::database::wrong::Done;
use rusqlite::{Connection, OptionalExtension as _, Row, params};
use serde::Serialize;
use serde_json::Value;

/// What lists tell of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunRow {
    /// By what it is asked for.
    pub id: String,
    /// What was done: `reposition`, `calibrate`, ...
    pub job: String,
    /// When it began, UTC.
    pub began: String,
    /// When it ended; `None` for one that is under way, or was killed.
    pub ended: Option<String>,
    /// The instrument's name.
    pub instrument: String,
    /// Who asked for it, where that is known.
    pub user: Option<String>,
    /// The slide, where it was named.
    pub slide: Option<String>,
    /// The target's name, of a run that had one.
    pub target: Option<String>,
    /// Where it went back to a target: how that came out.
    pub verdict: Option<String>,
    /// The answer in a sentence.
    pub message: Option<String>,
    /// How long it took.
    pub seconds: Option<f64>,
    /// Whether it has a report.
    pub report: bool,
    /// Whether there is a picture of the view at arrival.
    pub arrival: bool,
    /// Whether its frames stay whatever room they take.
    pub pinned: bool,
}

/// What [`RunRow::of`] reads.
pub(crate) const COLUMNS: &str = "runs.name, job, began, ended, instruments.name, user, slide, target_name, verdict, \
     message, seconds, EXISTS (SELECT 1 FROM attachments WHERE run = runs.id AND name = 'report.html'), pinned, \
     EXISTS (SELECT 1 FROM attachments WHERE run = runs.id AND name = 'arrival.jpg')";

impl RunRow {
    pub(crate) fn of(row: &Row<'_>) -> rusqlite::Result<Self> {
        Ok(Self {
            id: row.get(0)?,
            job: row.get(1)?,
            began: row.get(2)?,
            ended: row.get(3)?,
            instrument: row.get(4)?,
            user: row.get(5)?,
            slide: row.get(6)?,
            target: row.get(7)?,
            verdict: row.get(8)?,
            message: row.get(9)?,
            seconds: row.get(10)?,
            report: row.get(11)?,
            pinned: row.get(12)?,
            arrival: row.get(13)?,
        })
    }
}

/// A run that begins, or that began in an earlier version.
pub(crate) struct NewRun<'a> {
    pub(crate) id: i64,
    pub(crate) name: &'a str,
    pub(crate) began: &'a str,
    pub(crate) head: &'a RunHead,
}

/// The number that the next run gets.
pub(crate) fn next(change: &Connection) -> Done<i64> {
    Ok(
        change.query_row("SELECT coalesce(max(id), 0) + 1 FROM runs", [], |r| {
            r.get(0)
        })?,
    )
}

impl NewRun<'_> {
    pub(crate) fn insert(&self, change: &rusqlite::Transaction<'_>) -> Done<()> {
        let inputs = &self.head.inputs;
        let name = inputs["name"]
            .as_str()
            .or_else(|| inputs["target"].as_str());
        let about = matches!(self.head.job.as_str(), "reposition" | "save_target");
        let name = name.filter(|_| about);
        let target = name
            .map(|name| of_target(change, name))
            .transpose()?
            .flatten();
        change.prepare_cached(
            "INSERT INTO runs (id, name, job, instrument, version, began, user, slide, target, target_name, inputs)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)",
        )?.execute(params![
            self.id,
            self.name,
            self.head.job,
            instrument(change, &self.head.instrument)?,
            self.head.version,
            self.began,
            inputs["user"].as_str(),
            inputs["slide"].as_str(),
            target,
            name,
            inputs.to_string(),
        ])?;
        Ok(())
    }
}

fn of_target(change: &Connection, name: &str) -> Done<Option<i64>> {
    let id = change.query_row(
        "SELECT id FROM targets WHERE name = ?1 AND binned IS NULL",
        [name],
        |r| r.get(0),
    );
    Ok(id.optional()?)
}

/// Adds an event.
pub(crate) fn event(connection: &Connection, run: i64, number: i64, line: &str) -> Done<()> {
    connection
        .prepare_cached("INSERT INTO events (run, number, event) VALUES (?1, ?2, ?3)")?
        .execute(params![run, number, line])?;
    Ok(())
}

/// Adds a file, in place of one of the same name.
pub(crate) fn attach(
    change: &rusqlite::Transaction<'_>,
    run: i64,
    name: &str,
    file: &Stored,
) -> Done<()> {
    row_of(change, file)?;
    change.execute(
        "INSERT OR REPLACE INTO attachments (run, name, file) VALUES (?1, ?2, ?3)",
        params![run, name, file.name],
    )?;
    Ok(())
}

/// Adds the answer. A run that saved a target is one of that target from now on.
pub(crate) fn end(change: &Connection, run: i64, ended: &str, answer: &Value) -> Done<()> {
    let error = &answer["error"];
    let message = answer["message"]
        .as_str()
        .or_else(|| error["message"].as_str());
    change.execute(
        "INSERT OR REPLACE INTO answers (run, answer) VALUES (?1, ?2)",
        params![run, answer.to_string()],
    )?;
    change.execute(
        "UPDATE runs SET ended = ?2, verdict = ?3, message = ?4, seconds = ?5,
             target = coalesce(target, (SELECT id FROM targets WHERE name = target_name AND binned IS NULL))
         WHERE id = ?1",
        params![run, ended, answer["verdict"].as_str(), message, answer["seconds"].as_f64()],
    )?;
    Ok(())
}

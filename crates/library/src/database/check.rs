//! Whether all that was kept is there, as it was kept.

use crate::LibraryError;
use crate::database::rows::within;
use crate::database::store::Database;
use crate::database::wrong::Done;
use crate::targets::kept_of;
use rusqlite::Connection;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs;
use std::path::PathBuf;

/// Something that is not as it was kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "fault", rename_all = "snake_case")]
pub enum Fault {
    /// The database itself.
    Database {
        /// What SQLite says.
        what: String,
    },
    /// A file is gone.
    Missing {
        /// Its object.
        object: String,
        /// What it was of.
        of: String,
    },
    /// A file is another.
    Changed {
        /// Its object.
        object: String,
        /// What it is of.
        of: String,
    },
    /// A file is what was kept, and cannot be read.
    Unreadable {
        /// Its object.
        object: String,
        /// What it is of.
        of: String,
        /// Why.
        what: String,
    },
    /// The text index does not know what it should.
    Index {
        /// What SQLite says.
        what: String,
    },
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Database { what } => write!(f, "the database is damaged: {what}"),
            Self::Missing { object, of } => write!(
                f,
                "{of}: its file is gone (objects/{}/{object})",
                &object[..2]
            ),
            Self::Changed { object, of } => write!(
                f,
                "{of}: its file is not what was kept (objects/{}/{object})",
                &object[..2]
            ),
            Self::Unreadable { of, what, .. } => write!(f, "{of}: {what}"),
            Self::Index { what } => write!(f, "the text index is damaged: {what}"),
        }
    }
}

/// What was looked at, and what is wrong.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Checked {
    /// Targets, those in the bin too.
    pub targets: usize,
    /// Calibrations and the like.
    pub measurements: usize,
    /// Runs.
    pub runs: usize,
    /// Their events.
    pub events: usize,
    /// Files beside the database.
    pub objects: usize,
    /// How large these are.
    pub bytes: u64,
    /// What is wrong.
    pub faults: Vec<Fault>,
    /// Files that nothing names: what killed programs left.
    pub litter: Vec<PathBuf>,
    /// Whether the litter is gone and the text index made anew.
    pub mended: bool,
}

impl Database {
    /// Reads all that was kept and compares it with what was written down of it. `mend` removes litter and makes the text index anew; nothing
    /// else is changed. `progress` hears how many of how many files are done.
    ///
    /// # Errors
    /// Those of opening the database.
    pub fn check(
        &self,
        mend: bool,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Checked, LibraryError> {
        if !self.file().exists() && !mend {
            return Ok(Checked::default());
        }
        if !mend {
            return self.read(|c| {
                let _held = self.objects().hold()?;
                self.look(c, progress)
            });
        }
        self.sweep(|connection| {
            let mut checked = self.look(connection, progress)?;
            for object in &checked.litter {
                // Whoever cannot remove it can still use the library.
                let _ = fs::remove_file(object);
            }
            within(connection, |change| {
                change.execute_batch(
                    "DELETE FROM objects WHERE name NOT IN (SELECT file FROM uses);
                     DELETE FROM words;
                     INSERT INTO words (rowid, name, note, slide)
                         SELECT targets.id, targets.name, targets.note, coalesce(slides.name, '')
                         FROM targets LEFT JOIN slides ON slides.id = targets.slide;",
                )?;
                Ok(())
            })?;
            checked
                .faults
                .retain(|fault| !matches!(fault, Fault::Index { .. }));
            checked.mended = true;
            Ok(checked)
        })
    }

    fn look(
        &self,
        connection: &Connection,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Done<Checked> {
        let count = |table: &str| -> Done<usize> {
            let count = format!("SELECT count(*) FROM {table}");
            Ok(connection.query_row(&count, [], |row| row.get::<_, i64>(0))? as usize)
        };
        let mut checked = Checked {
            targets: count("targets")?,
            measurements: count("measurements")?,
            runs: count("runs")?,
            events: count("events")?,
            faults: of_database(connection)?,
            ..Checked::default()
        };
        let used = uses(connection)?;
        let there: BTreeSet<PathBuf> = self.objects().all()?.into_iter().collect();
        let place = |object: &String| self.objects().place(object);
        checked.objects = used.len();
        for (done, (object, of)) in used.iter().enumerate() {
            progress(done, used.len());
            let (object, of) = (object.clone(), of.clone());
            if !there.contains(&place(&object)) {
                checked.faults.push(Fault::Missing { object, of });
                continue;
            }
            match self.objects().get(&object) {
                Err(_) => checked.faults.push(Fault::Changed { object, of }),
                Ok(bytes) => {
                    checked.bytes += bytes.len() as u64;
                    let is_target = of.starts_with("target") && !object.ends_with(".png");
                    let read = is_target.then(|| kept_of(&self.objects().place(&object), &bytes));
                    if let Some(Err(error)) = read {
                        checked.faults.push(Fault::Unreadable {
                            object,
                            of,
                            what: error.to_string(),
                        });
                    }
                }
            }
        }
        progress(used.len(), used.len());
        let named: BTreeSet<PathBuf> = used.keys().map(place).collect();
        checked.litter = there.difference(&named).cloned().collect();
        Ok(checked)
    }
}

/// Every object that a row names, and what it is of.
fn uses(connection: &Connection) -> Done<BTreeMap<String, String>> {
    let mut all = connection.prepare(
        "SELECT file, 'run ' || runs.name || ', ' || attachments.name FROM attachments JOIN runs ON runs.id = run
         UNION ALL SELECT file, 'picture ' || name FROM pictures
         UNION ALL SELECT file, kind || ' ' || of || ' of ' || made FROM measurements
         UNION ALL SELECT picture, 'the picture of target ' || name FROM targets WHERE picture IS NOT NULL
         UNION ALL SELECT file, 'target ' || name || iif(binned IS NULL, '', ', in the bin') FROM targets",
    )?;
    let all = all.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?;
    Ok(all.collect::<Result<_, _>>()?)
}

fn of_database(connection: &Connection) -> Done<Vec<Fault>> {
    let mut faults = Vec::new();
    let mut said = connection.prepare("PRAGMA integrity_check")?;
    let said = said.query_map([], |row| row.get::<_, String>(0))?;
    for what in said {
        let what = what?;
        if what != "ok" {
            faults.push(Fault::Database { what });
        }
    }
    let mut strays = connection.prepare("PRAGMA foreign_key_check")?;
    let strays = strays.query_map([], |row| {
        Ok((row.get::<_, String>(0)?, row.get::<_, String>(2)?))
    })?;
    for stray in strays {
        let (table, parent) = stray?;
        faults.push(Fault::Database {
            what: format!("a row of {table} is of none of {parent}"),
        });
    }
    let index =
        connection.execute_batch("INSERT INTO words (words, rank) VALUES ('integrity-check', 1)");
    if let Err(error) = index {
        faults.push(Fault::Index {
            what: error.to_string(),
        });
    }
    let astray: i64 = connection.query_row(
        "SELECT (SELECT count(*) FROM targets) - (SELECT count(*) FROM words)",
        [],
        |row| row.get(0),
    )?;
    if astray != 0 {
        faults.push(Fault::Index {
            what: format!("{astray} more targets than texts"),
        });
    }
    Ok(faults)
}

//! What was removed lies in the bin until it is purged: then nothing of it is left, in no index, event, report or file of before.

use crate::database::store::Database;
use crate::database::target_rows::TargetRow;
use crate::database::targets::is_taken;
use crate::database::under_way;
use crate::database::wrong::{Done, Wrong};
use crate::database::{old, rows};
use crate::names::{check_name, plain_name};
use crate::targets::taken;
use crate::{LibraryError, TargetQuery};
use rusqlite::{Connection, OptionalExtension as _, Transaction, params};
use serde::Serialize;
use std::collections::BTreeSet;

/// A target that is gone for good.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Purged {
    /// What it was called.
    pub name: String,
    /// The runs that went with it.
    pub runs: Vec<String>,
}

/// Objects and runs that were let go of; their files go when the rows are gone for sure.
#[derive(Default)]
pub(crate) struct Gone {
    pub(crate) objects: BTreeSet<String>,
    pub(crate) runs: Vec<String>,
}

impl Database {
    /// What lies in the bin, the newest target first.
    ///
    /// # Errors
    /// Those of the database.
    pub fn bin(&self) -> Result<Vec<TargetRow>, LibraryError> {
        self.find_targets(&TargetQuery {
            binned: true,
            ..TargetQuery::default()
        })
    }

    /// Takes a target back out of the bin, the one that was removed last of those of that name; as `to`, where another has its name now.
    ///
    /// # Errors
    /// [`LibraryError::NotInBin`], [`LibraryError::Taken`], [`LibraryError::BadName`], those of the database.
    pub fn restore_target(&self, name: &str, to: Option<&str>) -> Result<(), LibraryError> {
        let to = to.unwrap_or(name);
        plain_name(to)?;
        check_name(to)?;
        self.write(|change| {
            let Some(id) = newest_binned(change, name)? else {
                return Err(LibraryError::NotInBin { name: name.into() }.into());
            };
            let back = change.execute(
                "UPDATE targets SET binned = NULL, name = ?2 WHERE id = ?1",
                params![id, to],
            );
            match back {
                Err(e) if is_taken(&e) => Err(taken(to).into()),
                back => Ok(back.map(drop)?),
            }
        })
    }

    /// Deletes targets from the bin for good, those of these names or all, with the runs to them: rows, text index, events, reports, and the
    /// files of earlier versions that they came from.
    ///
    /// # Errors
    /// [`LibraryError::NotInBin`] and [`LibraryError::InUse`] before anything is deleted, those of the database.
    pub fn purge_targets(&self, names: Option<&[String]>) -> Result<Vec<Purged>, LibraryError> {
        self.sweep(|connection| {
            let mut gone = Gone::default();
            let purged = rows::within(connection, |change| {
                let ids = match names {
                    None => all_binned(change)?,
                    Some(names) => named(change, names)?,
                };
                for (id, _) in &ids {
                    under_way::is_free(change, self.folder(), *id)?;
                }
                ids.into_iter()
                    .map(|(id, name)| purge(change, id, name, &mut gone))
                    .collect::<Done<Vec<_>>>()
            })?;
            self.delete_files(connection, &gone)?;
            if !purged.is_empty() {
                // What was overwritten may still lie in the file of what is written ahead.
                connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()))?;
            }
            Ok(purged)
        })
    }

    /// Deletes objects that no row names any more, and files of earlier versions that became those or these runs.
    pub(crate) fn delete_files(&self, connection: &mut Connection, gone: &Gone) -> Done<()> {
        let free = rows::within(connection, |change| {
            let mut free = Vec::new();
            for object in &gone.objects {
                let used = change.query_row(
                    "SELECT EXISTS (SELECT 1 FROM uses WHERE file = ?1)",
                    [object],
                    |row| row.get::<_, bool>(0),
                )?;
                if !used {
                    change.execute("DELETE FROM objects WHERE name = ?1", [object])?;
                    free.push(object);
                }
            }
            Ok(free)
        })?;
        for object in &free {
            self.objects().remove(object);
        }
        let became = free.into_iter().chain(&gone.runs);
        old::delete(connection, self.folder(), became)
    }
}

fn newest_binned(change: &Transaction<'_>, name: &str) -> Done<Option<i64>> {
    let id = change.query_row(
        "SELECT id FROM targets WHERE name = ?1 AND binned IS NOT NULL ORDER BY binned DESC, id DESC LIMIT 1",
        [name],
        |row| row.get(0),
    );
    Ok(id.optional()?)
}

fn all_binned(change: &Transaction<'_>) -> Done<Vec<(i64, String)>> {
    let mut all =
        change.prepare("SELECT id, name FROM targets WHERE binned IS NOT NULL ORDER BY id")?;
    let all = all.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?;
    Ok(all.collect::<Result<_, _>>()?)
}

/// Those of these names, all of each; none where one is not there.
fn named(change: &Transaction<'_>, names: &[String]) -> Done<Vec<(i64, String)>> {
    let all = all_binned(change)?;
    if let Some(none) = names
        .iter()
        .find(|n| !all.iter().any(|(_, name)| name == *n))
    {
        return Err(Wrong::Library(LibraryError::NotInBin {
            name: none.clone(),
        }));
    }
    Ok(all
        .into_iter()
        .filter(|(_, name)| names.contains(name))
        .collect())
}

fn purge(change: &Transaction<'_>, id: i64, name: String, gone: &mut Gone) -> Done<Purged> {
    let strings = |sql: &str, id: i64| -> Done<Vec<String>> {
        let mut all = change.prepare(sql)?;
        let all = all.query_map([id], |row| row.get(0))?;
        Ok(all.collect::<Result<_, _>>()?)
    };
    // Also those that went wrong before there was a target of that name.
    const ITS_RUNS: &str = "(runs.target = ?1 OR (runs.target IS NULL AND runs.target_name = (SELECT name FROM targets WHERE id = ?1)))";
    gone.objects
        .extend(strings("SELECT file FROM targets WHERE id = ?1", id)?);
    gone.objects.extend(strings(
        "SELECT picture FROM targets WHERE id = ?1 AND picture IS NOT NULL",
        id,
    )?);
    gone.objects.extend(strings(
        &format!("SELECT file FROM attachments JOIN runs ON run = runs.id WHERE {ITS_RUNS}"),
        id,
    )?);
    let runs = strings(&format!("SELECT name FROM runs WHERE {ITS_RUNS}"), id)?;
    change.execute(&format!("DELETE FROM runs WHERE {ITS_RUNS}"), [id])?;
    let slide: Option<i64> =
        change.query_row("SELECT slide FROM targets WHERE id = ?1", [id], |r| {
            r.get(0)
        })?;
    change.execute("DELETE FROM targets WHERE id = ?1", [id])?;
    // A slide's name may tell whose it is.
    change.execute(
        "DELETE FROM slides WHERE id = ?1 AND NOT EXISTS (SELECT 1 FROM targets WHERE slide = ?1)",
        [slide],
    )?;
    gone.runs.extend(runs.clone());
    Ok(Purged { name, runs })
}

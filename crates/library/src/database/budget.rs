//! Room for frames: those of the oldest runs go first, events and answers never.

use crate::LibraryError;
use crate::database::bin::Gone;
use crate::database::rows::within;
use crate::database::store::Database;
use crate::database::wrong::Done;
use rusqlite::Connection;

/// So much the frames of runs may take unless told otherwise, bytes.
pub const FRAMES_BYTES: u64 = 20_000_000_000;

const TAKEN: &str =
    "SELECT coalesce(sum(bytes), 0) FROM objects WHERE name IN (SELECT file FROM attachments)";

impl Database {
    /// How much the frames of runs take, reports included, bytes.
    ///
    /// # Errors
    /// Those of the database.
    pub fn frames_bytes(&self) -> Result<u64, LibraryError> {
        self.read(|c| Ok(c.query_row(TAKEN, [], |row| row.get::<_, i64>(0))? as u64))
    }

    /// Deletes the frames of the oldest runs until those that stay take no more than so many bytes. Runs that are pinned or under way, and the
    /// newest one, keep theirs. Returns the runs that lost them.
    ///
    /// # Errors
    /// Those of the database.
    pub fn keep_frames_within(&self, bytes: u64) -> Result<Vec<String>, LibraryError> {
        if self.frames_bytes()? <= bytes {
            return Ok(Vec::new());
        }
        self.sweep(|connection| {
            let oldest = oldest(connection)?;
            let mut lost = Vec::new();
            for (run, name) in oldest {
                let taken: i64 = connection.query_row(TAKEN, [], |row| row.get(0))?;
                if taken as u64 <= bytes {
                    break;
                }
                let mut gone = Gone::default();
                within(connection, |change| {
                    let mut files =
                        change.prepare("DELETE FROM attachments WHERE run = ?1 RETURNING file")?;
                    let files = files.query_map([run], |row| row.get(0))?;
                    gone.objects = files.collect::<Result<_, _>>()?;
                    Ok(())
                })?;
                self.delete_files(connection, &gone)?;
                lost.push(name);
            }
            Ok(lost)
        })
    }
}

/// The runs that may lose their frames.
fn oldest(connection: &Connection) -> Done<Vec<(i64, String)>> {
    let mut all = connection.prepare(
        "SELECT DISTINCT runs.id, runs.name FROM runs JOIN attachments ON run = runs.id
         WHERE pinned = 0 AND ended IS NOT NULL AND runs.id < (SELECT max(id) FROM runs) ORDER BY runs.id",
    )?;
    let all = all.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?;
    Ok(all.collect::<Result<_, _>>()?)
}

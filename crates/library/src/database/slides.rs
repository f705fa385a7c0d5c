//! The slides that views were saved on.

use crate::LibraryError;
use crate::database::store::Database;
use serde::Serialize;

/// A slide, and what was saved on it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SlideRow {
    /// Its name.
    pub name: String,
    /// What somebody noted of it.
    pub note: String,
    /// When it was first named, UTC.
    pub first_named: String,
    /// The targets on it.
    pub targets: usize,
}

impl Database {
    /// All slides, by name.
    ///
    /// # Errors
    /// Those of the database.
    pub fn slides(&self) -> Result<Vec<SlideRow>, LibraryError> {
        self.read(|c| {
            let mut all = c.prepare_cached(
                "SELECT name, note, first_named,
                    (SELECT count(*) FROM targets WHERE slide = slides.id AND binned IS NULL)
                 FROM slides ORDER BY name",
            )?;
            let rows = all.query_map([], |row| {
                Ok(SlideRow {
                    name: row.get(0)?,
                    note: row.get(1)?,
                    first_named: row.get(2)?,
                    targets: row.get::<_, i64>(3)? as usize,
                })
            })?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }
}

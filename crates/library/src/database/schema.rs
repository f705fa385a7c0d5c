//! The tables, and how the database of an earlier version becomes one of this: forwards only.

use crate::LibraryError;
use crate::database::wrong::{Done, Wrong};
use rusqlite::{Connection, TransactionBehavior};
use std::path::Path;

/// What each version added to the one before.
const MIGRATIONS: [&str; 2] = [include_str!("1.sql"), include_str!("2.sql")];

/// By what a file is known as one of ours: "SSLB".
const APPLICATION: i32 = 0x5353_4c42;

/// The version of this program's databases.
pub(crate) const VERSION: usize = MIGRATIONS.len();

fn number(connection: &Connection, pragma: &str) -> rusqlite::Result<i32> {
    connection.pragma_query_value(None, pragma, |row| row.get(0))
}

/// Makes a database that of this version; another program may be about it at the same time.
pub(crate) fn bring(connection: &mut Connection, path: &Path) -> Done<()> {
    let found = number(connection, "user_version")?;
    if found == VERSION as i32 && number(connection, "application_id")? == APPLICATION {
        return Ok(());
    }
    let change = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let found = number(&change, "user_version")?;
    let is_empty: bool =
        change.query_row("SELECT count(*) = 0 FROM sqlite_schema", [], |r| r.get(0))?;
    if !is_empty && number(&change, "application_id")? != APPLICATION {
        return Err(Wrong::Library(LibraryError::Read {
            path: path.into(),
            what: "it is a database of another program. Move it away, or name another data_folder"
                .into(),
        }));
    }
    let Some(missing) = usize::try_from(found)
        .ok()
        .and_then(|n| MIGRATIONS.get(n..))
    else {
        return Err(Wrong::Library(LibraryError::Newer {
            path: path.into(),
            version: found,
            known: VERSION,
        }));
    };
    for migration in missing {
        change.execute_batch(migration)?;
    }
    change.pragma_update(None, "application_id", APPLICATION)?;
    change.pragma_update(None, "user_version", VERSION as i32)?;
    Ok(change.commit()?)
}

//! A connection, and the rows that others refer to.

use crate::database::objects::Stored;
use crate::database::schema;
use crate::database::wrong::Done;
use crate::names::{check_slide, utc};
use rusqlite::{Connection, ErrorCode, OpenFlags, Transaction, TransactionBehavior, params};
use std::path::Path;
use std::thread;
use std::time::{Duration, SystemTime};

/// So long one program waits until another has written.
const BUSY: Duration = Duration::from_secs(10);
/// So often it is tried to have a new database written ahead, and so long between.
const TRIES: usize = 100;
const BETWEEN: Duration = Duration::from_millis(20);

/// How much a program's end, or the computer's, may cost of what was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Lasting {
    /// Nothing: it is on the disk before it is answered.
    Full,
    /// Nothing when a program is killed; the last moments when power fails.
    Program,
}

/// Opens a database, or makes it, and brings it to this version.
pub(crate) fn connect(file: &Path, lasting: Lasting) -> Done<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE
        | OpenFlags::SQLITE_OPEN_CREATE
        | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let mut connection = Connection::open_with_flags(file, flags)?;
    connection.busy_timeout(BUSY)?;
    write_ahead(&connection)?;
    connection.pragma_update(
        None,
        "synchronous",
        match lasting {
            Lasting::Full => "FULL",
            Lasting::Program => "NORMAL",
        },
    )?;
    connection.pragma_update(None, "foreign_keys", true)?;
    connection.pragma_update(None, "secure_delete", true)?;
    connection.pragma_update(None, "trusted_schema", false)?;
    schema::bring(&mut connection, file)?;
    Ok(connection)
}

/// Readers do not wait for who writes. Two programs that make one database at the same time do not wait for each other here by themselves.
fn write_ahead(connection: &Connection) -> Done<()> {
    let mode =
        |c: &Connection| c.pragma_query_value(None, "journal_mode", |row| row.get::<_, String>(0));
    for _ in 0..TRIES {
        let is_busy = match mode(connection) {
            Ok(mode) if mode == "wal" => return Ok(()),
            Ok(_) => match connection
                .pragma_update_and_check(None, "journal_mode", "wal", |row| row.get::<_, String>(0))
            {
                Ok(_) => false,
                Err(error) if error.sqlite_error_code() == Some(ErrorCode::DatabaseBusy) => true,
                Err(error) => return Err(error.into()),
            },
            Err(error) if error.sqlite_error_code() == Some(ErrorCode::DatabaseBusy) => true,
            Err(error) => return Err(error.into()),
        };
        if is_busy {
            thread::sleep(BETWEEN);
        }
    }
    // It works without, only slower.
    Ok(())
}

/// Does all of it or nothing.
pub(crate) fn within<T>(
    connection: &mut Connection,
    change: impl FnOnce(&Transaction) -> Done<T>,
) -> Done<T> {
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let done = change(&transaction)?;
    transaction.commit()?;
    Ok(done)
}

/// The row of an object.
pub(crate) fn row_of(transaction: &Transaction, object: &Stored) -> Done<()> {
    transaction
        .prepare_cached("INSERT OR IGNORE INTO objects (name, bytes) VALUES (?1, ?2)")?
        .execute(params![object.name, object.bytes as i64])?;
    Ok(())
}

/// The number of an instrument.
pub(crate) fn instrument(transaction: &Transaction, name: &str) -> Done<i64> {
    transaction
        .prepare_cached("INSERT OR IGNORE INTO instruments (name) VALUES (?1)")?
        .execute([name])?;
    Ok(
        transaction.query_row("SELECT id FROM instruments WHERE name = ?1", [name], |r| {
            r.get(0)
        })?,
    )
}

/// The number of a slide, which becomes known by that.
pub(crate) fn slide(transaction: &Transaction, name: &str) -> Done<i64> {
    check_slide(name)?;
    transaction
        .prepare_cached("INSERT OR IGNORE INTO slides (name, first_named) VALUES (?1, ?2)")?
        .execute([name, &utc(SystemTime::now())])?;
    Ok(
        transaction.query_row("SELECT id FROM slides WHERE name = ?1", [name], |r| {
            r.get(0)
        })?,
    )
}

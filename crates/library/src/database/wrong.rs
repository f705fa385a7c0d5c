//! What goes wrong inside, before it is known which file it was.

use crate::LibraryError;
use rusqlite::ErrorCode;
use std::io;
use std::path::Path;

/// What comes of something done in the database.
pub(crate) type Done<T> = Result<T, Wrong>;

/// Why nothing came of it.
pub(crate) enum Wrong {
    /// The database itself.
    Database(rusqlite::Error),
    /// Anything else.
    Library(LibraryError),
}

impl From<rusqlite::Error> for Wrong {
    fn from(error: rusqlite::Error) -> Self {
        Self::Database(error)
    }
}

impl From<LibraryError> for Wrong {
    fn from(error: LibraryError) -> Self {
        Self::Library(error)
    }
}

/// What the damage of a database is mended by.
const MEND: &str = "Bring back a backup (scopeservo library backup makes them), or move it away: the views themselves lie in objects beside it, and scopeservo library rebuild takes them in again";

impl Wrong {
    /// What a file at `path` could not be kept for.
    pub(crate) fn not_kept(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let lost = LibraryError::not_kept(path);
        move |error| Self::Library(lost(error))
    }

    /// The error, of a database at `path`.
    pub(crate) fn of(self, path: &Path) -> LibraryError {
        let error = match self {
            Self::Library(error) => return error,
            Self::Database(error) => error,
        };
        let what = error.to_string();
        let path = path.into();
        match error.sqlite_error_code() {
            Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => {
                LibraryError::Busy { path }
            }
            Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase) => LibraryError::Damaged {
                path,
                what: format!("{what}. {MEND}"),
            },
            Some(ErrorCode::DiskFull) => LibraryError::NotKept {
                path,
                what: "the disk is full".into(),
            },
            Some(ErrorCode::ReadOnly | ErrorCode::CannotOpen | ErrorCode::PermissionDenied) => {
                LibraryError::CannotWrite {
                    path,
                    source: io::Error::other(what),
                }
            }
            Some(ErrorCode::SystemIoFailure) => LibraryError::NotKept { path, what },
            _ => LibraryError::Read { path, what },
        }
    }
}

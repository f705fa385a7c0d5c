//! Whether anything could be kept, before something is done for it.

use crate::LibraryError;
use crate::database::drive;
use crate::database::store::Database;

impl Database {
    /// Refuses where a view and its run could not be kept: no room, no leave, a network drive, a database that cannot be opened.
    ///
    /// # Errors
    /// [`LibraryError::CannotWrite`], [`LibraryError::NetworkDrive`], those of opening the database.
    pub fn try_room(&self) -> Result<(), LibraryError> {
        if let Some(kind) = drive::network(self.path()) {
            return Err(LibraryError::NetworkDrive {
                path: self.path().into(),
                kind,
            });
        }
        self.folder().try_folder(self.objects().path())?;
        self.read(|c| Ok(c.query_row("SELECT 0", [], |row| row.get(0))?))
            .map(|_: i64| ())
    }
}

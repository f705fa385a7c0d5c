//! The database of a data folder, opened when it is first asked for something.

use crate::LibraryError;
use crate::database::objects::Objects;
use crate::database::rows::{Lasting, connect, within};
use crate::database::wrong::{Done, Wrong};
use crate::database::{drive, take_in};
use crate::files::make_folder;
use crate::folder::Folder;
use rusqlite::{Connection, Transaction};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The database's file in its folder.
const FILE: &str = "library.sqlite3";

/// A library in a database, with what is too large for it in files beside. Nothing is made on disk before something is kept. What files of
/// earlier versions lie in the folder is taken in when it is opened.
#[derive(Debug)]
pub struct Database {
    /// Journals stay files, and so is what earlier versions kept.
    files: Folder,
    objects: Objects,
    open: Mutex<Option<Connection>>,
    not_taken: Mutex<Vec<LibraryError>>,
}

impl Database {
    /// The library of a data folder, which need not be there yet.
    pub fn new(folder: PathBuf) -> Self {
        Self {
            objects: Objects::new(folder.join("objects")),
            files: Folder::new(folder),
            open: Mutex::default(),
            not_taken: Mutex::default(),
        }
    }

    /// The data folder.
    pub fn path(&self) -> &Path {
        self.files.path()
    }

    /// The database's file.
    pub fn file(&self) -> PathBuf {
        self.path().join(FILE)
    }

    /// Takes in what files of earlier versions lie in the folder; `progress` hears how many of how many are done. Nothing to do, mostly. Returns
    /// what could not be taken in, which stays where it is.
    ///
    /// # Errors
    /// Those of opening the database.
    pub fn take_in(
        &self,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Vec<LibraryError>, LibraryError> {
        if take_in::waits(&self.files) || self.file().exists() {
            drop(self.opened(progress)?);
        }
        let mut told = self
            .not_taken
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        Ok(std::mem::take(&mut *told))
    }

    /// How long a program waits here until another has written; some seconds unless told.
    ///
    /// # Errors
    /// Those of opening the database.
    pub fn set_patience(&self, patience: Duration) -> Result<(), LibraryError> {
        let open = self.opened(&mut |_, _| {})?;
        let connection = open.as_ref().ok_or_else(|| self.nowhere())?;
        let set = connection.busy_timeout(patience);
        set.map_err(|e| Wrong::from(e).of(&self.file()))
    }

    pub(crate) fn folder(&self) -> &Folder {
        &self.files
    }

    pub(crate) fn objects(&self) -> &Objects {
        &self.objects
    }

    /// Asks something; the default where nothing was ever kept.
    pub(crate) fn read<T: Default>(
        &self,
        ask: impl FnOnce(&Connection) -> Done<T>,
    ) -> Result<T, LibraryError> {
        if !self.file().exists() && !take_in::waits(&self.files) {
            return Ok(T::default());
        }
        let open = self.opened(&mut |_, _| {})?;
        match &*open {
            Some(connection) => ask(connection).map_err(|wrong| wrong.of(&self.file())),
            None => Ok(T::default()),
        }
    }

    /// Changes something, all or nothing of it. Nothing is swept meanwhile.
    pub(crate) fn write<T>(
        &self,
        change: impl FnOnce(&Transaction) -> Done<T>,
    ) -> Result<T, LibraryError> {
        let mut open = self.opened(&mut |_, _| {})?;
        let _held = self.objects.hold()?;
        let connection = open.as_mut().ok_or_else(|| self.nowhere())?;
        within(connection, change).map_err(|wrong| wrong.of(&self.file()))
    }

    /// The same with nobody else at the objects.
    pub(crate) fn sweep<T>(
        &self,
        change: impl FnOnce(&mut Connection) -> Done<T>,
    ) -> Result<T, LibraryError> {
        let mut open = self.opened(&mut |_, _| {})?;
        let _alone = self.objects.hold_alone()?;
        let connection = open.as_mut().ok_or_else(|| self.nowhere())?;
        change(connection).map_err(|wrong| wrong.of(&self.file()))
    }

    fn nowhere(&self) -> LibraryError {
        LibraryError::Read {
            path: self.file(),
            what: "it is not open".into(),
        }
    }

    fn opened(
        &self,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<MutexGuard<'_, Option<Connection>>, LibraryError> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if open.is_none() {
            let mut connection = self.connect(Lasting::Full)?;
            if take_in::waits(&self.files) {
                let not_taken = take_in::all(&mut connection, &self.files, &self.objects, progress)
                    .map_err(|wrong| wrong.of(&self.file()))?;
                let mut told = self
                    .not_taken
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner);
                told.extend(not_taken);
            }
            *open = Some(connection);
        }
        Ok(open)
    }

    /// A connection of its own.
    pub(crate) fn connect(&self, lasting: Lasting) -> Result<Connection, LibraryError> {
        if let Some(kind) = drive::network(self.path()) {
            return Err(LibraryError::NetworkDrive {
                path: self.path().into(),
                kind,
            });
        }
        make_folder(self.path()).map_err(|source| LibraryError::CannotWrite {
            path: self.path().into(),
            source,
        })?;
        let file = self.file();
        connect(&file, lasting).map_err(|wrong| match wrong.of(&file) {
            // Nothing was done yet that could be lost.
            LibraryError::NotKept { path, what } => LibraryError::CannotWrite {
                path,
                source: std::io::Error::other(what),
            },
            error => error,
        })
    }
}

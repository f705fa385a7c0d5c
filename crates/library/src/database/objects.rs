//! What is too large for a row, or is a person's to copy: files that are called by the checksum of what they hold, each kept once.
//!
//! A file comes first and its row after, so that no row is without its file. Whoever writes holds the folder together with others until the
//! row is there; whoever sweeps holds it alone.

use crate::LibraryError;
use crate::files::{self, checksum, make_folder};
use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// No object is larger, bytes.
pub(crate) const LARGEST: u64 = 1 << 30;

/// The folder.
#[derive(Debug, Clone)]
pub(crate) struct Objects {
    folder: PathBuf,
}

/// The name of an object and how large it is.
#[derive(Debug, Clone)]
pub(crate) struct Stored {
    pub(crate) name: String,
    pub(crate) bytes: u64,
}

impl Objects {
    pub(crate) fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    pub(crate) fn path(&self) -> &Path {
        &self.folder
    }

    /// Where an object lies, or would.
    pub(crate) fn place(&self, name: &str) -> PathBuf {
        self.folder.join(name.get(..2).unwrap_or("")).join(name)
    }

    /// Nothing is swept while this lives. `None` where the file system knows no locks.
    pub(crate) fn hold(&self) -> Result<Option<File>, LibraryError> {
        Ok(self
            .lock_file()?
            .and_then(|f| f.lock_shared().ok().map(|()| f)))
    }

    /// Nobody writes while this lives.
    pub(crate) fn hold_alone(&self) -> Result<Option<File>, LibraryError> {
        Ok(self.lock_file()?.and_then(|f| f.lock().ok().map(|()| f)))
    }

    fn lock_file(&self) -> Result<Option<File>, LibraryError> {
        make_folder(&self.folder).map_err(LibraryError::not_kept(&self.folder))?;
        Ok(File::create(self.folder.join(".lock")).ok())
    }

    /// Keeps what may be kept already. Its row is to follow while the folder is held.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    pub(crate) fn put(&self, bytes: &[u8], ending: &str) -> Result<Stored, LibraryError> {
        let name = format!("{}.{ending}", checksum(bytes));
        let place = self.place(&name);
        let stored = Stored {
            name,
            bytes: bytes.len() as u64,
        };
        // One that is there may have been damaged since.
        if fs::read(&place).is_ok_and(|there| there == bytes) {
            return Ok(stored);
        }
        let folder = place.parent().unwrap_or(&self.folder);
        make_folder(folder).map_err(LibraryError::not_kept(folder))?;
        files::replace(&place, bytes).map_err(LibraryError::not_kept(&place))?;
        Ok(stored)
    }

    /// What an object holds.
    ///
    /// # Errors
    /// [`LibraryError::Read`], [`LibraryError::Damaged`] where it is not what was kept.
    pub(crate) fn get(&self, name: &str) -> Result<Vec<u8>, LibraryError> {
        let place = self.place(name);
        let bytes = scopeservo_files::read(&place, LARGEST).map_err(LibraryError::read(&place))?;
        match name.split('.').next() == Some(checksum(&bytes).as_str()) {
            true => Ok(bytes),
            false => Err(LibraryError::Damaged {
                path: place,
                what: "it is not what was kept. Bring it back from a backup, or make it again"
                    .into(),
            }),
        }
    }

    /// Whether it is there, or something of its name.
    pub(crate) fn has(&self, name: &str) -> bool {
        files::is_there(&self.place(name))
    }

    /// Removes an object that no row names. One that cannot be removed is litter.
    pub(crate) fn remove(&self, name: &str) {
        let _ = fs::remove_file(self.place(name));
    }

    /// All files that lie there, in order.
    ///
    /// # Errors
    /// [`LibraryError::Read`].
    pub(crate) fn all(&self) -> Result<Vec<PathBuf>, LibraryError> {
        let mut all = Vec::new();
        let list = |folder: &Path| match fs::read_dir(folder) {
            Err(e) if e.kind() == ErrorKind::NotFound => Ok(Vec::new()),
            listing => listing
                .and_then(Iterator::collect::<Result<Vec<_>, _>>)
                .map_err(LibraryError::read(folder)),
        };
        for folder in list(&self.folder)? {
            if !folder.path().is_dir() {
                continue;
            }
            for object in list(&folder.path())? {
                all.push(object.path());
            }
        }
        all.sort();
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_object_is_kept_once_and_what_was_damaged_is_noticed_and_mended_by_keeping_it_again() {
        let dir = tempfile::tempdir().unwrap();
        let objects = Objects::new(dir.path().join("objects"));
        assert!(objects.all().unwrap().is_empty());
        let first = objects.put(b"a view", "target").unwrap();
        let again = objects.put(b"a view", "target").unwrap();
        assert_eq!(first.name, again.name);
        assert_eq!(first.bytes, 6);
        assert_eq!(objects.all().unwrap(), [objects.place(&first.name)]);
        assert_eq!(objects.get(&first.name).unwrap(), b"a view");
        for damage in [&b"a vieW"[..], b"", b"a view "] {
            fs::write(objects.place(&first.name), damage).unwrap();
            let said = objects.get(&first.name).unwrap_err();
            assert!(matches!(said, LibraryError::Damaged { .. }), "{said}");
        }
        objects.put(b"a view", "target").unwrap();
        assert_eq!(objects.get(&first.name).unwrap(), b"a view");
        objects.remove(&first.name);
        assert!(!objects.has(&first.name));
        assert!(matches!(
            objects.get(&first.name),
            Err(LibraryError::Read { .. })
        ));
    }
}

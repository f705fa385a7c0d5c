//! What a run goes to stays what it is until the run has ended, whichever program does it.
//!
//! A run under way holds a lock of the system on a file of its own, which is gone with its program. One whose program was killed is in the
//! journal of its instrument, until somebody goes on with it or ends it. Files are made, looked at and swept while the database is written
//! to, so that no two programs do so at once.

use crate::LibraryError;
use crate::database::wrong::Done;
use crate::error::Use;
use crate::files::make_folder;
use crate::folder::Folder;
use rusqlite::{Connection, params};
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};

/// A run under way, until it is let go.
#[derive(Debug)]
pub(crate) struct UnderWay {
    path: PathBuf,
    _file: File,
}

fn folder_of(library: &Path) -> PathBuf {
    library.join("under-way")
}

impl UnderWay {
    /// The run of that name begins. `None` where the file system knows no locks: then its journal has to do.
    pub(crate) fn begin(library: &Path, run: &str) -> Option<Self> {
        let folder = folder_of(library);
        make_folder(&folder).ok()?;
        sweep(&folder);
        let path = folder.join(run);
        let file = File::create(&path).ok()?;
        file.try_lock().ok()?;
        Some(Self { path, _file: file })
    }
}

impl Drop for UnderWay {
    fn drop(&mut self) {
        // One that stays is swept when the next run begins.
        let _ = fs::remove_file(&self.path);
    }
}

fn is_held(path: &Path) -> bool {
    let file = File::open(path);
    file.is_ok_and(|file| matches!(file.try_lock(), Err(TryLockError::WouldBlock)))
}

/// Removes what killed programs left.
fn sweep(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        if !is_held(&entry.path()) {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Whether nobody needs a target as it is.
///
/// # Errors
/// [`LibraryError::InUse`].
pub(crate) fn is_free(change: &Connection, library: &Folder, target: i64) -> Done<()> {
    let (name, content): (String, String) = change.query_row(
        "SELECT name, content FROM targets WHERE id = ?1",
        [target],
        |row| Ok((row.get(0)?, row.get(1)?)),
    )?;
    let mut begun = change.prepare_cached(
        "SELECT name FROM runs WHERE ended IS NULL AND (target = ?1 OR (target IS NULL AND target_name = ?2))",
    )?;
    let begun = begun.query_map(params![target, name], |row| row.get::<_, String>(0))?;
    let folder = folder_of(library.path());
    for run in begun {
        if is_held(&folder.join(run?)) {
            let by = Use::Run;
            return Err(LibraryError::InUse { name, by }.into());
        }
    }
    // One that cannot be read is gone on with by nobody.
    let is_its = |of: &[String; 2]| *of == [name.clone(), content.clone()];
    match library.journalled_targets().iter().any(is_its) {
        true => {
            let by = Use::Left;
            Err(LibraryError::InUse { name, by }.into())
        }
        false => Ok(()),
    }
}

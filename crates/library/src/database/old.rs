//! Where files of earlier versions go when they are in the database.

use crate::LibraryError;
use crate::database::wrong::{Done, Wrong};
use crate::files::make_folder;
use crate::folder::Folder;
use crate::targets::LABEL;
use rusqlite::Connection;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// They are kept here, as they were.
const BEFORE: &str = "before-database";

fn aside(folder: &Folder, path: &str) -> PathBuf {
    folder.path().join(BEFORE).join(path)
}

/// Puts a file or a folder aside, whatever lies there of the same name.
pub(crate) fn put_aside(folder: &Folder, path: &str) -> Result<(), LibraryError> {
    let from = folder.path().join(path);
    let to = aside(folder, path);
    if let Some(parent) = to.parent() {
        make_folder(parent).map_err(LibraryError::not_kept(parent))?;
    }
    remove(&to).map_err(LibraryError::not_kept(&to))?;
    match fs::rename(&from, &to) {
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(()),
        done => done.map_err(LibraryError::not_kept(&to)),
    }
}

/// Deletes what became these objects or runs.
pub(crate) fn delete<'a>(
    connection: &Connection,
    folder: &Folder,
    became: impl Iterator<Item = &'a String>,
) -> Done<()> {
    for became in became {
        let mut paths = connection.prepare_cached("SELECT path FROM taken_in WHERE became = ?1")?;
        let paths: Vec<String> = paths
            .query_map([became], |row| row.get(0))?
            .collect::<Result<_, _>>()?;
        for path in paths {
            let aside = aside(folder, &path);
            remove(&aside).map_err(Wrong::not_kept(&aside))?;
            if path.starts_with("targets/") {
                for beside in ["png", LABEL].map(|ending| aside.with_extension(ending)) {
                    remove(&beside).map_err(Wrong::not_kept(&beside))?;
                }
            }
            connection.execute("DELETE FROM taken_in WHERE path = ?1", [path])?;
        }
    }
    Ok(())
}

fn remove(path: &Path) -> std::io::Result<()> {
    let removed = match path.is_dir() {
        true => fs::remove_dir_all(path),
        false => fs::remove_file(path),
    };
    match removed {
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(()),
        removed => removed,
    }
}

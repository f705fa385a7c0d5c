//! The whole library as one file: a tar archive of the database as it is at one moment, and of the files beside it.

use crate::LibraryError;
use crate::database::objects::Objects;
use crate::database::store::Database;
use crate::files::{checksum, is_there, make_folder};
use rusqlite::Connection;
use serde::Serialize;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

/// What the database is called in the archive.
const DATABASE: &str = "library.sqlite3";
/// The folder of the files beside.
const OBJECTS: &str = "objects";

/// What is in a backup.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct BackedUp {
    /// Files beside the database.
    pub objects: usize,
    /// All together.
    pub bytes: u64,
    /// What could not be put in, as it is gone or damaged.
    pub missing: Vec<String>,
}

impl Database {
    /// Writes everything into one file, never over another. Others may go on writing meanwhile: it holds what was there when it began.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`], those of the database.
    pub fn back_up(
        &self,
        to: &Path,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<BackedUp, LibraryError> {
        let not_kept = |e: io::Error| LibraryError::not_kept(to)(e);
        if is_there(to) {
            return Err(not_kept(io::Error::other(
                "there is a file of that name already",
            )));
        }
        let folder = match to.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        let work = tempfile::Builder::new()
            .prefix(".scopeservo-backup-")
            .tempdir_in(folder);
        let work = work.map_err(not_kept)?;
        let copy = work.path().join(DATABASE);
        // Nothing that the copy names is swept until it is in the archive. Held while the database is: whoever sweeps takes both in that order.
        let (_held, objects) = self.read(|c| {
            let held = self.objects().hold()?;
            c.execute("VACUUM INTO ?1", [copy.to_string_lossy()])?;
            let copy = Connection::open(&copy)?;
            let mut names = copy.prepare("SELECT name FROM objects ORDER BY name")?;
            let names = names.query_map([], |row| row.get(0))?;
            Ok((held, names.collect::<Result<Vec<String>, _>>()?))
        })?;
        let file = tempfile::Builder::new()
            .prefix(".scopeservo-backup-")
            .tempfile_in(folder);
        let mut archive = tar::Builder::new(io::BufWriter::new(file.map_err(not_kept)?));
        let mut done = BackedUp::default();
        if copy.exists() {
            archive
                .append_path_with_name(&copy, DATABASE)
                .map_err(not_kept)?;
        }
        for (k, name) in objects.iter().enumerate() {
            progress(k, objects.len());
            match self.objects().get(name) {
                Err(error) => done.missing.push(error.to_string()),
                Ok(bytes) => {
                    let mut header = tar::Header::new_ustar();
                    header.set_size(bytes.len() as u64);
                    header.set_mode(0o644);
                    let place = format!("{OBJECTS}/{}/{name}", &name[..2]);
                    archive
                        .append_data(&mut header, place, bytes.as_slice())
                        .map_err(not_kept)?;
                    done.objects += 1;
                }
            }
        }
        progress(objects.len(), objects.len());
        let file = archive.into_inner().map_err(not_kept)?;
        let file = file.into_inner().map_err(|e| not_kept(e.into_error()))?;
        file.as_file().sync_all().map_err(not_kept)?;
        done.bytes = file.as_file().metadata().map_err(not_kept)?.len();
        file.persist_noclobber(to).map_err(|e| not_kept(e.error))?;
        Ok(done)
    }
}

/// Unpacks a backup into a data folder that has no library yet. Returns how many files lie beside the database.
///
/// # Errors
/// [`LibraryError::NotKept`] where there is one already; [`LibraryError::Damaged`] where the archive is none of ours, or a file in it is not
/// what its name says: then nothing is there.
pub fn restore(from: &Path, folder: &Path) -> Result<usize, LibraryError> {
    let not_kept = |e: io::Error| LibraryError::not_kept(folder)(e);
    let database = folder.join(DATABASE);
    if is_there(&database) {
        return Err(LibraryError::NotKept {
            path: folder.into(),
            what: "there is a library already; name a data_folder that has none, or move that one away".into(),
        });
    }
    make_folder(folder).map_err(not_kept)?;
    let objects = Objects::new(folder.join(OBJECTS));
    let work = tempfile::Builder::new()
        .prefix(".scopeservo-restore-")
        .tempdir_in(folder);
    let work = work.map_err(not_kept)?;
    let bad = |what: &str| LibraryError::damaged(from, what);
    let mut archive = tar::Archive::new(io::BufReader::new(
        File::open(from).map_err(LibraryError::read(from))?,
    ));
    let mut count = 0;
    for entry in archive.entries().map_err(LibraryError::read(from))? {
        let mut entry = entry.map_err(|e| bad(&e.to_string()))?;
        let name = entry
            .path()
            .map_err(|e| bad(&e.to_string()))?
            .to_string_lossy()
            .into_owned();
        let mut bytes = Vec::new();
        match name.as_str() {
            DATABASE => {
                let mut file = File::create(work.path().join(DATABASE)).map_err(not_kept)?;
                io::copy(&mut entry, &mut file).map_err(not_kept)?;
                file.sync_all().map_err(not_kept)?;
            }
            _ => {
                entry
                    .read_to_end(&mut bytes)
                    .map_err(|e| bad(&e.to_string()))?;
                let (sum, ending) = name
                    .rsplit('/')
                    .next()
                    .and_then(|n| n.split_once('.'))
                    .unwrap_or_default();
                let is_its = name.starts_with("objects/") && sum == checksum(&bytes);
                if !is_its || !ending.chars().all(|c| c.is_ascii_alphanumeric()) {
                    return Err(bad(&format!("{name} is not what it was")));
                }
                objects.put(&bytes, ending)?;
                count += 1;
            }
        }
    }
    let copy = work.path().join(DATABASE);
    if !copy.exists() {
        return Err(bad("there is no library in it"));
    }
    fs::rename(&copy, &database).map_err(not_kept)?;
    Ok(count)
}

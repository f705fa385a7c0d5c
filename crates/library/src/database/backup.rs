//! The whole library as one file: a tar archive of the database as it is at one moment, and of the files beside it.

use crate::LibraryError;
use crate::database::archive::{DATABASE, SUMS, Summed, Sums, place, to_text};
use crate::database::store::Database;
use crate::files::is_there;
use rusqlite::Connection;
use serde::Serialize;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

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
        let mut archive = Archive::new(io::BufWriter::new(file.map_err(not_kept)?));
        let mut done = BackedUp::default();
        if copy.exists() {
            let file = File::open(&copy).map_err(not_kept)?;
            let length = file.metadata().map_err(not_kept)?.len();
            archive.add(DATABASE, length, file).map_err(not_kept)?;
        }
        for (k, name) in objects.iter().enumerate() {
            progress(k, objects.len());
            match self.objects().get(name) {
                Err(error) => done.missing.push(error.to_string()),
                Ok(bytes) => {
                    let length = bytes.len() as u64;
                    archive
                        .add(&place(name), length, bytes.as_slice())
                        .map_err(not_kept)?;
                    done.objects += 1;
                }
            }
        }
        progress(objects.len(), objects.len());
        let file = archive.end().map_err(not_kept)?;
        let file = file.into_inner().map_err(|e| not_kept(e.into_error()))?;
        file.as_file().sync_all().map_err(not_kept)?;
        done.bytes = file.as_file().metadata().map_err(not_kept)?.len();
        file.persist_noclobber(to).map_err(|e| not_kept(e.error))?;
        Ok(done)
    }
}

/// An archive that is written.
struct Archive<W: Write> {
    tar: tar::Builder<W>,
    sums: Sums,
}

impl<W: Write> Archive<W> {
    fn new(to: W) -> Self {
        Self {
            tar: tar::Builder::new(to),
            sums: Sums::new(),
        }
    }

    fn add(&mut self, name: &str, length: u64, from: impl Read) -> io::Result<()> {
        let mut header = tar::Header::new_ustar();
        header.set_size(length);
        header.set_mode(0o644);
        let mut from = Summed::new(from);
        self.tar.append_data(&mut header, name, &mut from)?;
        let (sum, read) = from.end();
        if read != length {
            return Err(io::Error::other(format!("{name} changed meanwhile")));
        }
        self.sums.insert(name.into(), sum);
        Ok(())
    }

    /// The sums of all that is in it come last.
    fn end(mut self) -> io::Result<W> {
        let text = to_text(&self.sums);
        self.add(SUMS, text.len() as u64, text.as_bytes())?;
        self.tar.into_inner()
    }
}

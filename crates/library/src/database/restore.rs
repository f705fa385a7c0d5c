//! A backup brought back: all of it is read and held to its sums before anything is put in place.

use crate::LibraryError;
use crate::database::archive::{DATABASE, OBJECTS, SUMS, Summed, Sums, from_text, object};
use crate::database::objects::{LARGEST, Objects};
use crate::files::{is_there, make_folder, sync};
use rusqlite::{Connection, OpenFlags};
use serde::Serialize;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;
use tar::EntryType;

/// The sums of a library are no longer, bytes: those of two million files.
const LARGEST_SUMS: u64 = 512 << 20;

/// What was brought back.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Restored {
    /// Files that lie beside the database.
    pub objects: usize,
    /// Files that the database names and the archive does not have: they were gone when it was written.
    pub missing: Vec<String>,
    /// Whether the archive told the sums of what is in it; without nobody knows whether all of it is there.
    pub summed: bool,
}

/// Unpacks a backup into a data folder that has no library yet.
///
/// # Errors
/// [`LibraryError::NotKept`] where there is one already; [`LibraryError::NoSums`] where the archive does not tell the sums of what is in it,
/// unless it may do `without_sums`; [`LibraryError::Damaged`] where it is none of ours, ends early, or something in it is not what it was. Then
/// nothing is put in place.
pub fn restore(from: &Path, folder: &Path, without_sums: bool) -> Result<Restored, LibraryError> {
    let not_kept = |e: io::Error| LibraryError::not_kept(folder)(e);
    let database = folder.join(DATABASE);
    // What another database has written ahead would be taken for this one's.
    let parts = ["", "-wal", "-shm", "-journal"];
    if let Some(part) = parts
        .map(|part| folder.join(format!("{DATABASE}{part}")))
        .into_iter()
        .find(|part| is_there(part))
    {
        return Err(LibraryError::NotKept {
            path: part,
            what: "there is a library already; name a data_folder that has none, or move that file away"
                .into(),
        });
    }
    make_folder(folder).map_err(not_kept)?;
    let work = tempfile::Builder::new()
        .prefix(".scopeservo-restore-")
        .tempdir_in(folder);
    let work = work.map_err(not_kept)?;
    let unpacked = Unpacked::read(from, work.path())?;
    let summed = match &unpacked.told {
        Some(told) => unpacked.agrees(from, told).map(|()| true)?,
        None if without_sums => false,
        None => return Err(LibraryError::NoSums { path: from.into() }),
    };
    let copy = work.path().join(DATABASE);
    let named = named(&copy)
        .map_err(|e| LibraryError::damaged(from, format!("its database cannot be read: {e}")))?;
    let has = |name: &String| {
        unpacked
            .found
            .contains_key(&crate::database::archive::place(name))
    };
    let missing = named.into_iter().filter(|name| !has(name)).collect();
    let objects = put(work.path(), folder).map_err(not_kept)?;
    fs::rename(&copy, &database).map_err(not_kept)?;
    sync(folder);
    Ok(Restored {
        objects,
        missing,
        summed,
    })
}

/// An archive in a folder of its own.
struct Unpacked {
    found: Sums,
    /// What its last member tells.
    told: Option<Sums>,
}

impl Unpacked {
    /// Reads it to its end, each member within a bound.
    fn read(from: &Path, work: &Path) -> Result<Self, LibraryError> {
        let bad = |what: String| LibraryError::damaged(from, what);
        let file = File::open(from).map_err(LibraryError::read(from))?;
        let length = file.metadata().map_err(LibraryError::read(from))?.len();
        let mut archive = tar::Archive::new(io::BufReader::new(file));
        let mut unpacked = Self {
            found: Sums::new(),
            told: None,
        };
        // As they are: names and sizes that other members tell of, and holes, are none of ours.
        let entries = archive
            .entries()
            .map_err(LibraryError::read(from))?
            .raw(true);
        for entry in entries {
            let mut entry =
                entry.map_err(|e| bad(format!("it ends early, or is no archive: {e}")))?;
            let name = String::from_utf8(entry.path_bytes().into_owned());
            let name = name.map_err(|_| bad("it holds a file with a name that is none".into()))?;
            let size = entry.size();
            if unpacked.told.is_some() {
                return Err(bad(format!("{name} comes after its end")));
            }
            let most = match name.as_str() {
                DATABASE => u64::MAX,
                SUMS => LARGEST_SUMS,
                _ => LARGEST,
            };
            if size > most.min(length) {
                return Err(bad(format!("{name} is said to have {size} bytes")));
            }
            if entry.header().entry_type() != EntryType::Regular {
                return Err(bad(format!("{name} is no plain file")));
            }
            unpacked.member(&mut entry, (&name, size), work, &bad)?;
        }
        match unpacked.found.contains_key(DATABASE) {
            true => Ok(unpacked),
            false => Err(bad("there is no library in it".into())),
        }
    }

    fn member(
        &mut self,
        entry: &mut impl Read,
        (name, size): (&str, u64),
        work: &Path,
        bad: &impl Fn(String) -> LibraryError,
    ) -> Result<(), LibraryError> {
        let early = || bad(format!("it ends early, in {name}"));
        let not_kept = |e: io::Error| LibraryError::not_kept(work)(e);
        if name == SUMS {
            let mut text = Vec::new();
            let read = entry.take(size).read_to_end(&mut text);
            if read.ok() != Some(size as usize) {
                return Err(early());
            }
            let told = from_text(&text);
            self.told = Some(told.ok_or_else(|| bad(format!("{SUMS} tells no sums")))?);
            return Ok(());
        }
        let (place, sum) = match (name, object(name)) {
            (DATABASE, _) => (work.join(DATABASE), None),
            (_, Some((object, sum))) => (Objects::new(work.join(OBJECTS)).place(object), Some(sum)),
            _ => return Err(bad(format!("{name} is nothing of a library"))),
        };
        if let Some(folder) = place.parent() {
            fs::create_dir_all(folder).map_err(not_kept)?;
        }
        let mut file = File::create_new(&place).map_err(|e| match e.kind() {
            io::ErrorKind::AlreadyExists => bad(format!("{name} is in it twice")),
            _ => not_kept(e),
        })?;
        let mut summed = Summed::new(entry.take(size));
        io::copy(&mut summed, &mut file).map_err(not_kept)?;
        let (is, bytes) = summed.end();
        if bytes != size {
            return Err(early());
        }
        if sum.is_some_and(|sum| sum != is) {
            return Err(bad(format!("{name} is not what it was")));
        }
        file.sync_all().map_err(not_kept)?;
        self.found.insert(name.into(), is);
        Ok(())
    }

    /// Whether it is what its last member tells.
    fn agrees(&self, from: &Path, told: &Sums) -> Result<(), LibraryError> {
        let bad = |what: String| Err(LibraryError::damaged(from, what));
        let odd = |(name, sum): &(&String, &String), other: &Sums| other.get(*name) != Some(*sum);
        if let Some((name, _)) = told.iter().find(|one| odd(one, &self.found)) {
            return bad(match self.found.contains_key(name) {
                true => format!("{name} is not what it was"),
                false => format!("{name} is not in it"),
            });
        }
        match self.found.iter().find(|one| odd(one, told)) {
            Some((name, _)) => bad(format!("{name} does not belong to it")),
            None => Ok(()),
        }
    }
}

/// The files that a database names.
fn named(database: &Path) -> rusqlite::Result<Vec<String>> {
    let connection = Connection::open_with_flags(database, OpenFlags::SQLITE_OPEN_READ_ONLY)?;
    let mut names = connection.prepare("SELECT name FROM objects ORDER BY name")?;
    let names = names.query_map([], |row| row.get(0))?;
    names.collect()
}

/// Puts the files beside in place, whatever lies there of the same name. Returns how many.
fn put(work: &Path, folder: &Path) -> io::Result<usize> {
    let objects = Objects::new(folder.join(OBJECTS));
    let all = Objects::new(work.join(OBJECTS)).all();
    let all = all.map_err(io::Error::other)?;
    for from in &all {
        let name = from.file_name().unwrap_or_default().to_string_lossy();
        let to = objects.place(&name);
        let inside = to.parent().unwrap_or(folder);
        make_folder(inside)?;
        fs::rename(from, &to)?;
    }
    for inside in fs::read_dir(objects.path()).into_iter().flatten().flatten() {
        sync(&inside.path());
    }
    Ok(all.len())
}

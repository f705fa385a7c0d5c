//! Files that are there whole or not at all, whoever is killed and whenever the power fails.
//!
//! A file is written beside its place under a temporary name, locked while somebody works at it, reaches the disk, and only then gets
//! its name; then its folder reaches the disk too. What killed programs left is swept when the next file is written there.

use sha2::{Digest, Sha256};
use std::fs::{self, File, Metadata};
use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::time::{Duration, SystemTime};
use tempfile::NamedTempFile;

/// What temporary files begin with; [`RANDOM`] letters and digits follow.
const PREFIX: &str = ".scopeservo-";
const RANDOM: usize = 6;
/// A temporary file is younger than this, or is locked, while somebody works at it.
const ABANDONED: Duration = Duration::from_secs(60);
/// For whoever may read the folder, as other files are; and for its owner alone.
const USUAL: u32 = 0o666;
const PRIVATE: u32 = 0o600;
/// What a trial writes: as much as a view and its run take.
static TRIAL: [u8; 4 << 20] = [0; 4 << 20];

/// Writes a file, and never over another: `false` when there is one of that name.
///
/// # Errors
/// What the system says.
pub fn write_new(path: &Path, bytes: &[u8]) -> io::Result<bool> {
    let taken = match beside(path, bytes)?.persist_noclobber(path) {
        Ok(_) => false,
        Err(e) if e.error.kind() == ErrorKind::AlreadyExists => true,
        Err(e) => return Err(e.error),
    };
    sync(folder_of(path));
    Ok(!taken)
}

/// Writes a file in place of the one that may be there.
///
/// # Errors
/// What the system says.
pub fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    beside(path, bytes)?.persist(path).map_err(|e| e.error)?;
    sync(folder_of(path));
    Ok(())
}

/// Like [`replace`], and nobody but its owner can read it, from the first moment on: secrets.
///
/// # Errors
/// What the system says.
pub fn replace_private(path: &Path, bytes: &[u8]) -> io::Result<()> {
    sweep(folder_of(path));
    let file = temporary(folder_of(path), bytes, PRIVATE)?;
    file.persist(path).map_err(|e| e.error)?;
    sync(folder_of(path));
    Ok(())
}

/// Like [`replace`], where losing this file to a power cut while the one before stays does no harm: its folder is left to the system.
///
/// # Errors
/// What the system says.
pub fn renew(path: &Path, bytes: &[u8]) -> io::Result<()> {
    temporary(folder_of(path), bytes, USUAL)?
        .persist(path)
        .map_err(|e| e.error)?;
    Ok(())
}

/// Makes a folder that lasts.
///
/// # Errors
/// What the system says.
pub fn make_folder(folder: &Path) -> io::Result<()> {
    let new: Vec<&Path> = folder.ancestors().take_while(|f| !is_there(f)).collect();
    fs::create_dir_all(folder)?;
    new.into_iter().for_each(|made| sync(folder_of(made)));
    Ok(())
}

/// Whether files can be written into a folder, or, where it is yet to be made, into the one that it will lie in. Nothing stays.
///
/// # Errors
/// What the system says.
pub fn try_folder(folder: &Path) -> io::Result<()> {
    let nearest = folder.ancestors().find(|f| is_there(f));
    // It need not reach the disk: a full one says so before.
    begun(nearest.unwrap_or(Path::new(".")), &TRIAL, USUAL).map(drop)
}

/// Keeps other programs away from a folder for as long as the answer lives. `None` where the file system knows no locks.
pub fn lock(folder: &Path) -> Option<File> {
    let file = File::create(folder.join(".lock")).ok()?;
    file.lock().ok().map(|()| file)
}

/// The SHA-256 of a file's bytes, as `sha256sum` writes it.
pub(crate) fn checksum(bytes: &[u8]) -> String {
    let digest = Sha256::digest(bytes);
    digest.iter().map(|b| format!("{b:02x}")).collect()
}

/// A link that leads nowhere is there too: nothing can be made under its name.
pub(crate) fn is_there(path: &Path) -> bool {
    path.symlink_metadata().is_ok()
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// What will be `path`, on the disk under another name.
fn beside(path: &Path, bytes: &[u8]) -> io::Result<NamedTempFile> {
    sweep(folder_of(path));
    temporary(folder_of(path), bytes, USUAL)
}

fn temporary(folder: &Path, bytes: &[u8], mode: u32) -> io::Result<NamedTempFile> {
    let file = begun(folder, bytes, mode)?;
    file.as_file().sync_all()?;
    Ok(file)
}

/// A file under another name, locked.
fn begun(folder: &Path, bytes: &[u8], mode: u32) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).rand_bytes(RANDOM);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        builder.permissions(fs::Permissions::from_mode(mode));
    }
    #[cfg(not(unix))]
    let _ = mode;
    // What the temporary file would have been called tells nobody anything.
    let mut file = builder
        .tempfile_in(folder)
        .map_err(|e| io::Error::from(e.kind()))?;
    // Where there are no locks its age has to do.
    let _ = file.as_file().lock();
    file.as_file_mut().write_all(bytes)?;
    Ok(file)
}

/// Removes what killed programs left.
fn sweep(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        if entry.file_name().to_str().is_some_and(is_temporary) && is_abandoned(&entry.path()) {
            // Whoever cannot remove it can still write beside it.
            let _ = fs::remove_file(entry.path());
        }
    }
}

fn is_temporary(name: &str) -> bool {
    name.strip_prefix(PREFIX)
        .is_some_and(|rest| rest.len() == RANDOM && rest.chars().all(|c| c.is_ascii_alphanumeric()))
}

/// Old enough, and nobody holds it.
fn is_abandoned(path: &Path) -> bool {
    let at_rest = |file: &Metadata| {
        let age = SystemTime::now()
            .duration_since(file.modified().ok()?)
            .ok()?;
        Some(file.is_file() && age >= ABANDONED)
    };
    let file = path.symlink_metadata().ok();
    file.and_then(|file| at_rest(&file)) == Some(true)
        && File::open(path).is_ok_and(|file| file.try_lock().is_ok())
}

/// Names reach the disk with their folder. Not every file system can do that, and the file is there all the same.
pub(crate) fn sync(folder: &Path) {
    #[cfg(unix)]
    let _ = File::open(folder).and_then(|folder| folder.sync_all());
    #[cfg(not(unix))]
    let _ = folder;
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;

    fn names(folder: &Path) -> Vec<String> {
        let all = fs::read_dir(folder).unwrap().flatten();
        let mut names: Vec<String> = all.map(|e| e.file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_whole_or_stays() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("report.html");
        replace(&path, b"first").unwrap();
        replace(&path, b"second").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"second");
        fs::create_dir(dir.path().join("taken")).unwrap();
        assert!(replace(&dir.path().join("taken"), b"x").is_err());
        assert!(replace(&dir.path().join("nowhere/report.html"), b"x").is_err());
        assert_eq!(names(dir.path()), ["report.html", "taken"]);
    }

    #[test]
    fn many_at_once_lose_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("name.json");
        let won = std::thread::scope(|s| {
            let all: Vec<_> = (0..8u8)
                .map(|k| {
                    let path = &path;
                    s.spawn(move || write_new(path, &[k; 1000]).unwrap().then_some(k))
                })
                .collect();
            let won = all.into_iter().filter_map(|t| t.join().unwrap());
            won.collect::<Vec<_>>()
        });
        assert_eq!(won.len(), 1);
        assert_eq!(fs::read(&path).unwrap(), vec![won[0]; 1000]);
        assert_eq!(names(dir.path()), ["name.json"]);
    }

    #[test]
    fn what_a_killed_program_left_is_swept_and_what_a_running_one_writes_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let left = |name: &str, age: Duration| -> (PathBuf, File) {
            let path = dir.path().join(name);
            let file = File::create(&path).unwrap();
            file.set_modified(SystemTime::now() - age).unwrap();
            (path, file)
        };
        let (killed, _) = left(".scopeservo-a1B2c3", 2 * ABANDONED);
        let (running, at_work) = left(".scopeservo-d4E5f6", 2 * ABANDONED);
        at_work.lock().unwrap();
        let (beginning, _) = left(".scopeservo-g7H8i9", Duration::ZERO);
        let (not_ours, _) = left(".scopeservo-notes.txt", 2 * ABANDONED);
        replace(&dir.path().join("report.html"), b"page").unwrap();
        assert!(!killed.exists());
        assert!(running.exists() && beginning.exists() && not_ours.exists());
        drop(at_work);
        write_new(&dir.path().join("name.json"), b"{}").unwrap();
        assert!(!running.exists());
    }

    #[test]
    fn a_trial_tells_whether_files_can_be_written_and_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        try_folder(dir.path()).unwrap();
        try_folder(&dir.path().join("yet/to/be/made")).unwrap();
        assert!(names(dir.path()).is_empty());
        fs::write(dir.path().join("file"), "in the way").unwrap();
        assert!(try_folder(&dir.path().join("file")).is_err());
        assert!(try_folder(&dir.path().join("file/below")).is_err());
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink("nowhere", dir.path().join("link")).unwrap();
            assert!(try_folder(&dir.path().join("link")).is_err());
        }
        make_folder(&dir.path().join("yet/to/be/made")).unwrap();
        try_folder(&dir.path().join("yet/to/be/made")).unwrap();
    }
}

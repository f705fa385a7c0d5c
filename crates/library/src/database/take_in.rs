//! What earlier versions kept as files becomes rows, file by file: whoever is killed meanwhile goes on the next time. What was taken in is put
//! aside as it was; what is damaged is told, and does not keep the rest away.

use crate::database::measured_rows::{Kind, insert, size_word};
use crate::database::objects::Objects;
use crate::database::old::put_aside;
use crate::database::rows::within;
use crate::database::run_rows::{self, NewRun};
use crate::database::target_rows::NewRow;
use crate::database::wrong::{Done, Wrong};
use crate::files;
use crate::folder::{Folder, entries, is_json};
use crate::names::{file_name, name_of, number_of};
use crate::runs::KeptRun;
use crate::targets::{ENDING, LABEL, REMOVED, bytes_of, kept_of, taken};
use crate::{Label, LibraryError};
use rusqlite::{Connection, OptionalExtension as _, Transaction};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// What is taken in, in the order in which it is.
const FOLDERS: [&str; 6] = [
    "targets",
    "calibrations",
    "calibration-sets",
    "nosepieces",
    "cameras",
    "runs",
];
/// No file of a run is larger, bytes.
const LARGEST: u64 = 1 << 30;

/// Whether files of an earlier version lie there.
pub(crate) fn waits(folder: &Folder) -> bool {
    FOLDERS.iter().any(|name| folder.path().join(name).is_dir())
}

/// One thing that was kept.
struct Old {
    /// The file, or the folder of a run.
    path: PathBuf,
    /// The same within the data folder, with `/`.
    place: String,
    kind: &'static str,
}

struct TakeIn<'a> {
    folder: &'a Folder,
    objects: &'a Objects,
}

/// Takes in all that lies there. Returns what could not be.
pub(crate) fn all(
    connection: &mut Connection,
    folder: &Folder,
    objects: &Objects,
    progress: &mut dyn FnMut(usize, usize),
) -> Done<Vec<LibraryError>> {
    // Two programs at once would each take in what the other does.
    let _lock = files::lock(folder.path());
    let _held = objects.hold()?;
    let work = TakeIn { folder, objects };
    let old = work.list()?;
    let mut told = Vec::new();
    for (done, one) in old.iter().enumerate() {
        progress(done, old.len());
        let taken = within(connection, |change| work.one(change, one));
        match taken {
            Ok(()) => put_aside(folder, &one.place)?,
            Err(Wrong::Library(error)) => told.push(error),
            Err(wrong) => return Err(wrong),
        }
        if one.kind == "targets" {
            work.beside(one)?;
        }
    }
    progress(old.len(), old.len());
    work.clear();
    Ok(told)
}

impl TakeIn<'_> {
    fn list(&self) -> Result<Vec<Old>, LibraryError> {
        let mut all = Vec::new();
        for kind in FOLDERS {
            let top = self.folder.path().join(kind);
            let mut paths = match kind {
                "targets" => [entries(&top.join(REMOVED))?, entries(&top)?].concat(),
                "runs" => self.folder.runs()?,
                "cameras" => entries(&top)?,
                _ => self.in_folders(&top)?,
            };
            let is_one = |p: &PathBuf| match kind {
                "runs" => true,
                "cameras" => p.extension().is_some_and(|e| e == "png"),
                "targets" => is_json(p) || p.extension().is_some_and(|e| e == ENDING),
                _ => is_json(p),
            };
            paths.retain(is_one);
            all.extend(paths.into_iter().filter_map(|path| {
                let within = path.strip_prefix(self.folder.path()).ok()?;
                let parts: Vec<_> = within.iter().map(|part| part.to_string_lossy()).collect();
                Some(Old {
                    place: parts.join("/"),
                    path,
                    kind,
                })
            }));
        }
        Ok(all)
    }

    /// The files of each folder in the order in which they were made.
    fn in_folders(&self, top: &Path) -> Result<Vec<PathBuf>, LibraryError> {
        let mut all = Vec::new();
        for folder in entries(top)?.into_iter().filter(|p| p.is_dir()) {
            let mut files = entries(&folder)?;
            files.sort_by_key(|p| (number_of(p), p.clone()));
            all.extend(files);
        }
        Ok(all)
    }

    /// Its row and what lies beside; nothing where it is in already.
    fn one(&self, change: &Transaction<'_>, old: &Old) -> Done<()> {
        let known = change.query_row(
            "SELECT 1 FROM taken_in WHERE path = ?1",
            [&old.place],
            |_| Ok(()),
        );
        if known.optional()?.is_some() {
            // It was taken in, and then the program was killed; or a new one came of the same name.
            let aside = self.folder.path().join("before-database").join(&old.place);
            if !files::is_there(&aside) {
                return Ok(());
            }
            change.execute("DELETE FROM taken_in WHERE path = ?1", [&old.place])?;
        }
        let became = match old.kind {
            "targets" => self.target(change, old)?,
            "runs" => self.run(change, old)?,
            kind => self.measured(change, old, kind)?,
        };
        change.execute(
            "INSERT INTO taken_in (path, became) VALUES (?1, ?2)",
            [&old.place, &became],
        )?;
        Ok(())
    }

    fn target(&self, change: &Transaction<'_>, old: &Old) -> Done<String> {
        let bytes = bytes_of(&old.path)?;
        let mut kept = kept_of(&old.path, &bytes);
        if let Ok(kept) = &mut kept
            && is_json(&old.path)
        {
            kept.id = String::new();
        }
        let stem = old.path.file_stem().unwrap_or_default().to_string_lossy();
        let removed = old.path.parent().is_some_and(|p| p.ends_with(REMOVED));
        let (name, binned) = match removed.then(|| parted(&stem)).flatten() {
            Some((name, when)) => (name.to_owned(), Some(when)),
            None => (stem.into_owned(), None),
        };
        let ending = if is_json(&old.path) { "json" } else { "target" };
        let file = self.objects.put(&bytes, ending)?;
        let picture = fs::read(old.path.with_extension("png")).ok();
        let picture = picture
            .map(|png| self.objects.put(&png, "png"))
            .transpose()?;
        let label = fs::read(old.path.with_extension(LABEL)).ok();
        let label: Label = label
            .and_then(|l| serde_json::from_slice(&l).ok())
            .unwrap_or_default();
        let wrong = kept.as_ref().err().map(|error| match error {
            LibraryError::Damaged { what, .. } => what.clone(),
            error => error.to_string(),
        });
        let new = NewRow {
            name: &name,
            kept: kept
                .as_ref()
                .map_err(|_| wrong.as_deref().unwrap_or_default()),
            label: &label,
            file: &file,
            picture: picture.as_ref(),
            binned: binned.as_deref(),
        };
        match new.insert(change)? {
            true => Ok(file.name),
            false => Err(LibraryError::Read {
                path: old.path.clone(),
                what: taken(&name).to_string(),
            }
            .into()),
        }
    }

    /// What lies beside a target's file goes with it.
    fn beside(&self, old: &Old) -> Result<(), LibraryError> {
        if old.path.exists() {
            return Ok(());
        }
        let (stem, _) = old.place.rsplit_once('.').unwrap_or((&old.place, ""));
        put_aside(self.folder, &format!("{stem}.png"))?;
        put_aside(self.folder, &format!("{stem}.{LABEL}"))
    }

    fn measured(&self, change: &Transaction<'_>, old: &Old, kind: &str) -> Done<String> {
        let bytes =
            scopeservo_files::read(&old.path, LARGEST).map_err(LibraryError::read(&old.path))?;
        let said: Value = serde_json::from_slice(&bytes).unwrap_or_default();
        let folder = old
            .path
            .parent()
            .and_then(Path::file_name)
            .unwrap_or_default();
        let folder = folder.to_string_lossy();
        let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        let made = text(&said["made"]);
        // That of its folder where it is damaged.
        let instrument = match said["instrument"].as_str() {
            Some(name) => name.to_owned(),
            None => called(change, &folder)?.unwrap_or_default(),
        };
        let (kind, instrument, of) = match kind {
            "calibrations" => {
                let of = said["calibration"]["objective"]
                    .as_str()
                    .map(str::to_owned)
                    .or_else(|| name_of(&folder));
                let Some(of) = of else {
                    return Err(LibraryError::damaged(
                        &old.path,
                        "nothing tells which objective it is of",
                    )
                    .into());
                };
                (Kind::Calibration, text(&said["instrument"]), of)
            }
            "calibration-sets" => (Kind::Set, instrument, String::new()),
            "nosepieces" => {
                let pair = &said["switching"];
                let of = format!("{} to {}", text(&pair["from"]), text(&pair["to"]));
                (Kind::Switching, instrument, of)
            }
            _ => {
                let stem = old
                    .path
                    .file_stem()
                    .unwrap_or_default()
                    .to_string_lossy()
                    .into_owned();
                match camera(change, &stem)? {
                    Some((instrument, size)) => (Kind::Shadows, instrument, size),
                    // Of an instrument of which nothing else was kept: the next run sees them anew.
                    None => return Ok(String::new()),
                }
            }
        };
        let ending = if kind == Kind::Shadows { "png" } else { "json" };
        let file = self.objects.put(&bytes, ending)?;
        insert(change, kind, [&instrument, &of, &made], &file)?;
        Ok(file.name)
    }

    fn run(&self, change: &Transaction<'_>, old: &Old) -> Done<String> {
        let file = old.path.join("run.json");
        let bytes = scopeservo_files::read(&file, LARGEST).map_err(LibraryError::read(&file))?;
        let kept: KeptRun = crate::folder::parse(&file, &bytes)?;
        let name = old
            .path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let id = run_rows::next(change)?;
        NewRun {
            id,
            name: &name,
            began: &kept.began,
            head: &kept.head,
        }
        .insert(change)?;
        let events =
            scopeservo_files::read(&old.path.join("events.jsonl"), LARGEST).unwrap_or_default();
        let events = String::from_utf8_lossy(&events);
        for (number, line) in events.lines().filter(|line| !line.is_empty()).enumerate() {
            run_rows::event(change, id, number as i64 + 1, line)?;
        }
        for path in entries(&old.path)? {
            let name = path
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            if path.is_file()
                && !["run.json", "events.jsonl", "answer.json"].contains(&name.as_str())
                && !name.starts_with('.')
            {
                let bytes =
                    scopeservo_files::read(&path, LARGEST).map_err(LibraryError::read(&path))?;
                let ending = path
                    .extension()
                    .unwrap_or_default()
                    .to_string_lossy()
                    .into_owned();
                let file = self
                    .objects
                    .put(&bytes, if ending.is_empty() { "bin" } else { &ending })?;
                run_rows::attach(change, id, &name, &file)?;
            }
        }
        let answer = old.path.join("answer.json");
        if let Ok(bytes) = scopeservo_files::read(&answer, LARGEST) {
            let answer: Value = crate::folder::parse(&answer, &bytes)?;
            // Nobody kept when it ended.
            run_rows::end(change, id, &kept.began, &answer)?;
        }
        Ok(name)
    }

    /// Folders in which nothing is left.
    fn clear(&self) {
        for kind in FOLDERS {
            let top = self.folder.path().join(kind);
            let _ = fs::remove_file(top.join(".lock"));
            for inside in entries(&top).unwrap_or_default() {
                let _ = fs::remove_dir(inside);
            }
            let _ = fs::remove_dir(top);
        }
    }
}

/// The instrument whose files are called so: one that is known, or one whose name is plain.
fn called(change: &Transaction<'_>, file: &str) -> Done<Option<String>> {
    let mut all = change.prepare_cached("SELECT name FROM instruments")?;
    let all = all.query_map([], |row| row.get::<_, String>(0))?;
    let known: Vec<String> = all.collect::<Result<_, _>>()?;
    let known = known.into_iter().find(|name| file_name(name) == file);
    Ok(known.or_else(|| name_of(file)))
}

/// The instrument and the size of what lay on a camera, by the name of its file.
fn camera(change: &Transaction<'_>, stem: &str) -> Done<Option<(String, String)>> {
    let parts = stem.rsplit_once('-').and_then(|(name, size)| {
        let (w, h) = size.split_once('x')?;
        Some((name, size_word([w.parse().ok()?, h.parse().ok()?])))
    });
    match parts {
        Some((name, size)) => Ok(called(change, name)?.map(|name| (name, size))),
        None => Ok(None),
    }
}

/// A removed target's name, and when it was removed: NAME_2026-11-24T20-15-00Z, or with _1 behind.
fn parted(stem: &str) -> Option<(&str, String)> {
    let is_time = |t: &str| t.len() == 20 && t.ends_with('Z') && t.as_bytes()[10] == b'T';
    let (front, last) = stem.rsplit_once('_')?;
    let (name, when) = match is_time(last) {
        true => (front, last),
        false => {
            let (name, when) = front.rsplit_once('_')?;
            (name, is_time(when).then_some(when)?)
        }
    };
    let (day, time) = when.split_once('T')?;
    Some((name, format!("{day}T{}", time.replace('-', ":"))))
}

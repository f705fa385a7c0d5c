//! Saved views: a row each, the target's file and a picture for people beside.

use crate::database::objects::Stored;
use crate::database::rows::slide;
use crate::database::store::Database;
use crate::database::target_rows::{COLUMNS, FROM, NewRow, TargetRow};
use crate::database::under_way;
use crate::database::wrong::{Done, Wrong};
use crate::names::{check_name, plain_name, utc};
use crate::targets::{is_first, kept_of, picture_of, png, taken};
use crate::{KeptTarget, Label, LibraryError, NewTarget, Targets, keep_new, target_file};
use rusqlite::{Connection, OptionalExtension as _, Transaction, params};
use scopeservo_scope::Frame;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// So many names are told to who asks for one that is none.
const KNOWN: usize = 12;

impl Database {
    /// What lists tell of a target.
    ///
    /// # Errors
    /// [`LibraryError::NoTarget`], [`LibraryError::BadName`], those of the database.
    pub fn target_row(&self, name: &str) -> Result<TargetRow, LibraryError> {
        plain_name(name)?;
        match self.read(|c| row(c, name))? {
            Some(row) => Ok(row),
            None => Err(self.no_target(name)),
        }
    }

    pub(crate) fn no_target(&self, name: &str) -> LibraryError {
        let known = self.read(|c| {
            let all = c.query_row("SELECT count(*) FROM targets WHERE binned IS NULL", [], |r| r.get::<_, i64>(0))?;
            let mut names = c.prepare_cached(
                "SELECT name FROM targets WHERE binned IS NULL ORDER BY saved DESC, id DESC LIMIT ?1",
            )?;
            let names = names.query_map([KNOWN as i64], |r| r.get(0))?;
            Ok((all as usize, names.collect::<Result<Vec<String>, _>>()?))
        });
        let (all, known) = known.unwrap_or_default();
        let more = all.saturating_sub(known.len());
        LibraryError::NoTarget {
            name: name.into(),
            known,
            more,
        }
    }

    /// Where the file of a target lies.
    pub fn target_file(&self, row: &TargetRow) -> PathBuf {
        self.objects().place(&row.file)
    }

    /// What is wrong with a target's file, as far as that is seen without reading it.
    pub fn target_is_damaged(&self, row: &TargetRow) -> Option<LibraryError> {
        let path = self.target_file(row);
        match (&row.damaged, path.exists()) {
            (Some(what), _) => Some(LibraryError::Damaged {
                path,
                what: what.clone(),
            }),
            (None, false) => Some(LibraryError::Read {
                path,
                what: format!(
                    "the file of '{}' is not there. Bring it back from a backup",
                    row.name
                ),
            }),
            (None, true) => None,
        }
    }

    /// The target of a row.
    ///
    /// # Errors
    /// [`LibraryError::Damaged`], [`LibraryError::Read`].
    pub fn target_in(&self, row: &TargetRow) -> Result<KeptTarget, LibraryError> {
        let bytes = self.objects().get(&row.file)?;
        kept_of(&self.objects().place(&row.file), &bytes)
    }

    /// Changes the row of a target that no run needs as it is; `None` when there is none.
    fn change_free(
        &self,
        change: &Transaction<'_>,
        name: &str,
        sql: &str,
        to: &str,
    ) -> Done<Option<()>> {
        let id = change.query_row(
            "SELECT id FROM targets WHERE name = ?1 AND binned IS NULL",
            [name],
            |row| row.get(0),
        );
        let Some(id) = id.optional()? else {
            return Ok(None);
        };
        under_way::is_free(change, self.folder(), id)?;
        change_row(change, name, sql, Some(to))
    }

    /// Puts the file and the picture of a target beside, and then its row.
    fn keep(
        &self,
        name: &str,
        bytes: &[u8],
        kept: &KeptTarget,
        frame: Option<&Frame>,
        label: &Label,
    ) -> Result<PathBuf, LibraryError> {
        let picture = frame.map(png).transpose()?;
        let objects = self.objects();
        let made = self.write(|change| {
            let file = objects.put(bytes, "target")?;
            let picture = picture
                .as_ref()
                .map(|png| objects.put(png, "png"))
                .transpose()?;
            let new = NewRow {
                name,
                kept: Ok(kept),
                label,
                file: &file,
                picture: picture.as_ref(),
                binned: None,
            };
            Ok(new.insert(change)?.then_some(file))
        })?;
        match made {
            Some(Stored { name, .. }) => Ok(objects.place(&name)),
            None => Err(taken(name)),
        }
    }
}

/// The row of a target that is not in the bin.
fn row(connection: &Connection, name: &str) -> Done<Option<TargetRow>> {
    let wanted = format!("SELECT {COLUMNS} FROM {FROM} WHERE targets.name = ?1 AND binned IS NULL");
    let row = connection
        .prepare_cached(&wanted)?
        .query_row([name], TargetRow::of)
        .optional()?;
    Ok(row)
}

/// Changes the row of a target; `None` when there is none.
pub(crate) fn change_row(
    change: &Transaction<'_>,
    name: &str,
    sql: &str,
    to: Option<&str>,
) -> Done<Option<()>> {
    let sql = format!("UPDATE targets SET {sql} WHERE name = ?2 AND binned IS NULL");
    let changed = change.execute(&sql, params![to, name])?;
    Ok((changed == 1).then_some(()))
}

impl Targets for Database {
    fn target_names(&self) -> Result<Vec<String>, LibraryError> {
        self.read(|c| {
            let mut names =
                c.prepare_cached("SELECT name FROM targets WHERE binned IS NULL ORDER BY name")?;
            let names = names.query_map([], |row| row.get(0))?;
            Ok(names.collect::<Result<_, _>>()?)
        })
    }

    fn target(&self, name: &str) -> Result<KeptTarget, LibraryError> {
        self.target_in(&self.target_row(name)?)
    }

    fn target_path(&self, name: &str) -> Result<PathBuf, LibraryError> {
        Ok(self.objects().place(&self.target_row(name)?.file))
    }

    fn target_picture(&self, name: &str) -> Option<Frame> {
        let picture = self.target_row(name).ok()?.picture?;
        picture_of(&self.objects().place(&picture))
    }

    fn target_label(&self, name: &str) -> Result<Label, LibraryError> {
        Ok(self.target_row(name)?.label)
    }

    fn label_target(&self, name: &str, label: &Label) -> Result<(), LibraryError> {
        self.target_row(name)?;
        let done = self.write(|change| {
            let on = label
                .slide
                .as_deref()
                .map(|name| slide(change, name))
                .transpose()?;
            let changed = change.execute(
                "UPDATE targets SET slide = ?1, note = ?2 WHERE name = ?3 AND binned IS NULL",
                params![on, label.note, name],
            )?;
            Ok(changed == 1)
        })?;
        match done {
            true => Ok(()),
            false => Err(self.no_target(name)),
        }
    }

    fn try_targets(&self) -> Result<(), LibraryError> {
        self.try_room()
    }

    fn check_new_target(&self, name: &str) -> Result<(), LibraryError> {
        plain_name(name)?;
        check_name(name)?;
        self.try_targets()?;
        let known = self.read(|c| {
            let known = c.query_row(
                "SELECT name FROM targets WHERE name = ?1 COLLATE NOCASE AND binned IS NULL",
                [name],
                |row| row.get::<_, String>(0),
            );
            Ok(known.optional()?)
        })?;
        match known {
            Some(known) => Err(taken(&known)),
            None => Ok(()),
        }
    }

    fn keep_target(&self, new: NewTarget<'_>) -> Result<PathBuf, LibraryError> {
        plain_name(new.name)?;
        let frame = new.frame;
        let (name, label) = (new.name, new.label.clone());
        let mut kept = new.kept();
        let (bytes, id) = target_file::encode(&kept, Some(name))?;
        kept.id = id;
        self.keep(name, &bytes, &kept, Some(frame), &label)
    }

    fn rename_target(&self, name: &str, to: &str) -> Result<PathBuf, LibraryError> {
        let row = self.target_row(name)?;
        if name.eq_ignore_ascii_case(to) {
            return Err(taken(name));
        }
        self.check_new_target(to)?;
        // A damaged one keeps its name, so that what is left of it is not lost track of.
        self.target_in(&row)?;
        let done = self.write(
            |change| match self.change_free(change, name, "name = ?1", to) {
                Err(Wrong::Database(e)) if is_taken(&e) => Err(Wrong::Library(taken(to))),
                done => done,
            },
        )?;
        done.ok_or_else(|| self.no_target(name))?;
        Ok(self.objects().place(&row.file))
    }

    fn remove_target(&self, name: &str) -> Result<PathBuf, LibraryError> {
        let row = self.target_row(name)?;
        let now = utc(SystemTime::now());
        let done = self.write(|change| self.change_free(change, name, "binned = ?1", &now))?;
        done.ok_or_else(|| self.no_target(name))?;
        Ok(self.objects().place(&row.file))
    }

    fn export_target(&self, name: &str, to: &Path) -> Result<(), LibraryError> {
        let row = self.target_row(name)?;
        let kept = self.target_in(&row)?;
        let bytes = match is_first(Path::new(&row.file)) {
            true => target_file::encode(&kept, Some(name))?.0,
            false => self.objects().get(&row.file)?,
        };
        keep_new(to, &bytes)
    }

    fn import_target(&self, from: &Path, name: &str) -> Result<KeptTarget, LibraryError> {
        self.check_new_target(name)?;
        let bytes = crate::targets::bytes_of(from)?;
        let mut kept = kept_of(from, &bytes)?;
        let bytes = match is_first(from) {
            true => {
                let (bytes, id) = target_file::encode(&kept, Some(name))?;
                kept.id = id;
                bytes
            }
            false => bytes,
        };
        let taken = kept.target.taken.clone();
        self.keep(
            name,
            &bytes,
            &kept,
            taken.as_deref().map(|t| &*t.frame),
            &Label::default(),
        )?;
        Ok(kept)
    }
}

/// Whether a row could not be as one like it is there.
pub(crate) fn is_taken(error: &rusqlite::Error) -> bool {
    error.sqlite_error_code() == Some(rusqlite::ErrorCode::ConstraintViolation)
}

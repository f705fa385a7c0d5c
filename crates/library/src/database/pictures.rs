//! Pictures that somebody brought, for a simulated microscope to look at: a row each, and the file as it came beside.

use crate::LibraryError;
use crate::database::bin::Gone;
use crate::database::objects::Stored;
use crate::database::rows::{row_of, within};
use crate::database::store::Database;
use crate::database::targets::is_taken;
use crate::names::{check_name, plain_name, utc};
use rusqlite::{OptionalExtension as _, Row, params};
use serde::Serialize;
use std::path::PathBuf;
use std::time::SystemTime;

/// So many are kept at most.
pub const PICTURES: usize = 50;

/// A picture, as it is listed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PictureRow {
    /// Its name.
    pub name: String,
    /// The size of its pixels on the specimen, um.
    pub um_per_px: f64,
    /// Its size, pixels.
    pub size_px: [u32; 2],
    /// How large its file is.
    pub bytes: u64,
    /// Who brought it.
    pub user: String,
    /// When, UTC.
    pub brought: String,
    /// The object.
    #[serde(skip)]
    pub(crate) file: String,
}

/// A picture that is to be kept.
#[derive(Debug, Clone, Copy)]
pub struct NewPicture<'a> {
    /// Its name, as those of targets are.
    pub name: &'a str,
    /// The size of its pixels on the specimen, um.
    pub um_per_px: f64,
    /// Its size, pixels.
    pub size_px: [u32; 2],
    /// Who brings it.
    pub user: &'a str,
}

const COLUMNS: &str = "pictures.name, um_per_px, width_px, height_px, bytes, user, brought, file \
     FROM pictures JOIN objects ON objects.name = pictures.file";

impl PictureRow {
    fn of(row: &Row<'_>) -> rusqlite::Result<Self> {
        Ok(Self {
            name: row.get(0)?,
            um_per_px: row.get(1)?,
            size_px: [row.get(2)?, row.get(3)?],
            bytes: row.get::<_, i64>(4)? as u64,
            user: row.get(5)?,
            brought: row.get(6)?,
            file: row.get(7)?,
        })
    }
}

impl Database {
    /// All pictures, the newest first.
    ///
    /// # Errors
    /// Those of the database.
    pub fn pictures(&self) -> Result<Vec<PictureRow>, LibraryError> {
        self.read(|c| {
            let mut all =
                c.prepare_cached(&format!("SELECT {COLUMNS} ORDER BY pictures.id DESC"))?;
            let all = all.query_map([], PictureRow::of)?;
            Ok(all.collect::<Result<_, _>>()?)
        })
    }

    /// One of them, and where its file lies.
    ///
    /// # Errors
    /// [`LibraryError::NoPicture`]; [`LibraryError::Damaged`] and [`LibraryError::Read`] where the file is not what was kept; those of the
    /// database.
    pub fn picture(&self, name: &str) -> Result<(PictureRow, PathBuf), LibraryError> {
        let row = self.read(|c| {
            let row = c.query_row(
                &format!("SELECT {COLUMNS} WHERE pictures.name = ?1"),
                [name],
                PictureRow::of,
            );
            Ok(row.optional()?)
        })?;
        let row = row.ok_or_else(|| LibraryError::NoPicture { name: name.into() })?;
        self.objects().get(&row.file)?;
        let place = self.objects().place(&row.file);
        Ok((row, place))
    }

    /// Whether a picture could be kept under a name, before it is sent.
    ///
    /// # Errors
    /// [`LibraryError::BadName`], [`LibraryError::Taken`], [`LibraryError::TooManyPictures`], [`LibraryError::CannotWrite`].
    pub fn check_new_picture(&self, name: &str) -> Result<(), LibraryError> {
        plain_name(name)?;
        check_name(name)?;
        self.try_room()?;
        let all = self.pictures()?;
        match all.iter().find(|row| row.name.eq_ignore_ascii_case(name)) {
            Some(row) => Err(LibraryError::Taken {
                name: row.name.clone(),
            }),
            None if all.len() >= PICTURES => Err(LibraryError::TooManyPictures { most: PICTURES }),
            None => Ok(()),
        }
    }

    /// Keeps a picture as it came; `ending` is that of its kind, such as `png`.
    ///
    /// # Errors
    /// As [`Database::check_new_picture`], and [`LibraryError::NotKept`].
    pub fn keep_picture(
        &self,
        new: NewPicture<'_>,
        bytes: &[u8],
        ending: &str,
    ) -> Result<PictureRow, LibraryError> {
        self.check_new_picture(new.name)?;
        let brought = utc(SystemTime::now());
        let Stored { name: file, bytes } = self.write(|change| {
            let file = self.objects().put(bytes, ending)?;
            row_of(change, &file)?;
            let [width, height] = new.size_px;
            let made = change.execute(
                "INSERT INTO pictures (name, um_per_px, width_px, height_px, user, brought, file) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
                params![new.name, new.um_per_px, width, height, new.user, brought, file.name],
            );
            match made {
                Err(e) if is_taken(&e) => Err(LibraryError::Taken { name: new.name.into() }.into()),
                made => Ok(made.map(|_| file)?),
            }
        })?;
        Ok(PictureRow {
            name: new.name.into(),
            um_per_px: new.um_per_px,
            size_px: new.size_px,
            bytes,
            user: new.user.into(),
            brought,
            file,
        })
    }

    /// Deletes a picture for good.
    ///
    /// # Errors
    /// [`LibraryError::NoPicture`], those of the database.
    pub fn remove_picture(&self, name: &str) -> Result<(), LibraryError> {
        self.sweep(|connection| {
            let mut gone = Gone::default();
            within(connection, |change| {
                let file: Option<String> = change
                    .query_row(
                        "DELETE FROM pictures WHERE name = ?1 RETURNING file",
                        [name],
                        |row| row.get(0),
                    )
                    .optional()?;
                let none = || LibraryError::NoPicture { name: name.into() };
                gone.objects.insert(file.ok_or_else(none)?);
                Ok(())
            })?;
            self.delete_files(connection, &gone)
        })
    }
}

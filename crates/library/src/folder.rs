//! A library that is a folder of files.

use crate::LibraryError;
use crate::files::{self, write_new};
use crate::names::{next_number, number_of};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};
use std::{fs, io};

/// Version of the files in JSON.
pub(crate) const SCHEMA: u32 = 1;

/// A folder with what an instrument keeps.
#[derive(Debug, Clone)]
pub struct Folder {
    folder: PathBuf,
}

impl Folder {
    /// The folder need not be there yet.
    pub fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// Where it lies.
    pub fn path(&self) -> &Path {
        &self.folder
    }

    pub(crate) fn try_folder(&self, folder: &Path) -> Result<(), LibraryError> {
        files::try_folder(folder).map_err(|source| LibraryError::CannotWrite {
            path: folder.into(),
            source,
        })
    }
}

pub(crate) fn is_json(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "json")
}

/// What lies in a folder, in order of names; nothing when there is no such folder.
pub(crate) fn entries(folder: &Path) -> Result<Vec<PathBuf>, LibraryError> {
    let unreadable = |e: std::io::Error| LibraryError::Read {
        path: folder.into(),
        what: e.to_string(),
    };
    let listing = match fs::read_dir(folder) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        listing => listing.map_err(unreadable)?,
    };
    let mut all = Vec::new();
    for entry in listing {
        all.push(entry.map_err(unreadable)?.path());
    }
    all.sort();
    Ok(all)
}

/// No file of JSON is larger, bytes.
const LARGEST_JSON: u64 = 256 << 20;

pub(crate) fn read<T: DeserializeOwned>(path: &Path) -> Result<T, LibraryError> {
    let text = scopeservo_files::read(path, LARGEST_JSON).map_err(|e| LibraryError::Read {
        path: path.into(),
        what: e.to_string(),
    })?;
    parse(path, &text)
}

/// What the JSON of a file says.
pub(crate) fn parse<T: DeserializeOwned>(path: &Path, text: &[u8]) -> Result<T, LibraryError> {
    let damaged = |e: serde_json::Error| LibraryError::Damaged {
        path: path.into(),
        what: format!("{e}. Move it away, or make it again"),
    };
    let value: serde_json::Value = serde_json::from_slice(text).map_err(damaged)?;
    match value.get("schema") {
        Some(schema) if schema != SCHEMA => Err(LibraryError::Read {
            path: path.into(),
            what: format!("it has schema {schema}, and this version reads {SCHEMA}"),
        }),
        _ => serde_json::from_value(value).map_err(damaged),
    }
}

pub(crate) fn to_json(value: &impl Serialize) -> Result<Vec<u8>, LibraryError> {
    serde_json::to_vec_pretty(value).map_err(|e| LibraryError::Encode(e.to_string()))
}

/// An image as a PNG; samples of 16 bits in the machine's order.
pub(crate) fn to_png(
    samples: &[u8],
    [width, height]: [usize; 2],
    color: ExtendedColorType,
) -> Result<Vec<u8>, LibraryError> {
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(samples, width as u32, height as u32, color)
        .map_err(|e| LibraryError::Encode(e.to_string()))?;
    Ok(png)
}

/// Writes a file of its own for somebody, and never over another.
///
/// # Errors
/// [`LibraryError::NotKept`], also where there is one of that name.
pub fn keep_new(path: &Path, bytes: &[u8]) -> Result<(), LibraryError> {
    let taken = || io::Error::other("there is a file of that name already");
    let written = write_new(path, bytes).and_then(|new| new.then_some(()).ok_or_else(taken));
    written.map_err(LibraryError::not_kept(path))
}

/// What a folder takes no more files for.
pub(crate) fn no_number(folder: &Path) -> io::Error {
    let what = format!(
        "the last number is taken in {}: move the file with it away",
        folder.display()
    );
    io::Error::other(what)
}

/// Writes a file beside those of a folder, under the next number and the moment it was `made`. Returns where it lies.
///
/// # Errors
/// [`LibraryError::NotKept`]; [`LibraryError::Read`] for the folder.
pub(crate) fn write_numbered(
    folder: &Path,
    made: &str,
    bytes: &[u8],
) -> Result<PathBuf, LibraryError> {
    loop {
        let last = entries(folder)?.iter().map(|p| number_of(p)).max();
        let number = next_number(last)
            .ok_or_else(|| no_number(folder))
            .map_err(LibraryError::not_kept(folder))?;
        let path = folder.join(format!("{number:06}_{}.json", made.replace(':', "-")));
        // Another process may make one at the same time: whichever comes second takes the next number.
        if write_new(&path, bytes).map_err(LibraryError::not_kept(&path))? {
            return Ok(path);
        }
    }
}

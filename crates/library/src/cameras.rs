//! The shadows of dust on an instrument's camera on disk: a grey image of 16 bits, where 16384 is a pixel that gets all of its light.

use crate::LibraryError;
use crate::files::{self, make_folder};
use crate::folder::{self, Folder};
use crate::names::file_name;
use image::ExtendedColorType;
use scopeservo_scope::FlatField;
use scopeservo_slide::{Samples, Wanted};
use std::path::PathBuf;

/// The level of a pixel on which nothing lies.
const CLEAR: f32 = 16384.0;
/// No such image is larger, bytes.
const LARGEST: u64 = 1 << 28;

/// The shadows on an instrument's cameras.
pub trait Cameras {
    /// Those that were seen last with images of that size; `None` when none ever were.
    ///
    /// # Errors
    /// [`LibraryError::Read`], [`LibraryError::Damaged`].
    fn shadows(
        &self,
        instrument: &str,
        size_px: [usize; 2],
    ) -> Result<Option<FlatField>, LibraryError>;

    /// Keeps those that were seen now, in place of those of before. Returns where they lie.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    fn keep_shadows(&self, instrument: &str, seen: &FlatField) -> Result<PathBuf, LibraryError>;
}

impl Folder {
    pub(crate) fn shadows_of(&self, instrument: &str, [width, height]: [usize; 2]) -> PathBuf {
        let name = format!("{}-{width}x{height}.png", file_name(instrument));
        self.path().join("cameras").join(name)
    }
}

impl Cameras for Folder {
    fn shadows(
        &self,
        instrument: &str,
        size_px: [usize; 2],
    ) -> Result<Option<FlatField>, LibraryError> {
        let path = self.shadows_of(instrument, size_px);
        let bytes = match scopeservo_files::read(&path, LARGEST) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            bytes => bytes.map_err(LibraryError::read(&path))?,
        };
        let seen = from_png(&bytes).map_err(|what| LibraryError::damaged(&path, what))?;
        match [seen.width(), seen.height()] == size_px {
            true => Ok(Some(seen)),
            false => Err(LibraryError::damaged(&path, "it has another size")),
        }
    }

    fn keep_shadows(&self, instrument: &str, seen: &FlatField) -> Result<PathBuf, LibraryError> {
        let path = self.shadows_of(instrument, [seen.width(), seen.height()]);
        let png = to_png(seen)?;
        let folder = self.path().join("cameras");
        make_folder(&folder).map_err(LibraryError::not_kept(&folder))?;
        files::replace(&path, &png).map_err(LibraryError::not_kept(&path))?;
        Ok(path)
    }
}

/// Shadows from their image; else what is wrong with it.
pub(crate) fn from_png(bytes: &[u8]) -> Result<FlatField, String> {
    let picture = scopeservo_slide::decode(bytes, &Wanted::default()).map_err(|e| e.to_string())?;
    let (1, Samples::U16(levels)) = (picture.channels, picture.samples) else {
        return Err("it is no grey image of 16 bits".into());
    };
    let transmission = levels.into_iter().map(|v| f32::from(v) / CLEAR).collect();
    FlatField::new(picture.width, picture.height, transmission).map_err(|e| e.to_string())
}

pub(crate) fn to_png(seen: &FlatField) -> Result<Vec<u8>, LibraryError> {
    let level = |t: &f32| (t * CLEAR).round().min(65535.0) as u16;
    let bytes: Vec<u8> = seen
        .transmission()
        .iter()
        .flat_map(|t| level(t).to_ne_bytes())
        .collect();
    folder::to_png(
        &bytes,
        [seen.width(), seen.height()],
        ExtendedColorType::L16,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen() -> FlatField {
        let t = |i: usize| if (100..140).contains(&i) { 0.5 } else { 1.0 };
        FlatField::new(40, 30, (0..1200).map(t).collect()).unwrap()
    }

    #[test]
    fn shadows_come_back_as_they_were_kept() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::new(dir.path().into());
        assert_eq!(folder.shadows("bench", [40, 30]).unwrap(), None);
        folder.keep_shadows("bench", &seen()).unwrap();
        assert_eq!(folder.shadows("bench", [40, 30]).unwrap(), Some(seen()));
        assert_eq!(folder.shadows("bench", [30, 40]).unwrap(), None);
        assert_eq!(folder.shadows("other", [40, 30]).unwrap(), None);
    }

    #[test]
    fn a_damaged_picture_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::new(dir.path().into());
        let path = folder.keep_shadows("bench", &seen()).unwrap();
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
        let error = folder.shadows("bench", [40, 30]).unwrap_err();
        assert!(matches!(error, LibraryError::Damaged { .. }), "{error}");
    }
}

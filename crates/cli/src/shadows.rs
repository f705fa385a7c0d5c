//! The shadows of dust on an instrument's camera on disk: a grey picture of 16 bits, where 16384 is a pixel that gets all of its light.

use crate::error::CliError;
use crate::files::{self, make_folder};
use crate::kept::file_name;
use crate::store::Store;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use scopeservo_scope::FlatField;
use std::path::PathBuf;

/// The level of a pixel on which nothing lies.
const CLEAR: f32 = 16384.0;

fn file(store: &Store, instrument: &str, [width, height]: [usize; 2]) -> PathBuf {
    let name = format!("{}-{width}x{height}.png", file_name(instrument));
    store.folder().join("cameras").join(name)
}

/// Those that were seen last; `None` when none ever were.
pub(crate) fn kept(
    store: &Store,
    instrument: &str,
    size_px: [usize; 2],
) -> Result<Option<FlatField>, CliError> {
    let path = file(store, instrument, size_px);
    let bytes = match std::fs::read(&path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => {
            return Err(CliError::Read {
                path,
                what: e.to_string(),
            });
        }
        Ok(bytes) => bytes,
    };
    let damaged = |what: String| CliError::Damaged {
        path: path.clone(),
        what: format!("{what}. Move it away: it is made again when a view is saved"),
    };
    let picture = image::load_from_memory_with_format(&bytes, image::ImageFormat::Png)
        .map_err(|e| damaged(e.to_string()))?
        .into_luma16();
    let [width, height] = [picture.width(), picture.height()].map(|v| v as usize);
    if [width, height] != size_px {
        return Err(damaged(format!("it has {width} x {height} pixels")));
    }
    let levels = picture.into_raw().into_iter();
    let transmission = levels.map(|v| f32::from(v) / CLEAR).collect();
    FlatField::new(width, height, transmission)
        .map(Some)
        .map_err(|e| damaged(e.to_string()))
}

/// Keeps those that were seen now, in place of those of before.
pub(crate) fn keep(store: &Store, instrument: &str, seen: &FlatField) -> Result<PathBuf, CliError> {
    let size_px = [seen.width(), seen.height()];
    let path = file(store, instrument, size_px);
    let level = |t: &f32| (t * CLEAR).round().min(65535.0) as u16;
    let bytes: Vec<u8> = seen
        .transmission()
        .iter()
        .flat_map(|t| level(t).to_ne_bytes())
        .collect();
    let mut png = Vec::new();
    let [width, height] = size_px.map(|v| v as u32);
    PngEncoder::new(&mut png)
        .write_image(&bytes, width, height, ExtendedColorType::L16)
        .map_err(|e| CliError::Internal(format!("the picture of the camera's shadows: {e}")))?;
    let folder = store.folder().join("cameras");
    make_folder(&folder).map_err(CliError::not_kept(&folder))?;
    files::replace(&path, &png).map_err(CliError::not_kept(&path))?;
    Ok(path)
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
        let folder = tempfile::tempdir().unwrap();
        let store = Store::new(folder.path().into());
        assert_eq!(kept(&store, "bench", [40, 30]).unwrap(), None);
        keep(&store, "bench", &seen()).unwrap();
        assert_eq!(kept(&store, "bench", [40, 30]).unwrap(), Some(seen()));
        assert_eq!(kept(&store, "bench", [30, 40]).unwrap(), None);
        assert_eq!(kept(&store, "other", [40, 30]).unwrap(), None);
    }

    #[test]
    fn a_damaged_picture_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::new(folder.path().into());
        let path = keep(&store, "bench", &seen()).unwrap();
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
        let error = kept(&store, "bench", [40, 30]).unwrap_err();
        assert!(matches!(error, CliError::Damaged { .. }), "{error}");
    }
}

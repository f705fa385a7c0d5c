//! Image files as slides: PNG, JPEG, TIFF, tiled and pyramidal TIFF, SVS, read by regions.
//!
//! Pixel frame: column `x` runs right, row `y` runs down, the corner of the first pixel is (0, 0). Level 0 is the
//! finest. The format is judged by content, never by the file's extension. Rows and columns are those stored in the
//! file: an EXIF orientation is not applied. This crate knows no microscope and no micrometre frame; it only passes on
//! the pixel size that a file states.
//!
//! Memory: a PNG, JPEG or stripped TIFF is held once, decoded, at 3 bytes per pixel. A tiled TIFF stays on disk; at
//! most [`TILE_CACHE_BYTES`] of its decoded tiles are kept.

#![warn(clippy::too_many_lines)]

pub mod cache;
mod error;
mod jpeg;
mod raster;
mod slide;
mod tags;
mod tiled;
mod whole;

pub use error::SlideError;
pub use raster::{Gray, Rgb8};
pub use slide::{LevelInfo, Slide};

/// Most pixels one level may have: 2^30, about one gigapixel for a whole image and for every level of a pyramid that is
/// read in one piece. Tiled levels may be larger as long as they are read by regions.
pub const MAX_PIXELS: u64 = 1 << 30;

/// Upper bound of the decoded tiles kept per slide, bytes.
pub const TILE_CACHE_BYTES: usize = 64 << 20;

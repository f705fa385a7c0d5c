//! Image files as slides: PNG, JPEG, JPEG 2000, TIFF, tiled and pyramidal TIFF, OME-TIFF, SVS, whole or by regions. The one reader of the
//! program: files, the images of cameras, the members of targets.
//!
//! Pixel frame: column `x` runs right, row `y` runs down, the corner of the first pixel is (0, 0), as the image is shown: orientation tags of
//! TIFF and EXIF are applied. Level 0 is the finest. The format is judged by content, never by the file's extension. This crate knows no
//! microscope and no micrometre frame; it only passes on the pixel size that a file states.
//!
//! A row of samples takes one way, whatever it comes from: decompressed (`png`, `jpeg`, `tiff`), given its meaning (`layout`), and placed
//! upright in what was asked for (`sink`), reduced on the way.
//!
//! Memory: [`Budget`]. What a file decides about is allocated after it was asked for there. A tiled TIFF stays on disk; at
//! most [`TILE_CACHE_BYTES`] of its decoded tiles are kept.

#![warn(clippy::too_many_lines)]

mod budget;
pub mod cache;
mod choice;
mod error;
mod input;
mod jpeg;
mod jpeg2000;
mod layout;
mod orientation;
mod picture;
mod png;
mod raster;
mod sink;
mod slide;
mod source;
mod tiff;

pub use budget::Budget;
pub use choice::{Choice, Choices};
pub use error::{Fault, SlideError};
pub use layout::Alpha;
pub use picture::{Picture, Samples, Wanted, decode};
pub use raster::{Gray, Rgb8};
pub use slide::{LevelInfo, Slide};

/// Most pixels of a level that is read whole: 2^32. Tiled levels may be larger as long as they are read by regions.
pub const MAX_PIXELS: u64 = 1 << 32;

/// Upper bound of the decoded tiles kept per slide, bytes.
pub const TILE_CACHE_BYTES: usize = 64 << 20;

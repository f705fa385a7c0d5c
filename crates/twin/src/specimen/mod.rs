//! What lies under the objective.
//!
//! Frame: the specimen plane in micrometres, x to the right, y **up**. A file lies with its centre at the origin, its
//! columns along +x and its rows along -y. Beyond a file is blank [`GLASS`].
//!
//! A specimen is sampled at spacings `finest_um * 2^level`. A sample of level L + 1 is the mean of 2 x 2 samples of
//! level L, so a coarse view is anti-aliased, and its samples are centred half a fine sample away from fine ones; a
//! [`Patch`] carries its own origin for that reason.

mod blank;
mod canvas;
mod file;
mod lattice;
mod made;
mod pyramid;
mod shape;
mod sparse;
mod texture;
mod tissue;
mod twice;

use std::path::PathBuf;

use scopeservo_slide::SlideError;

pub use blank::Blank;
pub use file::FileSpecimen;
pub use lattice::{CellKind, Lattice, LatticeConfig, LatticeKind};
pub use made::{MadeSpecimen, TwiceConfig};
pub use sparse::{Sparse, SparseConfig};
pub use texture::texture_share;
pub use tissue::Tissue;
pub use twice::Twice;

/// Colour of blank glass, as the camera sees it on 0..=255.
pub const GLASS: [u8; 3] = [243, 242, 244];

/// Most samples one patch may have, about 190 MB of colour.
pub const MAX_PATCH_SAMPLES: usize = 1 << 26;

/// What lies under the objective: transmitted colour, linear on the camera's 0..=255, at any place and sampling.
pub trait Specimen: Send + Sync {
    /// Spacing of the samples of level 0, micrometres.
    fn finest_um(&self) -> f64;

    /// Number of levels, at least one; level L has the spacing `finest_um() * 2^L`.
    fn levels(&self) -> usize;

    /// A dense patch of `level` that covers the rectangle from `x_um[0]` to `x_um[1]` and `y_um[0]` to `y_um[1]`
    /// (micrometres, low end first), so that every point of it lies between samples, and `margin` samples more on every
    /// side.
    ///
    /// # Errors
    /// A level that is not there, a rectangle that is not finite, reversed or too large, or a file that fails to read.
    fn patch(
        &self,
        level: usize,
        x_um: [f64; 2],
        y_um: [f64; 2],
        margin: usize,
    ) -> Result<Patch, SpecimenError>;

    /// Where there is something: `[x0, x1, y0, y1]`, micrometres. `None` without limit.
    fn extent_um(&self) -> Option<[f64; 4]>;

    /// One line for a report: what it is and how large.
    fn describe(&self) -> String;
}

/// Dense colour samples: column `i`, row `j` is centred at
/// `(x0_um + i * spacing_um, y0_um - j * spacing_um)` of the specimen plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Patch {
    /// Centre of the first sample, x, micrometres.
    pub x0_um: f64,
    /// Centre of the first sample, y (up), micrometres.
    pub y0_um: f64,
    /// Distance of neighbouring samples, micrometres.
    pub spacing_um: f64,
    /// Columns.
    pub width: usize,
    /// Rows; the first has the largest y.
    pub height: usize,
    /// `3 * width * height` bytes, red first.
    pub rgb: Vec<u8>,
}

/// Why there is no such specimen or no such patch.
#[derive(thiserror::Error, Debug)]
pub enum SpecimenError {
    /// The file is not a slide or does not read.
    #[error(transparent)]
    Slide(#[from] SlideError),
    /// Nobody says how large a pixel is.
    #[error("{}: the file does not state its pixel size; give it in um per pixel, for instance 0.5 for a 20x scan", path.display())]
    MissingScale {
        /// The file.
        path: PathBuf,
    },
    /// A pixel size that is no length.
    #[error("{}: {um_per_px} um per pixel is not a pixel size; give a finite number above 0", path.display())]
    BadScale {
        /// The file.
        path: PathBuf,
        /// What was given.
        um_per_px: f64,
    },
    /// A level that the specimen does not have.
    #[error(
        "level {asked} was asked for and the specimen has {available}, counted from 0 (finest)"
    )]
    Level {
        /// The level asked for.
        asked: usize,
        /// How many there are.
        available: usize,
    },
    /// A rectangle that is reversed or not finite.
    #[error("x {x_um:?}, y {y_um:?} um is not a rectangle; give finite ends, the low end first")]
    Rectangle {
        /// x from, to, micrometres.
        x_um: [f64; 2],
        /// y from, to, micrometres.
        y_um: [f64; 2],
    },
    /// More samples than one patch may have.
    #[error(
        "{width} x {height} samples are more than the {MAX_PATCH_SAMPLES} of one patch; ask for a coarser level or a smaller rectangle"
    )]
    PatchTooLarge {
        /// Columns asked for.
        width: f64,
        /// Rows asked for.
        height: f64,
    },
}

#[cfg(test)]
mod made_tests;
#[cfg(test)]
mod tests;

//! A pattern slide, a grid of dots, squares or lines of known pitch, as a measure of what the optics do: where each period of the grid lies
//! in the image, and the map and the distortion that put it there.
//!
//! `basis` finds the two periods from how the image repeats itself, `cells` where each cell lies by the phases of its two fundamental waves,
//! `grow` goes on from the middle outwards so that no cell is counted twice or left out, `model` and `fit` solve for the map, and `light`
//! takes uneven illumination away. What is no square grid is refused ([`NoGrid`]).

mod basis;
mod cells;
mod fit;
mod grow;
mod light;
mod model;
mod types;

use basis::basis_of;
use fit::GridFit;
use grow::{Seen, look_from};
use scopeservo_features::GrayImage;
use scopeservo_geometry::Mat2;

pub use types::{Grid, NoGrid, Term};

/// So many cells of the grid must be seen, at least,
const NEEDED: usize = 6;
/// and so large a share of those that lie in the image.
const SHARE: f64 = 0.5;
/// No finer grid can be told from what the pixels make of it, pixels.
const FINEST_PX: f64 = 8.0;
/// The pitch may be this many times what is expected, or one over this, at most: sqrt 2 and 2 are mistakes.
const PITCH_FACTOR: f64 = 1.25;
/// Cells of a grid that is one lie where they should to this share of the pitch, per coordinate.
const IRREGULAR: f64 = 0.015;

/// Finds a square grid whose pitch should be about `expected_px`, turned by any angle. Its first period is the one nearest to image x.
///
/// # Errors
/// [`NoGrid`], for whatever cannot be measured with.
pub fn find_grid(image: &GrayImage, expected_px: f64) -> Result<Grid, NoGrid> {
    let basis = basis_of(image)?;
    let pitch_px = basis.det().abs().sqrt();
    if pitch_px < FINEST_PX {
        return Err(NoGrid::TooFine {
            pitch_px,
            least_px: FINEST_PX,
        });
    }
    let off = (pitch_px / expected_px).max(expected_px / pitch_px);
    if off.is_nan() || off > PITCH_FACTOR {
        return Err(NoGrid::OtherPitch {
            seen_px: pitch_px,
            expected_px,
        });
    }
    measure(image, basis)
}

/// Finds a grid again that lies elsewhere, and is turned by some hundredths of a radian at most: its periods keep their names.
///
/// # Errors
/// [`NoGrid`].
pub fn follow_grid(image: &GrayImage, before: &Grid) -> Result<Grid, NoGrid> {
    measure(image, before.pixel_from_lattice)
}

fn measure(image: &GrayImage, basis: Mat2) -> Result<Grid, NoGrid> {
    let Seen { fit, in_view } = look_from(image, basis, NEEDED)?;
    let needed = NEEDED.max((SHARE * in_view as f64).ceil() as usize);
    let grid = fit.ok_or(NoGrid::TooFewNodes { found: 0, needed })?;
    if grid.nodes < needed {
        return Err(NoGrid::TooFewNodes {
            found: grid.nodes,
            needed,
        });
    }
    let grid = as_grid(grid, in_view);
    let scatter = grid.sigma_px / grid.pitch_px();
    if scatter > IRREGULAR {
        return Err(NoGrid::Irregular {
            scatter,
            allowed: IRREGULAR,
        });
    }
    Ok(grid)
}

fn as_grid(fit: GridFit, in_view: usize) -> Grid {
    Grid {
        pixel_from_lattice: fit.model.pixel_from_lattice,
        offset_px: fit.model.offset_px,
        covariance: fit.covariance,
        distortion: fit.distortion,
        keystone: fit.keystone,
        nodes: fit.nodes,
        left_out: in_view - fit.nodes,
        sigma_px: fit.sigma_px,
    }
}

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

use basis::basis_of;
use fit::GridFit;
use grow::{Seen, look_from};
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Mat2, Vec2};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// So many cells of the grid must be seen, at least,
const NEEDED: usize = 6;
/// and so large a share of those that lie in the image.
const SHARE: f64 = 0.5;
/// No finer grid can be told from what the pixels make of it, pixels.
const FINEST_PX: f64 = 8.0;
/// The pitch may be this many times what is expected, or one over this, at most: sqrt 2 and 2 are mistakes.
const PITCH_FACTOR: f64 = 1.25;
/// One period may be so many times the other, and the angle between them so far from a right one: pixels need be neither square nor upright.
const ANISOTROPY: f64 = 1.12;
const SKEW_RAD: f64 = 0.1;
/// Cells of a grid that is one lie where they should to this share of the pitch, per coordinate.
const IRREGULAR: f64 = 0.015;

/// A number that was looked for, and whether it was seen.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Term {
    /// What the image says.
    pub value: f64,
    /// Its standard deviation; 0 when the image cannot tell.
    pub sigma: f64,
    /// Whether it is more than three standard deviations from nothing. What is not seen is left out of the map.
    pub seen: bool,
}

/// A square grid in an image.
///
/// The cell n (two whole numbers) would lie at `q = pixel_from_lattice n + offset_px` from the image's centre ((w-1)/2, (h-1)/2). A tilted
/// field puts it at `q1 = q / (1 + keystone . q / r_corner)`, distortion shows it at `q1 (1 + distortion (|q1| / r_corner)^2)`, with
/// r_corner the distance of the image's corner.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Grid {
    /// Pixels per period: its columns are the grid's two periods, px.
    pub pixel_from_lattice: Mat2,
    /// Place of the cell (0, 0) from the image's centre, px.
    pub offset_px: Vec2,
    /// Covariance of (pixel_from_lattice row-major, offset_px), px.
    pub covariance: [[f64; 6]; 6],
    /// Radial distortion: how far the corner is moved out, relative.
    pub distortion: Term,
    /// How much smaller the scale is at the corner than in the middle, along image x and y, relative: the field is tilted.
    pub keystone: [Term; 2],
    /// Cells used.
    pub nodes: usize,
    /// Cells in the image that were not: covered, missing, or elsewhere than all others.
    pub left_out: usize,
    /// Standard deviation of a cell's place, per coordinate, px.
    pub sigma_px: f64,
}

impl Grid {
    /// Length of a period, px: geometric mean of both.
    pub fn pitch_px(&self) -> f64 {
        self.pixel_from_lattice.det().abs().sqrt()
    }

    /// Place of the image's centre on the grid, in periods.
    pub fn lattice_of_centre(&self) -> Option<Vec2> {
        let inverse = self.pixel_from_lattice.inverse()?;
        Some(inverse * self.offset_px.map(|v| -v))
    }
}

/// Why an image shows no grid that could be measured with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Error)]
#[serde(tag = "no_grid", rename_all = "snake_case")]
pub enum NoGrid {
    /// Nothing repeats itself in both directions.
    #[error("nothing in the image repeats itself")]
    NothingRepeats,
    /// It does in one direction.
    #[error(
        "the image repeats itself in one direction only: lines, or a grid so coarse that too little of it is in view"
    )]
    OneDirection,
    /// Its periods are not those of squares.
    #[error(
        "the image repeats itself, but not in squares: one period is {ratio:.2} times the other, at {angle_deg:.0} deg to it"
    )]
    NotSquare {
        /// The longer over the shorter.
        ratio: f64,
        /// Between them, degrees.
        angle_deg: f64,
    },
    /// Too fine for the pixels.
    #[error(
        "the grid is too fine: its pitch is {pitch_px:.1} pixels, and {least_px:.0} are needed"
    )]
    TooFine {
        /// As seen.
        pitch_px: f64,
        /// Needed.
        least_px: f64,
    },
    /// The pitch is another one.
    #[error("the grid has a pitch of {seen_px:.1} pixels where {expected_px:.1} are expected")]
    OtherPitch {
        /// As seen.
        seen_px: f64,
        /// By the pitch and the nominal scale.
        expected_px: f64,
    },
    /// Too little of it is seen.
    #[error("{found} cells of the grid can be measured, and {needed} are needed")]
    TooFewNodes {
        /// Seen.
        found: usize,
        /// Needed.
        needed: usize,
    },
    /// Its cells do not lie where they should.
    #[error(
        "the grid is irregular: its cells lie {:.1} % of the pitch off, and {:.1} % are allowed", 100.0 * scatter, 100.0 * allowed
    )]
    Irregular {
        /// Standard deviation per coordinate over the pitch.
        scatter: f64,
        /// The most.
        allowed: f64,
    },
}

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
    let Seen { fit, in_view } = look_from(image, basis)?;
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

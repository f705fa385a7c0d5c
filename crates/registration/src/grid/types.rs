//! What a grid is, and why an image shows none.

use scopeservo_geometry::{Mat2, Vec2};
use serde::{Deserialize, Serialize};
use thiserror::Error;

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

//! What can be wrong with an image.

use thiserror::Error;

/// Why an image could not be unpacked.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum PictureError {
    /// It breaks off.
    #[error("the image breaks off after {bytes} bytes")]
    Cut {
        /// How much of it there is.
        bytes: usize,
    },
    /// A part in its middle is missing or damaged.
    #[error("the image has a hole: its data make no sense after {part} of {of} parts")]
    Hole {
        /// How many parts there are before it.
        part: usize,
        /// How many there should be.
        of: usize,
    },
    /// It is of no kind that is known, or damaged.
    #[error("the image cannot be read: {0}")]
    Unreadable(String),
    /// It has more or fewer bytes than its size needs.
    #[error("the image has {bytes} bytes where {needed} are needed")]
    Size {
        /// How many there are.
        bytes: usize,
        /// How many are needed.
        needed: usize,
    },
}

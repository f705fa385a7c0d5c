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

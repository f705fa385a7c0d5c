//! What can be wrong with a description of a twin.

use thiserror::Error;

/// Why a simulated microscope cannot be built.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum TwinError {
    /// A setting makes no sense.
    #[error("{what}")]
    BadConfig {
        /// The field and what it must be.
        what: String,
    },
}

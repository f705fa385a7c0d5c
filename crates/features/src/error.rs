//! What can go wrong with features.

use scopeservo_sift::SiftError;
use thiserror::Error;

/// Why there are no features, or why they cannot be compared.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FeatureError {
    /// The image, the settings or the descriptors are none that the engine can take.
    #[error(transparent)]
    Sift(#[from] SiftError),
    /// Descriptors of two engines mean different things.
    #[error(
        "features of the engine {query} cannot be compared with those of {train}; make one of them again from its image"
    )]
    OtherEngine {
        /// The engine of the one.
        query: String,
        /// The engine of the other.
        train: String,
    },
    /// Stored features are damaged.
    #[error("the features are damaged: {0}; make them again from the image")]
    Damaged(String),
    /// An engine failed for a reason of its own.
    #[error("the engine {engine} failed: {why}")]
    Engine {
        /// Its name.
        engine: String,
        /// What it says.
        why: String,
    },
}

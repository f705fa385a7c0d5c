//! Features of an image, whichever engine finds them.
//!
//! A [`FeatureEngine`] finds [`Features`]: keypoints, and descriptors that any engine may shape as it likes (bytes, bits or real numbers).
//! Features can be compared when their engines have the same name, and be kept without the image. An engine is one file: one
//! function is enough, as exact matching comes with the trait. [`conformance`] tries any engine on known warps and on images that
//! are empty, constant, tiny or of 16 bits. The engine of this project is SIFT ([`SiftEngine`]); an [`Engine`] is a handle to any.
//!
//! Images, keypoints and matches have the types of the SIFT library, which stands on its own.

#![cfg_attr(
    not(test),
    warn(
        clippy::disallowed_methods,
        clippy::disallowed_types,
        clippy::disallowed_macros
    )
)]
#![warn(clippy::too_many_lines)]

mod brute;
mod bytes;
pub mod conformance;
mod descriptors;
mod engine;
mod error;
mod features;
mod handle;
mod mask;
mod sift_engine;

pub use brute::match_brute_force;
pub use descriptors::Descriptors;
pub use engine::{EngineInfo, FeatureEngine};
pub use error::FeatureError;
pub use features::Features;
pub use handle::Engine;
pub use mask::Mask;
pub use scopeservo_sift::{
    Gate, GrayImage, Keypoint, Match, MatchOptions, SiftError as ImageError, noise_sigma,
};
pub use sift_engine::SiftEngine;

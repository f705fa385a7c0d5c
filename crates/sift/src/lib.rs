//! SIFT features: detect, orient, describe, match (Lowe, *Distinctive Image Features from Scale-Invariant Keypoints*, IJCV 2004),
//! with RootSIFT descriptors (Arandjelovic & Zisserman, CVPR 2012). Knows no microscope and no geometry.
//!
//! A [`Sift`] is made once and keeps its buffers from image to image; [`detect_and_describe`] is the short form for one image, and
//! [`match_features`] compares two sets. [`Features`] are a value to keep.
//!
//! The stages, in the order of the data: `contrast` (how strong an extremum must be), `scale_space` (an octave of Gaussians in one
//! sweep, with `blur`), `detect` (extrema, refined below a pixel, while the rows are in the cache), `orient`, `describe`, then
//! `matching`; `engine` walks through them.
//!
//! Coordinates: integer coordinates are pixel centres, x along the row, y down, angles from +x towards +y. The doubled first
//! octave and the decimated later ones keep this grid exactly, so positions carry no constant offset.
//!
//! Every stage is one source, compiled for each [`Level`] of vector instructions and chosen at run time; [`Sift::with`] and
//! [`match_features_at`] force one. Results are the same bits on any number of threads. Between levels they differ by rounding.
//!
//! ```
//! use scopeservo_sift::{GrayImage, MatchOptions, Options, detect_and_describe, match_features};
//!
//! let blobs = |x: f32, y: f32| (0.3 * x).sin() * (0.4 * y).cos() + (0.13 * x + 0.21 * y).sin();
//! let here = GrayImage::from_fn(120, 100, |x, y| blobs(x as f32, y as f32))?;
//! let moved = GrayImage::from_fn(120, 100, |x, y| blobs(x as f32 + 2.5, y as f32))?;
//! let here = detect_and_describe(&here, &Options::default())?;
//! let moved = detect_and_describe(&moved, &Options::default())?;
//! for m in match_features(&here, &moved, &MatchOptions::default()) {
//!     let (a, b) = (here.keypoints[m.query], moved.keypoints[m.train]);
//!     let _shift = (b.x - a.x, b.y - a.y); // mostly (-2.5, 0)
//! }
//! # Ok::<(), scopeservo_sift::SiftError>(())
//! ```

#![warn(clippy::too_many_lines)]
#![cfg_attr(
    not(test),
    warn(
        clippy::disallowed_methods,
        clippy::disallowed_types,
        clippy::disallowed_macros
    )
)]
#![allow(
    clippy::needless_range_loop,
    reason = "kernels walk several arrays of vectors side by side, and closures would hide from the compiler which instructions it may use"
)]

mod aligned;
mod blur;
mod contrast;
mod describe;
mod descriptor;
mod detect;
mod engine;
mod error;
mod features;
mod gradient;
mod image;
mod level;
mod matching;
mod options;
mod orient;
mod scale_space;
mod simd;

pub use contrast::noise_sigma;
pub use descriptor::Descriptor;
pub use engine::{Sift, detect_and_describe};
pub use error::SiftError;
pub use features::{Features, Keypoint};
pub use image::GrayImage;
pub use level::Level;
pub use matching::{
    Gate, Match, MatchOptions, match_features, match_features_at, match_features_gated,
};
pub use options::Options;
pub use simd::Simd;

//! What can go wrong before or after the arithmetic. The arithmetic itself does not fail: an image without features gives
//! empty [`Features`](crate::Features).

use crate::Level;

/// An input that this crate refuses, with what it found and what it needs.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SiftError {
    /// An image without pixels.
    #[error("an image needs at least one row and one column, got {width} x {height}")]
    EmptyImage {
        /// Columns asked for.
        width: usize,
        /// Rows asked for.
        height: usize,
    },
    /// The pixel buffer does not hold `width * height` values.
    #[error(
        "an image of {width} x {height} pixels needs width * height values, got {found}; rows with padding go through `GrayImage::from_rows`"
    )]
    DataLength {
        /// Columns asked for.
        width: usize,
        /// Rows asked for.
        height: usize,
        /// Values in the buffer.
        found: usize,
    },
    /// Rows that would overlap.
    #[error(
        "rows of {width} pixels cannot begin every {stride} values; the stride is at least the width"
    )]
    Stride {
        /// Columns asked for.
        width: usize,
        /// Values from the begin of a row to that of the next.
        stride: usize,
    },
    /// The pixel buffer ends before the last row does.
    #[error(
        "an image of {width} x {height} pixels with a stride of {stride} needs (height - 1) * stride + width values, got {found}"
    )]
    DataTooShort {
        /// Columns asked for.
        width: usize,
        /// Rows asked for.
        height: usize,
        /// Values from the begin of a row to that of the next.
        stride: usize,
        /// Values in the buffer.
        found: usize,
    },
    /// An image for which there is no memory.
    #[error("there is no memory for an image of {width} x {height} pixels")]
    TooLarge {
        /// Columns asked for.
        width: usize,
        /// Rows asked for.
        height: usize,
    },
    /// A pixel is NaN or infinite.
    #[error(
        "pixel ({x}, {y}) is {value}; replace values that are not finite before detecting features"
    )]
    NotFinite {
        /// Column of the first such pixel.
        x: usize,
        /// Row of the first such pixel.
        y: usize,
        /// The value found.
        value: f32,
    },
    /// A pixel beyond [`GrayImage::GREATEST`](crate::GrayImage::GREATEST).
    #[error(
        "pixel ({x}, {y}) is {value:e}; scale the image so that no value exceeds 1e12 in size, best to 0..=1"
    )]
    TooGreat {
        /// Column of the first such pixel.
        x: usize,
        /// Row of the first such pixel.
        y: usize,
        /// The value found.
        value: f32,
    },
    /// An option outside its range.
    #[error("option `{name}` is {value}; it must be {need}")]
    Option {
        /// Field of [`Options`](crate::Options).
        name: &'static str,
        /// The value found.
        value: f64,
        /// The range in words.
        need: &'static str,
    },
    /// An instruction set that this processor does not have.
    #[error("this processor has no {level}; ask for the best level instead of a certain one")]
    LevelUnavailable {
        /// The level asked for.
        level: Level,
    },
    /// Features, usually deserialised ones, with unequal numbers of keypoints and descriptors.
    #[error(
        "features hold {keypoints} keypoints but {descriptors} descriptors; the stored file is damaged, detect again"
    )]
    FeatureLengths {
        /// Number of keypoints.
        keypoints: usize,
        /// Number of descriptors.
        descriptors: usize,
    },
    /// Descriptor components that are too large.
    #[error(
        "a descriptor's components must not exceed 127 nor their squares sum to more than 65535, got {greatest} and {norm_sq}; detect again"
    )]
    DescriptorRange {
        /// Greatest component.
        greatest: u8,
        /// Sum of squared components.
        norm_sq: u32,
    },
    /// A keypoint that is not finite, has no size or lies outside its image.
    #[error(
        "keypoint {index} is not finite, has no size or lies outside its image; the stored file is damaged, detect again"
    )]
    BadKeypoint {
        /// Index of the first such keypoint.
        index: usize,
    },
    /// A keypoint that an engine with these options could not have found in this image.
    #[error(
        "keypoint {index} lies outside the image, or its octave, layer, size or angle are none that these options give; describe keypoints that were detected with the same options"
    )]
    ForeignKeypoint {
        /// Index of the first such keypoint.
        index: usize,
    },
}

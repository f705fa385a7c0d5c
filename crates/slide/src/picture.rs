//! Pictures from memory: what a camera sent, what a target holds.

use crate::choice::Choice;
use crate::input::Input;
use crate::layout::Values;
use crate::source::Source;
use crate::{Alpha, Budget, Fault};

/// How a picture is read.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wanted {
    /// Which image.
    pub choice: Choice,
    /// What becomes of opacity.
    pub alpha: Alpha,
    /// The memory that it may take.
    pub budget: Budget,
}

/// A picture in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Columns, as it is shown.
    pub width: usize,
    /// Rows, as it is shown.
    pub height: usize,
    /// 1 for grey, 3 for colour.
    pub channels: usize,
    /// `width * height * channels` values, row by row, interleaved, on the whole range of their type.
    pub samples: Samples,
    /// Its samples have no range of their own, as real numbers; black and white were estimated from this picture.
    pub range_was_estimated: bool,
}

/// The samples of a picture.
#[derive(Clone, Debug, PartialEq)]
pub enum Samples {
    /// 8 bits.
    U8(Vec<u8>),
    /// More: up to 16 bits are kept; real numbers and those of 32 bits lie on a range that a few extreme ones do not set.
    U16(Vec<u16>),
}

/// Unpacks a PNG, JPEG, JPEG 2000 or TIFF.
///
/// # Errors
/// [`Fault`].
pub fn decode(bytes: &[u8], wanted: &Wanted) -> Result<Picture, Fault> {
    let source = Source::open(
        Input::Bytes(bytes),
        wanted.choice,
        wanted.budget,
        wanted.alpha,
    )?;
    let (width, height, channels, values) = source.deep(0)?;
    Ok(Picture {
        width,
        height,
        channels,
        samples: match values {
            Values::U8(v) => Samples::U8(v),
            Values::U16(v) => Samples::U16(v),
        },
        range_was_estimated: source.tiff().is_some_and(|t| t.layout(0).has_no_range()),
    })
}

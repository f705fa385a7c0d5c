//! Pictures from memory: what a camera sent, what a target holds.

use crate::input::Input;
use crate::layout::Values;
use crate::source::Source;
use crate::{Alpha, Budget, Fault};

/// Which image of a file is looked at. Without a wish: the finest one, or the first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Choice {
    /// A page, counted from 0.
    pub page: Option<usize>,
    /// A channel, counted from 0.
    pub channel: Option<usize>,
}

/// What there was to choose from, and what is looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Choices {
    /// How many images there are as pages, reduced ones not counted.
    pub pages: usize,
    /// The page that is looked at.
    pub page: usize,
    /// The names of the channels, empty where there is none; no channel: there is nothing to choose.
    pub channels: Vec<String>,
    /// The channel that is looked at.
    pub channel: usize,
}

impl Default for Choices {
    fn default() -> Self {
        Self {
            pages: 1,
            page: 0,
            channels: Vec::new(),
            channel: 0,
        }
    }
}

impl Choices {
    /// In words, where there is a choice: what there is, and what is looked at.
    #[must_use]
    pub fn told(&self) -> Option<String> {
        let n = self.channels.len();
        if n > 1 {
            let named = |(k, name): (usize, &String)| match name.as_str() {
                "" => format!("{k}"),
                name => format!("{k} {name}"),
            };
            let names: Vec<String> = self
                .channels
                .iter()
                .enumerate()
                .take(16)
                .map(named)
                .collect();
            let pages = match self.pages > n {
                true => format!(" on {} pages", self.pages),
                false => String::new(),
            };
            return Some(format!(
                "{n} channels ({}){pages}; looking at channel {}, page {}",
                names.join(", "),
                self.channel,
                self.page
            ));
        }
        let told = || format!("{} pages; looking at page {}", self.pages, self.page);
        (self.pages > 1).then(told)
    }
}

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

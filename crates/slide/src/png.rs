//! PNG, row by row: an image of any size takes no more memory than what is asked of it.

use std::io::BufReader;

use png::{
    BitDepth, ColorType, DecodeOptions, Decoder, DecodingError, Limits, Reader, Transformations,
};

use crate::input::{Input, Part};
use crate::layout::{Alpha, Colour, Kind, Layout, Opacity};
use crate::orientation::{self, Orientation};
use crate::raster::over_white;
use crate::sink::{Place, Sink};
use crate::{Budget, Fault};

/// First column and row of each pass of an interlaced image, and the steps to the next ones.
const PASSES: [[u32; 4]; 7] = [
    [0, 0, 8, 8],
    [4, 0, 8, 8],
    [0, 4, 4, 8],
    [2, 0, 4, 4],
    [0, 2, 2, 4],
    [1, 0, 2, 2],
    [0, 1, 1, 2],
];

/// What the head of a PNG says.
#[derive(Debug)]
pub(crate) struct Png {
    pub(crate) place: Place,
    pub(crate) layout: Layout,
}

type Source<'i, 'a> = BufReader<Part<'i, 'a>>;

fn reader<'i, 'a>(input: &'i Input<'a>, budget: Budget) -> Result<Reader<Source<'i, 'a>>, Fault> {
    let mut options = DecodeOptions::default();
    // What is not looked at is not unpacked either: a profile of some kilobytes may claim any size.
    options.set_ignore_iccp_chunk(true);
    options.set_ignore_text_chunk(true);
    let source = BufReader::with_capacity(1 << 16, input.part(0, input.length()));
    let mut decoder = Decoder::new_with_options(source, options);
    decoder.set_limits(Limits {
        bytes: usize::try_from(budget.bytes).unwrap_or(usize::MAX),
    });
    decoder.set_transformations(Transformations::IDENTITY);
    decoder.read_info().map_err(fault)
}

impl Png {
    pub(crate) fn open(input: &Input<'_>, budget: Budget, alpha: Alpha) -> Result<Self, Fault> {
        let reader = reader(input, budget)?;
        let info = reader.info();
        crate::error::check_not_empty(info.width, info.height)?;
        let bits = match info.bit_depth {
            BitDepth::One => 1,
            BitDepth::Two => 2,
            BitDepth::Four => 4,
            BitDepth::Eight => 8,
            BitDepth::Sixteen => 16,
        };
        let (samples, colour, opacity) = match info.color_type {
            ColorType::Grayscale => (1, Colour::Gray, Opacity::Opaque),
            ColorType::GrayscaleAlpha => (2, Colour::Gray, Opacity::Straight),
            ColorType::Rgb => (3, Colour::Rgb, Opacity::Opaque),
            ColorType::Rgba => (4, Colour::Rgb, Opacity::Straight),
            ColorType::Indexed => {
                let colours = info.palette.as_deref().unwrap_or_default();
                let opacity = info.trns.as_deref().unwrap_or_default();
                (
                    1,
                    Colour::Palette(palette(colours, opacity, alpha)),
                    Opacity::Opaque,
                )
            }
        };
        let clear = info
            .trns
            .as_deref()
            .filter(|_| info.color_type != ColorType::Indexed);
        let clear = clear.map(|key| {
            key.as_chunks::<2>()
                .0
                .iter()
                .map(|v| u16::from_be_bytes(*v))
                .collect()
        });
        let orientation = match &info.exif_metadata {
            Some(exif) => orientation::of_exif(exif),
            None => Orientation::default(),
        };
        Ok(Self {
            place: Place {
                stored: [info.width, info.height],
                orientation,
            },
            layout: Layout {
                bits,
                kind: Kind::Unsigned,
                samples,
                colour,
                opacity,
                alpha,
                big_endian: true,
                clear,
                only: None,
                range: [0.0, 1.0],
            },
        })
    }

    pub(crate) fn decode(
        &self,
        input: &Input<'_>,
        budget: Budget,
        sink: &mut dyn Sink,
    ) -> Result<(), Fault> {
        let mut reader = reader(input, budget)?;
        let [width, height] = self.place.stored;
        let whole = [[0, 0, 1, 1]];
        let passes: &[[u32; 4]] = match reader.info().interlaced {
            true => &PASSES,
            false => &whole,
        };
        let mut row = vec![0; self.layout.row_bytes(width, self.layout.samples) as usize];
        for &[x0, y0, dx, dy] in passes {
            let n = width.saturating_sub(x0).div_ceil(dx);
            if n == 0 {
                continue;
            }
            for y in (y0..height).step_by(dy as usize) {
                if reader.read_row(&mut row).map_err(fault)?.is_none() {
                    return Err(Fault::Truncated("rows are missing".into()));
                }
                let bytes = self.layout.row_bytes(n, self.layout.samples) as usize;
                sink.row(x0, y, dx, &self.layout.row(&row[..bytes], n as usize)?);
            }
        }
        // To the end of the data and its checksums.
        reader.read_row(&mut row).map_err(fault)?;
        Ok(())
    }
}

fn palette(colours: &[u8], opacity: &[u8], alpha: Alpha) -> Vec<[u8; 3]> {
    let colours = colours.as_chunks::<3>().0.iter().enumerate();
    colours
        .map(|(i, c)| match (opacity.get(i), alpha) {
            (Some(&a), Alpha::OverWhite) => c.map(|v| over_white(v.into(), a.into(), 255) as u8),
            _ => *c,
        })
        .collect()
}

fn fault(e: DecodingError) -> Fault {
    match e {
        DecodingError::IoError(e) => e.into(),
        DecodingError::LimitsExceeded => {
            Fault::Damaged("the header asks for more memory than any image needs".into())
        }
        other => {
            let why = other.to_string();
            match why.to_lowercase().contains("eof") || why.contains("end of") {
                true => Fault::Truncated("the data ends inside the image".into()),
                false => Fault::Damaged(why),
            }
        }
    }
}

//! JPEG: proved whole, then decoded in one piece, or by the means of its blocks where it is to be reduced eight times or more.

mod codes;
mod scans;
mod whole;

use std::borrow::Cow;

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;
use zune_jpeg::errors::DecodeErrors;

use crate::layout::{Row, Values};
use crate::orientation;
use crate::sink::{Place, Sink};
use crate::{Budget, Fault};
use whole::Plan;

/// Side of a block.
const BLOCK: usize = 8;

/// What colours a JPEG decodes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Colours {
    /// Grey or RGB, as it is.
    Own,
    /// Grey: the luma that is stored.
    Luma,
    /// The components without any conversion: a TIFF may hold RGB in a JPEG that does not say so.
    Unconverted,
}

/// A JPEG that is all there.
#[derive(Debug)]
pub(crate) struct Jpeg<'a> {
    bytes: Cow<'a, [u8]>,
    plan: Option<Plan>,
    space: ColorSpace,
    pub(crate) place: Place,
}

type Decoder<'b> = JpegDecoder<ZCursor<&'b [u8]>>;

fn decoder(bytes: &[u8]) -> Result<Decoder<'_>, Fault> {
    // Strict, so that a scan that ends early is an error and not grey.
    let options = DecoderOptions::default()
        .set_max_width(usize::from(u16::MAX))
        .set_max_height(usize::from(u16::MAX))
        .set_strict_mode(true);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(fault)?;
    Ok(decoder)
}

impl<'a> Jpeg<'a> {
    /// Looks through the whole stream.
    pub(crate) fn open(bytes: impl Into<Cow<'a, [u8]>>, budget: Budget) -> Result<Self, Fault> {
        let whole = whole::whole(bytes, budget)?;
        let mut opened = Self {
            plan: whole.plan,
            space: ColorSpace::Unknown,
            place: Place {
                stored: [0, 0],
                orientation: orientation::Orientation::default(),
            },
            bytes: whole.bytes,
        };
        let decoder = decoder(&opened.bytes)?;
        let unknown = || Fault::Damaged("it has no size".into());
        let (width, height) = decoder.dimensions().ok_or_else(unknown)?;
        let stored = [width as u32, height as u32];
        let orientation = decoder.exif().map(|e| orientation::of_exif(e));
        let space = decoder.input_colorspace().ok_or_else(unknown)?;
        drop(decoder);
        crate::error::check_not_empty(stored[0], stored[1])?;
        opened.space = space;
        opened.place = Place {
            stored,
            orientation: orientation.unwrap_or_default(),
        };
        Ok(opened)
    }

    /// 1 for grey, 3 for colour.
    pub(crate) fn channels(&self) -> usize {
        match self.space.num_components() {
            0..=2 => 1,
            _ => 3,
        }
    }

    /// Bytes that decoding holds, the file included.
    fn bytes_held(&self, channels: usize) -> u64 {
        let pixels = u64::from(self.place.stored[0]) * u64::from(self.place.stored[1]);
        let coefficients = match self.plan {
            Some(_) => 0,
            None => 2 * self.space.num_components() as u64 * pixels,
        };
        self.bytes.len() as u64 + coefficients + channels as u64 * pixels
    }

    /// Samples of 8 bits, interleaved, and how many there are of a pixel. `more`: bytes that the caller holds at the same time.
    pub(crate) fn samples(
        &self,
        colours: Colours,
        budget: Budget,
        more: u64,
    ) -> Result<(Vec<u8>, usize), Fault> {
        let (space, channels) = match (colours, self.space) {
            (_, ColorSpace::Luma) => (ColorSpace::Luma, 1),
            (Colours::Luma, ColorSpace::YCbCr) => (ColorSpace::Luma, 1),
            (Colours::Unconverted, ColorSpace::YCbCr) => (ColorSpace::YCbCr, 3),
            (Colours::Unconverted, ColorSpace::CMYK) => (ColorSpace::CMYK, 4),
            (_, ColorSpace::MultiBand(_)) => {
                return Err(Fault::Unsupported("a JPEG of two components".into()));
            }
            _ => (ColorSpace::RGB, 3),
        };
        budget.check(
            self.place.stored,
            self.bytes_held(channels).saturating_add(more),
        )?;
        let mut decoder = decoder(&self.bytes)?;
        decoder.set_options(decoder.options().jpeg_set_out_colorspace(space));
        let samples = decoder.decode().map_err(fault)?;
        let [width, height] = self.place.stored.map(|n| n as usize);
        match samples.len() == width * height * channels {
            true => Ok((samples, channels)),
            false => Err(Fault::Damaged("it decodes to another size".into())),
        }
    }

    /// All rows, or those of one of the colours.
    pub(crate) fn decode(
        &self,
        colours: Colours,
        only: Option<usize>,
        budget: Budget,
        more: u64,
        sink: &mut dyn Sink,
    ) -> Result<(), Fault> {
        let (samples, n) = self.samples(colours, budget, more)?;
        let row_bytes = self.place.stored[0] as usize * n;
        for (y, row) in samples.chunks_exact(row_bytes).enumerate() {
            let (channels, values) = match only {
                Some(k) => (1, row.iter().skip(k).step_by(n).copied().collect()),
                None => (n, row.to_vec()),
            };
            let values = Values::U8(values);
            sink.row(0, y as u32, 1, &Row { channels, values });
        }
        Ok(())
    }

    /// The place of the image reduced eight times, where it can be had without decoding.
    pub(crate) fn eighth(&self) -> Option<Place> {
        let luma = matches!(self.space, ColorSpace::Luma | ColorSpace::YCbCr);
        let plan = self.plan.as_ref()?;
        let stored = self.place.stored.map(|n| n / BLOCK as u32);
        let whole = luma && plan.is_full_size() && self.place.orientation.is_upright();
        (whole && !stored.contains(&0)).then_some(Place {
            stored,
            orientation: self.place.orientation,
        })
    }

    /// The luma of that image, block by block.
    pub(crate) fn decode_eighth(&self, place: Place, sink: &mut dyn Sink) -> Result<(), Fault> {
        let Some(plan) = &self.plan else {
            return Ok(());
        };
        let [width, height] = place.stored.map(|n| n as usize);
        plan.walk(&self.bytes, |[x, y], mean| {
            if x < width && y < height {
                let level = (f64::from(mean) * 65535.0 / 2040.0).round();
                let values = Values::U16(vec![level.clamp(0.0, 65535.0) as u16]);
                let channels = 1;
                sink.row(x as u32, y as u32, 1, &Row { channels, values });
            }
        })
    }
}

fn fault(e: DecodeErrors) -> Fault {
    match e {
        DecodeErrors::Unsupported(what) => {
            Fault::Unsupported(format!("this kind of JPEG ({what:?})"))
        }
        DecodeErrors::ExhaustedData => Fault::Truncated("the data ends inside the image".into()),
        other => Fault::Damaged(format!("{other:?}")),
    }
}

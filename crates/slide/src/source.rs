//! A picture of any format: opened, told by its first bytes, and decoded into whatever takes its rows.

use std::io::Read;

use crate::input::Input;
use crate::jpeg::{Colours, Jpeg};
use crate::jpeg2000;
use crate::layout::{Alpha, Row, Values};
use crate::orientation::Orientation;
use crate::png::Png;
use crate::sink::{DeepSink, GraySink, Place, RgbSink, Sink};
use crate::tiff::Tiff;
use crate::{Budget, Choice, Choices, Fault, Gray, MAX_PIXELS, Rgb8};

/// A picture that was opened.
#[derive(Debug)]
pub(crate) struct Source<'a> {
    pub(crate) input: Input<'a>,
    pub(crate) budget: Budget,
    alpha: Alpha,
    /// The colour that is looked at alone, of a format that has no channels of its own.
    only: Option<usize>,
    format: Format<'a>,
}

#[derive(Debug)]
enum Format<'a> {
    Png(Png),
    Jpeg(Jpeg<'a>),
    Jpeg2000(Decoded),
    Tiff(Tiff),
}

/// Samples of 8 bits, interleaved.
#[derive(Debug)]
struct Decoded {
    samples: Vec<u8>,
    channels: usize,
    place: Place,
}

impl<'a> Source<'a> {
    pub(crate) fn open(
        input: Input<'a>,
        choice: Choice,
        budget: Budget,
        alpha: Alpha,
    ) -> Result<Self, Fault> {
        let format = match sniff(&input)? {
            Kind::Png => Format::Png(Png::open(&input, budget, alpha)?),
            Kind::Jpeg => Format::Jpeg(match &input {
                Input::Bytes(bytes) => Jpeg::open(*bytes, budget)?,
                Input::File { .. } => Jpeg::open(all(&input, budget)?, budget)?,
            }),
            Kind::Jpeg2000 => {
                let bytes = all(&input, budget)?;
                let (samples, stored, channels) = jpeg2000::decode(&bytes, budget)?;
                Format::Jpeg2000(Decoded {
                    samples,
                    channels,
                    place: Place {
                        stored,
                        orientation: Orientation::default(),
                    },
                })
            }
            Kind::Tiff => Format::Tiff(Tiff::open(&input, choice, budget, alpha)?),
        };
        let mut opened = Self {
            input,
            budget,
            alpha,
            only: None,
            format,
        };
        if !matches!(opened.format, Format::Tiff(_)) {
            opened.choose(choice)?;
        }
        Ok(opened)
    }

    /// A format of one page, of which one colour may be looked at.
    fn choose(&mut self, choice: Choice) -> Result<(), Fault> {
        let there = match &self.format {
            Format::Png(png) => png.layout.colour.samples(),
            Format::Jpeg(jpeg) => jpeg.channels(),
            Format::Jpeg2000(decoded) => decoded.channels,
            Format::Tiff(_) => return Ok(()),
        };
        for (what, asked, available) in
            [("page", choice.page, 1), ("channel", choice.channel, there)]
        {
            if let Some(asked) = asked.filter(|asked| *asked >= available) {
                return Err(Fault::NotThere {
                    what,
                    asked,
                    available,
                });
            }
        }
        self.only = choice.channel.filter(|_| there > 1);
        if let Format::Png(png) = &mut self.format {
            png.layout.only = self.only;
        }
        Ok(())
    }

    pub(crate) fn tiff(&self) -> Option<&Tiff> {
        match &self.format {
            Format::Tiff(tiff) => Some(tiff),
            _ => None,
        }
    }

    pub(crate) fn levels(&self) -> usize {
        self.tiff().map_or(1, Tiff::levels)
    }

    pub(crate) fn check_level(&self, asked: usize) -> Result<(), Fault> {
        let available = self.levels();
        match asked < available {
            true => Ok(()),
            false => Err(Fault::NotThere {
                what: "level",
                asked,
                available,
            }),
        }
    }

    pub(crate) fn um_per_px(&self) -> Option<f64> {
        self.tiff().and_then(|t| t.um_per_px)
    }

    pub(crate) fn choices(&self) -> Choices {
        self.tiff()
            .map_or_else(Choices::default, |t| t.choices.clone())
    }

    pub(crate) fn place(&self, level: usize) -> Place {
        match &self.format {
            Format::Png(png) => png.place,
            Format::Jpeg(jpeg) => jpeg.place,
            Format::Jpeg2000(decoded) => decoded.place,
            Format::Tiff(tiff) => tiff.place(level),
        }
    }

    /// Channels, 1 or 3, and bits, 8 or 16.
    fn shape(&self, level: usize) -> (usize, u8) {
        match &self.format {
            Format::Png(png) => (png.layout.channels(), png.layout.depth()),
            Format::Jpeg(jpeg) if self.only.is_none() => (jpeg.channels(), 8),
            Format::Jpeg2000(decoded) if self.only.is_none() => {
                (if decoded.channels < 3 { 1 } else { 3 }, 8)
            }
            Format::Jpeg(_) | Format::Jpeg2000(_) => (1, 8),
            Format::Tiff(tiff) => (tiff.layout(level).channels(), tiff.layout(level).depth()),
        }
    }

    fn decode(
        &self,
        level: usize,
        colours: Colours,
        held: u64,
        sink: &mut dyn Sink,
    ) -> Result<(), Fault> {
        match &self.format {
            Format::Png(png) => png.decode(&self.input, self.budget, sink),
            Format::Jpeg(jpeg) => jpeg.decode(colours, self.only, self.budget, held, sink),
            Format::Jpeg2000(decoded) => decoded.decode(self.only, self.alpha, sink),
            Format::Tiff(tiff) => tiff.decode(&self.input, level, self.budget, sink),
        }
    }

    /// No more pixels than can be gone through, and no more bytes than there may be.
    fn check(&self, level: usize, bytes: u64) -> Result<(), Fault> {
        let [w, h] = self.place(level).shown();
        if u64::from(w) * u64::from(h) > MAX_PIXELS {
            return self.budget.check([w, h], u64::MAX);
        }
        self.budget.check([w, h], bytes)
    }

    /// A whole level in colour of 8 bits. What the file says nothing of has the colour `outside`.
    pub(crate) fn rgb8(&self, level: usize, outside: [u8; 3]) -> Result<Rgb8, Fault> {
        let place = self.place(level);
        let [width, height] = place.shown();
        let bytes = 3 * u64::from(width) * u64::from(height);
        self.check(level, bytes)?;
        if let (Format::Jpeg(jpeg), true, (3, _)) = (
            &self.format,
            place.orientation.is_upright(),
            self.shape(level),
        ) {
            let (data, _) = jpeg.samples(Colours::Own, self.budget, 0)?;
            return Ok(Rgb8 {
                width,
                height,
                data,
            });
        }
        let mut sink = RgbSink::new(place, outside);
        self.decode(level, Colours::Own, bytes, &mut sink)?;
        Ok(sink.out)
    }

    /// A whole level in grey, reduced to at most `most` pixels, and by what factor.
    pub(crate) fn gray(&self, level: usize, most: u64) -> Result<(Gray, usize), Fault> {
        let place = self.place(level);
        let [width, height] = place.shown();
        let fits = |f: &u64| (u64::from(width) / f) * (u64::from(height) / f) <= most;
        let factor = (1..)
            .find(fits)
            .unwrap_or(1)
            .min(u64::from(width.min(height)));
        let factor = factor as usize;
        if let (Format::Jpeg(jpeg), 8.., None) = (&self.format, factor, self.only)
            && let Some(eighth) = jpeg.eighth()
        {
            let more = factor.div_ceil(8);
            self.check(level, GraySink::bytes(eighth, more))?;
            let mut sink = GraySink::new(eighth, more);
            jpeg.decode_eighth(eighth, &mut sink)?;
            return Ok((sink.finish(), 8 * more));
        }
        let bytes = GraySink::bytes(place, factor);
        self.check(level, bytes)?;
        let mut sink = GraySink::new(place, factor);
        // The luma that a JPEG stores differs from that of its colours where these are clipped, which means of blocks do not show.
        let colours = match self.only.is_none() && factor > 1 {
            true => Colours::Luma,
            false => Colours::Own,
        };
        self.decode(level, colours, bytes, &mut sink)?;
        Ok((sink.finish(), factor))
    }

    /// A whole level with all its channels and its depth: columns, rows, channels, samples.
    pub(crate) fn deep(&self, level: usize) -> Result<(usize, usize, usize, Values), Fault> {
        let (channels, depth) = self.shape(level);
        let place = self.place(level);
        let [width, height] = place.shown();
        let bytes = u64::from(width) * u64::from(height) * channels as u64 * u64::from(depth / 8);
        self.check(level, bytes)?;
        let mut sink = DeepSink::new(place, channels, depth);
        self.decode(level, Colours::Own, bytes, &mut sink)?;
        Ok((width as usize, height as usize, channels, sink.values))
    }
}

impl Decoded {
    fn decode(&self, only: Option<usize>, alpha: Alpha, sink: &mut dyn Sink) -> Result<(), Fault> {
        use crate::layout::{Colour, Kind as Number, Layout, Opacity};
        let (colour, opacity) = match self.channels {
            1 => (Colour::Gray, Opacity::Opaque),
            2 => (Colour::Gray, Opacity::Straight),
            3 => (Colour::Rgb, Opacity::Opaque),
            _ => (Colour::Rgb, Opacity::Straight),
        };
        let layout = Layout {
            bits: 8,
            kind: Number::Unsigned,
            samples: self.channels,
            colour,
            opacity,
            alpha,
            big_endian: true,
            clear: None,
            only,
            range: [0.0, 1.0],
        };
        let width = self.place.stored[0] as usize;
        for (y, row) in self.samples.chunks_exact(width * self.channels).enumerate() {
            let row: Row = layout.row(row, width)?;
            sink.row(0, y as u32, 1, &row);
        }
        Ok(())
    }
}

/// All bytes of a file that is decoded in one piece.
fn all(input: &Input<'_>, budget: Budget) -> Result<Vec<u8>, Fault> {
    match input.length() <= budget.bytes {
        true => input.bytes(0, input.length()),
        false => Err(Fault::NotAnImage(format!(
            "its {} bytes are more than such an image can need",
            input.length()
        ))),
    }
}

enum Kind {
    Png,
    Jpeg,
    Jpeg2000,
    Tiff,
}

/// Tells the format by the first bytes.
fn sniff(input: &Input<'_>) -> Result<Kind, Fault> {
    let mut head = Vec::new();
    input.part(0, 8).read_to_end(&mut head)?;
    const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
    match head.as_slice() {
        [] => Err(Fault::NotAnImage("the file is empty".into())),
        PNG => Ok(Kind::Png),
        [0xFF, 0xD8, ..] => Ok(Kind::Jpeg),
        head if jpeg2000::begins(head) => Ok(Kind::Jpeg2000),
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => Ok(Kind::Tiff),
        short if PNG.starts_with(short) => Err(Fault::Truncated(
            "only the first bytes of a PNG are there".into(),
        )),
        _ => Err(Fault::NotAnImage(
            "its first bytes are not those of a PNG, JPEG or TIFF".into(),
        )),
    }
}

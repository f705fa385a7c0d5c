//! One image of a TIFF: its chunks, which are strips or tiles, and what their samples mean.

use super::directory::{self as tag, Directory};
use crate::input::Input;
use crate::layout::{Alpha, Colour, Kind, Layout, Opacity};
use crate::orientation::Orientation;
use crate::sink::Place;
use crate::{Budget, Fault};

/// How chunks are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Compression {
    None,
    /// Groups 3 and 4 of the fax standard.
    Fax3,
    Fax4,
    Lzw,
    Jpeg,
    Deflate,
    PackBits,
    Jpeg2000,
    Zstd,
}

/// One image: a page, or a level of one.
#[derive(Debug)]
pub(crate) struct Page {
    pub(crate) place: Place,
    /// Columns and rows of a chunk.
    pub(crate) chunk: [u32; 2],
    pub(crate) tiled: bool,
    /// Of each chunk, of the first plane first.
    offsets: Vec<u64>,
    counts: Vec<u64>,
    pub(crate) compression: Compression,
    /// 1 none, 2 differences, 3 differences of the bytes of real numbers.
    pub(crate) predictor: u64,
    /// As rows come out of [`super::chunk`]: planes are put together.
    pub(crate) layout: Layout,
    /// The planes that are read, where each sample has its own.
    pub(crate) planes: Option<Vec<usize>>,
    pub(crate) jpeg_tables: Option<Vec<u8>>,
    /// The components of a JPEG are RGB, whatever it says.
    pub(crate) jpeg_is_rgb: bool,
    /// Bits of a byte run from the low one up.
    pub(crate) reversed_bits: bool,
    /// Samples of a pixel that are no colour and no opacity: there is a choice.
    pub(crate) bands: usize,
}

impl Page {
    pub(crate) fn open(
        input: &Input<'_>,
        directory: &Directory,
        channel: Option<usize>,
        budget: Budget,
        alpha: Alpha,
    ) -> Result<Self, Fault> {
        let stored = directory.size(input)?;
        crate::error::check_not_empty(stored[0], stored[1])?;
        let number = |tag: u16, without: u64| {
            Ok::<_, Fault>(directory.number(input, tag)?.unwrap_or(without))
        };
        let compression = compression(number(tag::COMPRESSION, 1)?)?;
        if compression == Compression::Fax3 && number(tag::FAX3_OPTIONS, 0)? & 1 == 1 {
            return Err(Fault::Unsupported(
                "a TIFF of two-dimensional group 3 fax".into(),
            ));
        }
        let (mut layout, bands) = layout(input, directory, compression, channel, alpha)?;
        let tiled = directory.has(tag::TILE_OFFSETS);
        let side = |tag: u16, without: u32| {
            let n = number(tag, without.into())?.min(u64::from(u32::MAX)) as u32;
            match n {
                0 => Err(Fault::Damaged("its tiles or strips have no size".into())),
                n => Ok(n),
            }
        };
        let chunk = match tiled {
            true => [side(tag::TILE_WIDTH, 0)?, side(tag::TILE_HEIGHT, 0)?],
            false => [
                stored[0],
                side(tag::ROWS_PER_STRIP, stored[1])?.min(stored[1]),
            ],
        };
        let mut planes = None;
        if number(tag::PLANAR, 1)? == 2 && layout.samples > 1 {
            if layout.bits % 8 != 0 {
                return Err(Fault::Unsupported(
                    "a TIFF with planes of packed samples".into(),
                ));
            }
            planes = Some(match layout.only.take() {
                Some(k) => {
                    layout.samples = 1;
                    vec![k]
                }
                None => (0..layout.samples).collect(),
            });
        }
        let (offsets, counts) = chunks(input, directory, tiled)?;
        let page = Self {
            place: Place {
                stored,
                orientation: Orientation::of(number(tag::ORIENTATION, 1)?),
            },
            chunk,
            tiled,
            offsets,
            counts,
            compression,
            predictor: match compression {
                Compression::Lzw | Compression::Deflate | Compression::Zstd => {
                    number(tag::PREDICTOR, 1)?
                }
                _ => 1,
            },
            layout,
            planes,
            jpeg_tables: match compression {
                Compression::Jpeg => directory.bytes(input, tag::JPEG_TABLES)?.map(|v| v.0),
                _ => None,
            },
            jpeg_is_rgb: number(tag::PHOTOMETRIC, 1)? == 2,
            reversed_bits: number(tag::FILL_ORDER, 1)? == 2,
            bands,
        };
        page.check(input, budget)?;
        Ok(page)
    }

    /// What a file decides about is looked at before anything is made of it. A cut file is found out here, not in the middle of a run.
    fn check(&self, input: &Input<'_>, budget: Budget) -> Result<(), Fault> {
        let Layout { bits, kind, .. } = self.layout;
        let known = match kind {
            Kind::Unsigned => matches!(bits, 1..=16 | 32 | 64),
            Kind::Signed => matches!(bits, 8 | 16 | 32 | 64),
            Kind::Float => matches!(bits, 16 | 32 | 64),
        };
        if !known {
            return Err(Fault::Unsupported(format!(
                "a TIFF of {kind:?} samples of {bits} bits"
            )));
        }
        let predicted = match self.predictor {
            1 => true,
            2 => matches!(bits, 8 | 16 | 32 | 64),
            3 => kind == Kind::Float,
            _ => false,
        };
        if !predicted {
            return Err(Fault::Unsupported(format!(
                "predictor {} with {bits} bits",
                self.predictor
            )));
        }
        // A row is unpacked several times over.
        let [width, height] = self.chunk;
        budget.check(
            [width, height],
            4 * self.layout.row_bytes(width, self.layout.samples)
                + 16 * u64::from(width) * self.layout.samples as u64,
        )?;
        let planes = self
            .planes
            .as_ref()
            .map_or(1, |p| p.iter().max().map_or(1, |m| m + 1)) as u64;
        let needed = self.per_plane().saturating_mul(planes);
        if (self.offsets.len() as u64) < needed {
            return Err(Fault::Damaged(format!(
                "it tells where {} tiles or strips are, of {needed}",
                self.offsets.len()
            )));
        }
        let ends = self
            .offsets
            .iter()
            .zip(&self.counts)
            .filter(|(at, n)| **at > 0 && **n > 0);
        let end = ends.map(|(at, n)| at.saturating_add(*n)).max().unwrap_or(0);
        match end > input.length() {
            true => Err(Fault::Truncated(format!(
                "the image data needs {end} bytes and the file has {}",
                input.length()
            ))),
            false => Ok(()),
        }
    }

    /// Chunks of a plane.
    fn per_plane(&self) -> u64 {
        let [w, h] = self.place.stored;
        u64::from(w.div_ceil(self.chunk[0])) * u64::from(h.div_ceil(self.chunk[1]))
    }

    pub(crate) fn count(&self) -> u64 {
        self.per_plane()
    }

    /// First column and row of a chunk, and how many of each are inside the image.
    pub(crate) fn inside(&self, index: u64) -> [u32; 4] {
        let [w, h] = self.place.stored;
        let across = u64::from(w.div_ceil(self.chunk[0]));
        let (x, y) = (
            (index % across) as u32 * self.chunk[0],
            (index / across) as u32 * self.chunk[1],
        );
        [x, y, self.chunk[0].min(w - x), self.chunk[1].min(h - y)]
    }

    /// Where the bytes of a chunk of a plane lie; `None` for one that was never written.
    pub(crate) fn bytes_of(&self, plane: usize, index: u64) -> Option<[u64; 2]> {
        let k = usize::try_from(plane as u64 * self.per_plane() + index).ok()?;
        let (at, count) = (*self.offsets.get(k)?, *self.counts.get(k)?);
        (at > 0 && count > 0).then_some([at, count])
    }

    /// The chunks that touch columns `x` to `x + w` and rows `y` to `y + h` of the stored image.
    pub(crate) fn chunks_in(&self, [x, y, w, h]: [i64; 4]) -> impl Iterator<Item = u64> + use<> {
        let [width, height] = self.place.stored.map(i64::from);
        let [cw, ch] = self.chunk.map(i64::from);
        let across = (width + cw - 1) / cw;
        let span = |from: i64, n: i64, size: i64, chunk: i64| {
            let (a, b) = (from.max(0), from.saturating_add(n).min(size));
            if b > a {
                a / chunk..(b - 1) / chunk + 1
            } else {
                0..0
            }
        };
        let columns = span(x, w, width, cw);
        span(y, h, height, ch)
            .flat_map(move |r| columns.clone().map(move |c| (r * across + c) as u64))
    }
}

fn compression(number: u64) -> Result<Compression, Fault> {
    Ok(match number {
        1 => Compression::None,
        3 => Compression::Fax3,
        4 => Compression::Fax4,
        5 => Compression::Lzw,
        7 => Compression::Jpeg,
        8 | 32946 => Compression::Deflate,
        32773 => Compression::PackBits,
        33003 | 33005 | 34712 => Compression::Jpeg2000,
        50000 => Compression::Zstd,
        other => {
            let name = match other {
                2 => "CCITT RLE",
                6 => "old-style JPEG",
                34887 => "LERC",
                34925 => "LZMA",
                50001 | 34927 => "WebP",
                50002 => "JPEG XL",
                _ => "unknown",
            };
            return Err(Fault::Unsupported(format!(
                "TIFF compression {other} ({name})"
            )));
        }
    })
}

/// Offsets and lengths of all chunks.
fn chunks(
    input: &Input<'_>,
    directory: &Directory,
    tiled: bool,
) -> Result<(Vec<u64>, Vec<u64>), Fault> {
    let (at, count) = match tiled {
        true => (tag::TILE_OFFSETS, tag::TILE_COUNTS),
        false => (tag::STRIP_OFFSETS, tag::STRIP_COUNTS),
    };
    let none = || Fault::Damaged("it does not tell where its tiles or strips are".into());
    let offsets = directory.numbers(input, at)?.ok_or_else(none)?;
    let counts = match directory.numbers(input, count)? {
        Some(counts) if counts.len() >= offsets.len() => counts,
        // Old writers leave them out: up to the end, then.
        _ => offsets
            .iter()
            .map(|at| input.length().saturating_sub(*at))
            .collect(),
    };
    Ok((offsets, counts))
}

/// What the samples of a page mean, and how many bands there are to choose from.
fn layout(
    input: &Input<'_>,
    directory: &Directory,
    compression: Compression,
    channel: Option<usize>,
    alpha: Alpha,
) -> Result<(Layout, usize), Fault> {
    let number =
        |tag: u16, without: u64| Ok::<_, Fault>(directory.number(input, tag)?.unwrap_or(without));
    let samples = number(tag::SAMPLES, 1)?.clamp(1, 4096) as usize;
    let (bits, kind) = sample(input, directory)?;
    if compression == Compression::Jpeg && (bits != 8 || kind != Kind::Unsigned) {
        return Err(Fault::Unsupported(format!(
            "a TIFF of JPEG with {bits} bits"
        )));
    }
    let colour = colour(input, directory, compression, bits)?;
    let of_colour = colour.samples();
    if samples < of_colour {
        return Err(Fault::Damaged(format!(
            "it has {samples} samples for its colour"
        )));
    }
    let extra = directory.numbers(input, tag::EXTRA_SAMPLES)?;
    let opacity = match extra.as_deref() {
        _ if samples == of_colour => Opacity::Opaque,
        Some([1, ..]) => Opacity::Premultiplied,
        Some([2, ..]) => Opacity::Straight,
        None if colour == Colour::Rgb && samples == 4 => Opacity::Straight,
        _ => Opacity::Opaque,
    };
    let gray = matches!(colour, Colour::Gray | Colour::GrayInverted);
    let bands = match (gray, opacity) {
        (true, Opacity::Opaque) => samples,
        _ => 1,
    };
    if let Some(asked) = channel.filter(|k| *k >= samples) {
        return Err(Fault::NotThere {
            what: "channel",
            asked,
            available: samples,
        });
    }
    let layout = Layout {
        bits,
        kind,
        samples,
        colour,
        opacity,
        alpha,
        big_endian: directory.form.big_endian,
        clear: None,
        only: channel.filter(|_| samples > 1).or((bands > 1).then_some(0)),
        range: [0.0, 1.0],
    };
    Ok((layout, bands))
}

/// Bits of a sample, which are the same for all, and how it is written.
fn sample(input: &Input<'_>, directory: &Directory) -> Result<(u16, Kind), Fault> {
    let all_bits = directory
        .numbers(input, tag::BITS)?
        .unwrap_or_else(|| vec![1]);
    let bits = all_bits.first().copied().unwrap_or(1);
    if all_bits.iter().any(|b| *b != bits) {
        return Err(Fault::Unsupported(
            "a TIFF whose samples have different bits".into(),
        ));
    }
    let kind = match directory.number(input, tag::SAMPLE_FORMAT)?.unwrap_or(1) {
        1 | 4 => Kind::Unsigned,
        2 => Kind::Signed,
        3 => Kind::Float,
        _ => return Err(Fault::Unsupported("a TIFF of complex numbers".into())),
    };
    Ok((u16::try_from(bits).unwrap_or(0), kind))
}

fn colour(
    input: &Input<'_>,
    directory: &Directory,
    compression: Compression,
    bits: u16,
) -> Result<Colour, Fault> {
    let number =
        |tag: u16, without: u64| Ok::<_, Fault>(directory.number(input, tag)?.unwrap_or(without));
    let fax = matches!(compression, Compression::Fax3 | Compression::Fax4);
    Ok(match number(tag::PHOTOMETRIC, if fax { 0 } else { 1 })? {
        0 => Colour::GrayInverted,
        1 | 4 => Colour::Gray,
        2 => Colour::Rgb,
        3 => Colour::Palette(palette(input, directory, bits)?),
        5 => Colour::Cmyk,
        // The codes of Aperio's 33003 do not say that they are YCbCr; other decoders make RGB of it.
        6 => match compression {
            Compression::Jpeg2000 if number(tag::COMPRESSION, 1)? == 33003 => Colour::YCbCr,
            Compression::Jpeg | Compression::Jpeg2000 => Colour::Rgb,
            _ => match directory.numbers(input, tag::SUBSAMPLING)?.as_deref() {
                Some([1, 1, ..]) => Colour::YCbCr,
                _ => {
                    return Err(Fault::Unsupported(
                        "a TIFF of subsampled YCbCr without JPEG".into(),
                    ));
                }
            },
        },
        other => {
            return Err(Fault::Unsupported(format!(
                "a TIFF of photometric kind {other}"
            )));
        }
    })
}

/// The colours of a palette, in 8 bits.
fn palette(input: &Input<'_>, directory: &Directory, bits: u16) -> Result<Vec<[u8; 3]>, Fault> {
    if !matches!(bits, 1 | 2 | 4 | 8) {
        return Err(Fault::Unsupported(format!(
            "a TIFF with a palette of {bits} bits"
        )));
    }
    let map = directory.numbers(input, tag::COLOR_MAP)?;
    let map = map.ok_or_else(|| Fault::Damaged("its palette is missing".into()))?;
    let n = map.len() / 3;
    // Some write 8 bits where 16 belong.
    let shift = if map.iter().any(|v| *v > 255) { 257 } else { 1 };
    let level = |v: u64| ((v + shift / 2) / shift).min(255) as u8;
    Ok((0..n)
        .map(|k| [level(map[k]), level(map[n + k]), level(map[2 * n + k])])
        .collect())
}

//! What a row of samples means: from the bytes of a file, once decompressed, to opaque grey or colour.

use crate::Fault;
use crate::raster::{over_white, ycbcr_to_rgb};

/// How a sample is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Whole numbers from 0 to `2^bits - 1`.
    Unsigned,
    /// Whole numbers of either sign.
    Signed,
    /// IEEE 754.
    Float,
}

/// What the samples of a pixel are.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Colour {
    Gray,
    /// Grey where 0 is white.
    GrayInverted,
    Rgb,
    YCbCr,
    /// Inks: 0 is paper.
    Cmyk,
    /// An index into these colours.
    Palette(Vec<[u8; 3]>),
}

impl Colour {
    /// Samples that make the colour.
    pub(crate) fn samples(&self) -> usize {
        match self {
            Self::Gray | Self::GrayInverted | Self::Palette(_) => 1,
            Self::Rgb | Self::YCbCr => 3,
            Self::Cmyk => 4,
        }
    }
}

/// What becomes of opacity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Alpha {
    /// Composited on white, as a person sees a file.
    #[default]
    OverWhite,
    /// Left out: a sensor has none, and programs fill it with anything.
    Dropped,
}

/// How the colour relates to its opacity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Opacity {
    /// There is none.
    Opaque,
    /// In the sample after the colour, which does not know of it.
    Straight,
    /// In the sample after the colour, which is multiplied by it.
    Premultiplied,
}

/// The layout of the pixels of a picture.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    /// Bits of a sample: 1 to 16, 32 or 64.
    pub(crate) bits: u16,
    pub(crate) kind: Kind,
    /// Samples of a pixel, those that are left out included.
    pub(crate) samples: usize,
    pub(crate) colour: Colour,
    pub(crate) opacity: Opacity,
    pub(crate) alpha: Alpha,
    pub(crate) big_endian: bool,
    /// Grey or colour that is clear, in values of the file.
    pub(crate) clear: Option<Vec<u16>>,
    /// The one sample that is looked at.
    pub(crate) only: Option<usize>,
    /// For samples without a range of their own: what is black and what is white.
    pub(crate) range: [f64; 2],
}

/// A row, opaque.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row {
    /// 1 or 3.
    pub(crate) channels: usize,
    pub(crate) values: Values,
}

/// Samples on the whole range of their type.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Values {
    U8(Vec<u8>),
    U16(Vec<u16>),
}

impl Layout {
    /// Bytes of a row of this many pixels, of this many samples each.
    pub(crate) fn row_bytes(&self, width: u32, samples: usize) -> u64 {
        (u64::from(width) * samples as u64 * u64::from(self.bits)).div_ceil(8)
    }

    /// Whether the range of the samples must be looked for in the picture.
    pub(crate) fn has_no_range(&self) -> bool {
        self.kind != Kind::Unsigned || self.bits > 16
    }

    /// 1 for grey, 3 for colour, as rows come out.
    pub(crate) fn channels(&self) -> usize {
        let gray = matches!(self.colour, Colour::Gray | Colour::GrayInverted);
        if gray || self.only.is_some() { 1 } else { 3 }
    }

    /// Bits of a sample as rows come out, 8 or 16.
    pub(crate) fn depth(&self) -> u8 {
        match self.colour {
            Colour::Palette(_) => 8,
            _ if self.bits <= 8 && self.kind == Kind::Unsigned => 8,
            _ => 16,
        }
    }

    /// What a place shows that the file says nothing of: paper, glass, or the dark.
    pub(crate) fn blank(&self) -> f32 {
        match (self.only, &self.colour) {
            (Some(_), _) | (None, Colour::Gray) => 0.0,
            _ => 1.0,
        }
    }

    /// The row of `n` pixels whose samples lie in `raw`.
    pub(crate) fn row(&self, raw: &[u8], n: usize) -> Result<Row, Fault> {
        let count = n * self.samples;
        if (raw.len() as u64) < (count as u64 * u64::from(self.bits)).div_ceil(8) {
            return Err(Fault::Damaged("a row holds too few samples".into()));
        }
        if let Colour::Palette(colours) = &self.colour {
            return self.indexed(&self.small(raw, count), colours);
        }
        match self.bits {
            8 if self.kind == Kind::Unsigned => Ok(self.coloured(&raw[..count], None)),
            ..=7 if self.kind == Kind::Unsigned => {
                let values = self.small(raw, count);
                let top = (1_u32 << self.bits) - 1;
                let scaled: Vec<u8> = values
                    .iter()
                    .map(|v| ((u32::from(*v) * 255 + top / 2) / top) as u8)
                    .collect();
                Ok(self.coloured(&scaled, Some(&values)))
            }
            ..=16 if self.kind == Kind::Unsigned => {
                let values = self.middle(raw, count);
                if self.bits == 16 {
                    return Ok(self.coloured(&values, None));
                }
                let top = (1_u32 << self.bits) - 1;
                let scaled: Vec<u16> = values
                    .iter()
                    .map(|v| ((u32::from(*v) * 65535 + top / 2) / top) as u16)
                    .collect();
                Ok(self.coloured(&scaled, Some(&values)))
            }
            _ => {
                let [low, high] = self.range;
                let scale = if high > low {
                    65535.0 / (high - low)
                } else {
                    0.0
                };
                let scaled: Vec<u16> = self
                    .numbers(raw, count)?
                    .into_iter()
                    // What is no number becomes 0.
                    .map(|v| ((v - low) * scale).round().clamp(0.0, 65535.0) as u16)
                    .collect();
                Ok(self.coloured(&scaled, None))
            }
        }
    }

    /// Samples of up to 8 bits as they are.
    fn small(&self, raw: &[u8], count: usize) -> Vec<u8> {
        match self.bits {
            8 => raw[..count].to_vec(),
            16 => self
                .middle(raw, count)
                .iter()
                .map(|v| (*v).min(255) as u8)
                .collect(),
            bits => bits_of(raw, bits, count).map(|v| v as u8).collect(),
        }
    }

    /// Samples of 9 to 16 bits as they are.
    fn middle(&self, raw: &[u8], count: usize) -> Vec<u16> {
        if self.bits != 16 {
            return bits_of(raw, self.bits, count).collect();
        }
        let pairs = raw.as_chunks::<2>().0.iter().take(count);
        match self.big_endian {
            true => pairs.map(|p| u16::from_be_bytes(*p)).collect(),
            false => pairs.map(|p| u16::from_le_bytes(*p)).collect(),
        }
    }

    /// Samples that have no range of their own.
    pub(crate) fn numbers(&self, raw: &[u8], count: usize) -> Result<Vec<f64>, Fault> {
        let bytes = usize::from(self.bits / 8).max(1);
        let number = |chunk: &[u8]| -> u64 {
            let fold = |v: u64, b: &u8| v << 8 | u64::from(*b);
            match self.big_endian {
                true => chunk.iter().fold(0, fold),
                false => chunk.iter().rev().fold(0, fold),
            }
        };
        let value: fn(u64) -> f64 = match (self.kind, self.bits) {
            (Kind::Unsigned, 32 | 64) => |v| v as f64,
            (Kind::Signed, 8) => |v| f64::from(v as u8 as i8),
            (Kind::Signed, 16) => |v| f64::from(v as u16 as i16),
            (Kind::Signed, 32) => |v| f64::from(v as u32 as i32),
            (Kind::Signed, 64) => |v| v as i64 as f64,
            (Kind::Float, 16) => |v| half(v as u16),
            (Kind::Float, 32) => |v| f64::from(f32::from_bits(v as u32)),
            (Kind::Float, 64) => f64::from_bits,
            (kind, bits) => {
                return Err(Fault::Unsupported(format!(
                    "an image of {kind:?} samples of {bits} bits"
                )));
            }
        };
        let chunks = raw.chunks_exact(bytes).take(count);
        Ok(chunks.map(|chunk| value(number(chunk))).collect())
    }

    fn indexed(&self, indices: &[u8], colours: &[[u8; 3]]) -> Result<Row, Fault> {
        if self.only.is_some() && colours.is_empty() {
            return Err(Fault::Damaged("its palette is empty".into()));
        }
        let mut values = Vec::with_capacity(3 * indices.len());
        for index in indices.iter().step_by(self.samples) {
            let colour = colours.get(usize::from(*index)).ok_or_else(|| {
                Fault::Damaged(format!(
                    "a pixel has colour {index} of a palette of {}",
                    colours.len()
                ))
            })?;
            values.extend(colour);
        }
        Ok(match self.only {
            None => Row {
                channels: 3,
                values: Values::U8(values),
            },
            // One sample there is: the index's colour, as grey.
            Some(_) => Row {
                channels: 1,
                values: Values::U8(
                    values
                        .as_chunks::<3>()
                        .0
                        .iter()
                        .map(|c| crate::raster::gray_u8(*c))
                        .collect(),
                ),
            },
        })
    }

    /// Colour of samples on the whole range of their type; `stored`: as they were before they were scaled to it.
    fn coloured<T: Depth + Into<u32>>(&self, values: &[T], stored: Option<&[T]>) -> Row {
        if let Some(k) = self.only {
            let values = values.iter().skip(k).step_by(self.samples).copied();
            let inverted = self.colour == Colour::GrayInverted;
            let turned = values.map(|v| if inverted { v.inverted() } else { v });
            return T::row(1, turned.collect());
        }
        let opaque = self.opacity == Opacity::Opaque || self.alpha == Alpha::Dropped;
        let plain = opaque && (self.clear.is_none() || self.alpha == Alpha::Dropped);
        let channels = self.channels();
        if plain && self.samples == channels && matches!(self.colour, Colour::Gray | Colour::Rgb) {
            return T::row(channels, values.to_vec());
        }
        let of_colour = self.colour.samples();
        let mut out = Vec::with_capacity(values.len() / self.samples * channels);
        for (i, p) in values.chunks_exact(self.samples).enumerate() {
            let mut c = [T::default(); 3];
            match &self.colour {
                Colour::GrayInverted => c[0] = p[0].inverted(),
                Colour::Cmyk => {
                    let paper = p[3].inverted();
                    for (c, ink) in c.iter_mut().zip(p) {
                        *c = ink.inverted().times(paper);
                    }
                }
                Colour::YCbCr => c = T::from_ycbcr([p[0], p[1], p[2]]),
                _ => c[..of_colour].copy_from_slice(&p[..of_colour]),
            }
            if !opaque {
                let a = p[of_colour];
                for v in &mut c[..channels] {
                    *v = match self.opacity {
                        Opacity::Premultiplied => v.plus(a.inverted()),
                        _ => v.over_white(a),
                    };
                }
            }
            if let Some(clear) = self.clear.as_ref().filter(|_| !plain) {
                let at = i * self.samples;
                let same = (0..of_colour).all(|k| {
                    let v = match stored {
                        Some(stored) => stored[at + k].into(),
                        None => p[k].into(),
                    };
                    clear.get(k).is_some_and(|c| u32::from(*c) == v)
                });
                if same {
                    c = [T::FULL; 3];
                }
            }
            out.extend(&c[..channels]);
        }
        T::row(channels, out)
    }
}

/// Samples packed from the high bit on.
fn bits_of(raw: &[u8], bits: u16, count: usize) -> impl Iterator<Item = u16> + '_ {
    let bits = u32::from(bits);
    (0..count).map(move |i| {
        let first = i * bits as usize;
        let at = first / 8;
        let byte = |k: usize| u32::from(raw.get(at + k).copied().unwrap_or(0));
        let held = byte(0) << 16 | byte(1) << 8 | byte(2);
        (held >> (24 - (first % 8) as u32 - bits) & ((1 << bits) - 1)) as u16
    })
}

/// A number of 16 bits, IEEE 754.
fn half(v: u16) -> f64 {
    let (sign, exponent, fraction) = (v >> 15, i32::from(v >> 10 & 31), f64::from(v & 1023));
    let size = match exponent {
        0 => fraction * f64::exp2(-24.0),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        e => (1.0 + fraction / 1024.0) * f64::exp2(f64::from(e - 15)),
    };
    if sign == 1 { -size } else { size }
}

/// 8 or 16 bits.
trait Depth: Copy + Default {
    const FULL: Self;
    fn inverted(self) -> Self;
    fn times(self, share: Self) -> Self;
    fn plus(self, more: Self) -> Self;
    fn over_white(self, alpha: Self) -> Self;
    fn from_ycbcr(c: [Self; 3]) -> [Self; 3];
    fn row(channels: usize, values: Vec<Self>) -> Row;
}

impl Depth for u8 {
    const FULL: u8 = 255;
    fn inverted(self) -> u8 {
        255 - self
    }
    fn times(self, share: u8) -> u8 {
        ((u32::from(self) * u32::from(share) + 127) / 255) as u8
    }
    fn plus(self, more: u8) -> u8 {
        self.saturating_add(more)
    }
    fn over_white(self, alpha: u8) -> u8 {
        over_white(self.into(), alpha.into(), 255) as u8
    }
    fn from_ycbcr(c: [u8; 3]) -> [u8; 3] {
        ycbcr_to_rgb(c)
    }
    fn row(channels: usize, values: Vec<u8>) -> Row {
        Row {
            channels,
            values: Values::U8(values),
        }
    }
}

impl Depth for u16 {
    const FULL: u16 = 65535;
    fn inverted(self) -> u16 {
        65535 - self
    }
    fn times(self, share: u16) -> u16 {
        ((u64::from(self) * u64::from(share) + 32767) / 65535) as u16
    }
    fn plus(self, more: u16) -> u16 {
        self.saturating_add(more)
    }
    fn over_white(self, alpha: u16) -> u16 {
        over_white(self.into(), alpha.into(), 65535) as u16
    }
    fn from_ycbcr(c: [u16; 3]) -> [u16; 3] {
        // Only 8 bits are written that way; the high byte is what there is to see.
        ycbcr_to_rgb(c.map(|v| (v >> 8) as u8)).map(|v| u16::from(v) * 257)
    }
    fn row(channels: usize, values: Vec<u16>) -> Row {
        Row {
            channels,
            values: Values::U16(values),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gray(bits: u16, kind: Kind) -> Layout {
        Layout {
            bits,
            kind,
            samples: 1,
            colour: Colour::Gray,
            opacity: Opacity::Opaque,
            alpha: Alpha::OverWhite,
            big_endian: true,
            clear: None,
            only: None,
            range: [0.0, 1.0],
        }
    }

    fn values(layout: &Layout, raw: &[u8], n: usize) -> Vec<u32> {
        match layout.row(raw, n).unwrap().values {
            Values::U8(v) => v.into_iter().map(u32::from).collect(),
            Values::U16(v) => v.into_iter().map(u32::from).collect(),
        }
    }

    #[test]
    fn packed_samples_fill_the_range() {
        let one = gray(1, Kind::Unsigned);
        assert_eq!(
            values(&one, &[0b1010_0000, 0x80], 9),
            [255, 0, 255, 0, 0, 0, 0, 0, 255]
        );
        let two = gray(2, Kind::Unsigned);
        assert_eq!(values(&two, &[0b0001_1011], 4), [0, 85, 170, 255]);
        let four = gray(4, Kind::Unsigned);
        assert_eq!(values(&four, &[0x0f, 0x70], 3), [0, 255, 119]);
        let twelve = gray(12, Kind::Unsigned);
        assert_eq!(
            values(&twelve, &[0xff, 0xf0, 0x00, 0x80, 0x00], 3),
            [65535, 0, 32776]
        );
        let ten = gray(10, Kind::Unsigned);
        assert_eq!(values(&ten, &[0xff, 0xc0, 0x00], 2), [65535, 0]);
    }

    #[test]
    fn numbers_of_every_kind_are_read() {
        let read = |layout: &Layout, raw: &[u8]| layout.numbers(raw, 1).unwrap()[0];
        assert_eq!(read(&gray(16, Kind::Signed), &[0xff, 0xfe]), -2.0);
        assert_eq!(read(&gray(32, Kind::Signed), &(-5_i32).to_be_bytes()), -5.0);
        assert_eq!(read(&gray(32, Kind::Unsigned), &7_u32.to_be_bytes()), 7.0);
        assert_eq!(read(&gray(64, Kind::Float), &1.5_f64.to_be_bytes()), 1.5);
        assert_eq!(read(&gray(16, Kind::Float), &[0x3c, 0x00]), 1.0);
        assert_eq!(read(&gray(16, Kind::Float), &[0xc5, 0x00]), -5.0);
        assert_eq!(
            read(&gray(16, Kind::Float), &[0x00, 0x01]),
            f64::exp2(-24.0)
        );
        let mut little = gray(32, Kind::Float);
        little.big_endian = false;
        assert_eq!(read(&little, &0.25_f32.to_le_bytes()), 0.25);
        assert!(gray(24, Kind::Float).numbers(&[0; 3], 1).is_err());
        // Not a number is black, and beyond the range is its end.
        let unit = gray(32, Kind::Float);
        let raw: Vec<u8> = [f32::NAN, -3.0, 0.5, f32::INFINITY]
            .iter()
            .flat_map(|v| v.to_be_bytes())
            .collect();
        assert_eq!(values(&unit, &raw, 4), [0, 0, 32768, 65535]);
    }

    #[test]
    fn inks_palettes_and_opacity() {
        let mut cmyk = gray(8, Kind::Unsigned);
        (cmyk.samples, cmyk.colour) = (4, Colour::Cmyk);
        assert_eq!(
            values(
                &cmyk,
                &[0, 0, 0, 0, 255, 0, 0, 0, 0, 0, 0, 255, 0, 128, 0, 128],
                4
            ),
            [255, 255, 255, 0, 255, 255, 0, 0, 0, 127, 63, 127]
        );
        let mut palette = gray(2, Kind::Unsigned);
        palette.colour = Colour::Palette(vec![[1, 2, 3], [4, 5, 6], [7, 8, 9]]);
        assert_eq!(
            values(&palette, &[0b1000_0100], 3),
            [7, 8, 9, 1, 2, 3, 4, 5, 6]
        );
        assert!(
            palette.row(&[0b1100_0000], 1).is_err(),
            "index 3 of 3 colours"
        );
        let mut alpha = gray(8, Kind::Unsigned);
        (alpha.samples, alpha.opacity) = (2, Opacity::Straight);
        assert_eq!(values(&alpha, &[0, 51, 9, 255], 2), [204, 9]);
        alpha.opacity = Opacity::Premultiplied;
        assert_eq!(values(&alpha, &[10, 51, 9, 255], 2), [214, 9]);
        alpha.alpha = Alpha::Dropped;
        assert_eq!(values(&alpha, &[10, 51, 9, 255], 2), [10, 9]);
        let mut clear = gray(4, Kind::Unsigned);
        clear.clear = Some(vec![7]);
        assert_eq!(values(&clear, &[0x7f, 0x00], 3), [255, 255, 0]);
    }

    #[test]
    fn one_sample_alone() {
        let mut rgb = gray(8, Kind::Unsigned);
        (rgb.samples, rgb.colour, rgb.only) = (3, Colour::Rgb, Some(1));
        assert_eq!(values(&rgb, &[1, 2, 3, 4, 5, 6], 2), [2, 5]);
    }

    #[test]
    fn too_short_a_row_is_damaged() {
        for bits in [1, 8, 12, 16, 32] {
            let layout = gray(bits, Kind::Unsigned);
            let bytes = layout.row_bytes(9, 1) as usize;
            assert!(layout.row(&vec![0; bytes], 9).is_ok(), "{bits}");
            assert!(layout.row(&vec![0; bytes - 1], 9).is_err(), "{bits}");
        }
    }
}

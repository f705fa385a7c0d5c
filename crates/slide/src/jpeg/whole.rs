//! Whether a JPEG is whole. Decoders draw what is missing as grey or shift what follows, and say nothing; an image with a hole, as a
//! lost packet or a cut file leaves it, must not pass for a view. So the codes are walked through and its blocks counted, without decoding
//! them. On the way the mean of each block is known, which is the image reduced eight times.

use super::codes::{Bits, Table, Tables, segments};
use super::scans;
use crate::{Budget, Fault};
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use std::borrow::Cow;
use std::sync::LazyLock;

/// The Huffman tables of the standard, as segments. USB cameras mean these where they send none.
static STANDARD_TABLES: LazyLock<Vec<u8>> = LazyLock::new(|| {
    // They are what this encoder uses; a test compares.
    let mut bytes = Vec::new();
    let drawn = JpegEncoder::new(&mut bytes).encode(&[0; 3], 1, 1, ExtendedColorType::Rgb8);
    match drawn {
        Ok(()) => segments(&bytes)
            .filter(|s| s.kind == TABLES)
            .flat_map(|s| s.whole.to_vec())
            .collect(),
        Err(_) => Vec::new(),
    }
});

const TABLES: u8 = 0xc4;
const QUANTISATION: u8 = 0xdb;
const SCAN: u8 = 0xda;
const RESTART_INTERVAL: u8 = 0xdd;
/// Baseline and extended sequential frames: one scan, or one for each component.
const SEQUENTIAL: [u8; 2] = [0xc0, 0xc1];

/// A JPEG that is all there.
pub(crate) struct Whole<'a> {
    /// The file up to its end marker, with Huffman tables.
    pub(crate) bytes: Cow<'a, [u8]>,
    /// What its one sequential scan is made of; `None` for progressive files and those in several scans.
    pub(crate) plan: Option<Plan>,
}

/// A JPEG with its Huffman tables, when all its blocks are there.
///
/// # Errors
/// [`Fault::Truncated`], [`Fault::Damaged`].
pub(crate) fn whole<'a>(
    bytes: impl Into<Cow<'a, [u8]>>,
    budget: Budget,
) -> Result<Whole<'a>, Fault> {
    let bytes = bytes.into();
    let cut = || Fault::Truncated("the JPEG has no end marker".into());
    let end = end(&bytes).ok_or_else(cut)?;
    let bytes = match bytes {
        Cow::Borrowed(bytes) => Cow::Borrowed(&bytes[..end]),
        Cow::Owned(mut bytes) => {
            bytes.truncate(end);
            Cow::Owned(bytes)
        }
    };
    let has_tables = segments(&bytes).any(|s| s.kind == TABLES);
    let bytes = match has_tables {
        true => bytes,
        false => Cow::Owned([&bytes[..2], &STANDARD_TABLES, &bytes[2..]].concat()),
    };
    let plan = Plan::read(&bytes);
    match &plan {
        Some(plan) => plan.walk(&bytes, |_, _| {})?,
        None => scans::walk(&bytes, budget)?,
    }
    Ok(Whole { bytes, plan })
}

/// Where the stream ends: segments by their length, scans by their markers (ITU-T T.81, annex B). What follows is not the image: buffers
/// of a fixed size are filled up, phones append films.
fn end(data: &[u8]) -> Option<usize> {
    let mut at = 2;
    while let (Some(&lead), Some(&marker)) = (data.get(at), data.get(at + 1)) {
        if lead != 0xFF {
            // The data of a scan, or stray bytes between segments, which decoders skip too.
            at += 1;
            continue;
        }
        match marker {
            0xFF => at += 1,
            0xD9 => return Some(at + 2),
            0x00 | 0x01 | 0xD0..=0xD8 => at += 2,
            _ => {
                let length = data.get(at + 2..at + 4)?;
                at += 2 + usize::from(u16::from_be_bytes([length[0], length[1]]));
            }
        }
    }
    None
}

/// A block of an MCU.
#[derive(Debug)]
struct Block {
    component: usize,
    dc: Table,
    ac: Table,
}

/// What a scan is made of.
#[derive(Debug)]
pub(crate) struct Plan {
    blocks: Vec<Block>,
    /// MCUs in a row, and rows of them.
    across: usize,
    down: usize,
    /// Blocks of the first component in an MCU, across and down.
    first: [usize; 2],
    /// What a step of the first component's mean is worth, in eighths of a level of grey.
    step: i32,
    /// How many MCUs between two restart markers; 0 without.
    interval: usize,
    /// Where the data begins.
    start: usize,
}

impl Plan {
    /// `None` for what is not one sequential scan, or makes no sense, which the decoder tells better.
    fn read(bytes: &[u8]) -> Option<Self> {
        let mut tables = Tables::default();
        let mut steps = [None; 4];
        let (mut frame, mut interval) = (None, 0);
        for segment in segments(bytes) {
            let data = segment.data();
            match segment.kind {
                TABLES => tables.read(data)?,
                QUANTISATION => {
                    let mut rest = data;
                    while let [kind, more @ ..] = rest {
                        let deep = usize::from(kind >> 4 != 0);
                        let step = match deep {
                            0 => i32::from(*more.first()?),
                            _ => i32::from(u16::from_be_bytes([*more.first()?, *more.get(1)?])),
                        };
                        *steps.get_mut(usize::from(kind & 15))? = Some(step);
                        rest = more.get(64 << deep..)?;
                    }
                }
                RESTART_INTERVAL => {
                    interval = usize::from(u16::from_be_bytes([*data.first()?, *data.get(1)?]));
                }
                kind if SEQUENTIAL.contains(&kind) => frame = Some(data),
                SCAN => {
                    let mut plan = Self::of(frame?, data, &tables, segment.end)?;
                    plan.interval = interval;
                    plan.step = (*steps.get(usize::from(*frame?.get(8)?))?)?;
                    return Some(plan);
                }
                _ => {}
            }
        }
        None
    }

    fn of(frame: &[u8], scan: &[u8], tables: &Tables, start: usize) -> Option<Self> {
        let &[8, h1, h0, w1, w0, n, ref parts @ ..] = frame else {
            return None;
        };
        let (height, width) = (
            usize::from(u16::from_be_bytes([h1, h0])),
            usize::from(u16::from_be_bytes([w1, w0])),
        );
        let parts: Vec<&[u8]> = parts.chunks_exact(3).take(usize::from(n)).collect();
        // One scan for all, whose data end at the end of the file.
        if parts.len() != usize::from(n) || scan.first() != Some(&n) || height == 0 {
            return None;
        }
        // A component alone is not interleaved, whatever it says.
        let count = |part: &[u8]| match parts.len() {
            1 => [1, 1],
            _ => [usize::from(part[1] >> 4), usize::from(part[1] & 15)],
        };
        let most = |axis: usize| parts.iter().map(|p| count(p)[axis]).max();
        let (across, down) = (8 * most(0)?, 8 * most(1)?);
        let mut blocks = Vec::new();
        for (component, part) in parts.iter().enumerate() {
            let chosen = scan[1..].chunks_exact(2).find(|s| s[0] == part[0])?[1];
            let (dc, ac) = (tables.get(0, chosen >> 4)?, tables.get(1, chosen & 15)?);
            let [h, v] = count(part);
            blocks.extend((0..h * v).map(|_| Block {
                component,
                dc: dc.clone(),
                ac: ac.clone(),
            }));
        }
        if blocks.is_empty() || blocks.len() > 16 || across == 0 || down == 0 {
            return None;
        }
        Some(Self {
            blocks,
            across: width.div_ceil(across),
            down: height.div_ceil(down),
            first: count(parts[0]),
            step: 0,
            interval: 0,
            start,
        })
    }

    /// Whether each block of the first component covers 8 x 8 pixels.
    pub(crate) fn is_full_size(&self) -> bool {
        let [h, v] = self.first;
        self.blocks.iter().filter(|b| b.component == 1).count() <= h * v
    }

    /// Walks through all blocks. `each` is told the column and row of each block of the first component and eight times the mean of its
    /// values, 0 to 2040, which quantisation may push a little beyond.
    pub(crate) fn walk(
        &self,
        bytes: &[u8],
        mut each: impl FnMut([usize; 2], i32),
    ) -> Result<(), Fault> {
        let mut bits = Bits::new(&bytes[self.start..]);
        let count = self.across * self.down;
        let mut levels = [0_i32; 16];
        for mcu in 0..count {
            let hole = || {
                Fault::Damaged(format!(
                    "the image has a hole: its data make no sense after {mcu} of {count} parts"
                ))
            };
            if self.interval > 0 && mcu > 0 && mcu.is_multiple_of(self.interval) {
                bits.restart(mcu / self.interval).ok_or_else(hole)?;
                levels = [0; 16];
            }
            let [h, v] = self.first;
            for (k, block) in self.blocks.iter().enumerate() {
                let level = levels.get_mut(block.component).ok_or_else(hole)?;
                *level = level.wrapping_add(block.pass(&mut bits).ok_or_else(hole)?);
                if block.component == 0 {
                    let place = [mcu % self.across * h + k % h, mcu / self.across * v + k / h];
                    each(place, level.saturating_mul(self.step).saturating_add(1024));
                }
            }
        }
        Ok(())
    }
}

impl Block {
    /// Passes over 64 coefficients; returns by how much the first differs from that before. `None` when the bits end or mean nothing.
    fn pass(&self, bits: &mut Bits<'_>) -> Option<i32> {
        let size = self.dc.read(bits)?;
        let change = bits.signed(size)?;
        let mut k = 1;
        while k < 64 {
            let symbol = self.ac.read(bits)?;
            let (zeros, size) = (usize::from(symbol >> 4), symbol & 15);
            match (size, zeros) {
                (0, 15) => k += 16,
                (0, _) => return Some(change),
                _ => {
                    k += zeros + 1;
                    bits.peek();
                    bits.pass(size.into())?;
                }
            }
        }
        // More than 64: it has lost its way.
        (k == 64).then_some(change)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn whole(bytes: &[u8]) -> Result<Whole<'_>, Fault> {
        super::whole(bytes, Budget { bytes: 1 << 24 })
    }

    const END_OF_IMAGE: [u8; 2] = [0xff, 0xd9];

    /// An image with structure, and its JPEG.
    fn jpeg(width: u32, height: u32, shade: u8) -> Vec<u8> {
        let pixels: Vec<u8> = (0..width * height)
            .flat_map(|i| {
                let (x, y) = (i % width, i / width);
                [shade, (x * 255 / width) as u8, (y * 255 / height) as u8]
            })
            .collect();
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, 95)
            .encode(&pixels, width, height, ExtendedColorType::Rgb8)
            .unwrap();
        bytes
    }

    fn gray(width: u32, height: u32, quality: u8, level: impl Fn(u32, u32) -> u8) -> Vec<u8> {
        let pixels: Vec<u8> = (0..width * height)
            .map(|i| level(i % width, i / width))
            .collect();
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, quality)
            .encode(&pixels, width, height, ExtendedColorType::L8)
            .unwrap();
        bytes
    }

    /// Where the data of the scan begin.
    fn start(bytes: &[u8]) -> usize {
        segments(bytes).find(|s| s.kind == SCAN).unwrap().end
    }

    fn is_hole(result: Result<Whole<'_>, Fault>) -> bool {
        matches!(result, Err(Fault::Damaged(why)) if why.contains("hole"))
    }

    #[test]
    fn whole_pictures_pass_in_every_shape() {
        for (width, height) in [(1, 1), (7, 9), (16, 16), (17, 33), (64, 48), (333, 101)] {
            let colour = jpeg(width, height, 77);
            assert_eq!(
                *whole(&colour).unwrap().bytes,
                colour[..],
                "{width} {height}"
            );
            for quality in [5, 50, 100] {
                let noise = gray(width, height, quality, |x, y| {
                    let i = y * width + x;
                    (i.wrapping_mul(i) % 251) as u8
                });
                assert!(whole(&noise).unwrap().plan.is_some());
            }
        }
    }

    #[test]
    fn an_end_marker_inside_a_segment_does_not_count_and_what_follows_the_end_is_left_out() {
        let app = [0xFF, 0xD8, 0xFF, 0xE1, 0, 6, 0xFF, 0xD9, 1, 2];
        assert_eq!(end(&app), None);
        let with_end = [&app[..], &[0xFF, 0xDA, 0, 2, 7, 0xFF, 0x00, 0xFF, 0xD9]].concat();
        assert_eq!(end(&with_end), Some(with_end.len()));
        assert_eq!(end(&with_end[..with_end.len() - 1]), None);
        assert_eq!(end(&[]), None);
        let bytes = jpeg(40, 24, 90);
        for more in [&[0; 300][..], b"\r\n", b"and a film", &jpeg(8, 8, 1)] {
            assert_eq!(*whole(&[&bytes, more].concat()).unwrap().bytes, bytes[..]);
        }
        for cut in [3, bytes.len() / 2, bytes.len() - 1] {
            assert!(matches!(whole(&bytes[..cut]), Err(Fault::Truncated(_))));
        }
    }

    #[test]
    fn a_hole_is_told_and_so_is_a_cut_with_an_end() {
        let bytes = jpeg(320, 240, 90);
        let data = start(&bytes);
        let n = bytes.len() - data;
        let mut told = 0;
        for k in 1..40 {
            let at = data + n * k / 41;
            let cut = [&bytes[..at], &END_OF_IMAGE].concat();
            assert!(is_hole(whole(&cut)), "{k}");
            let size = n / 20;
            if at + size < bytes.len() - 2 {
                let hole = [&bytes[..at], &bytes[at + size..]].concat();
                told += usize::from(whole(&hole).is_err());
            } else {
                told += 1;
            }
        }
        // Where the codes fall into step again, what is missing is missing at the end.
        assert_eq!(told, 39);
    }

    #[test]
    fn restart_markers_are_counted() {
        let bytes = jpeg(64, 64, 90);
        let scan = segments(&bytes).find(|s| s.kind == SCAN).unwrap();
        let from = scan.end - scan.whole.len();
        // An interval that is announced and does not come.
        let announced = [
            &bytes[..from],
            &[0xff, RESTART_INTERVAL, 0, 4, 0, 4][..],
            &bytes[from..],
        ]
        .concat();
        let Err(Fault::Damaged(why)) = whole(&announced) else {
            panic!("it passed");
        };
        assert!(why.contains("after 4 of 64 parts"), "{why}");
    }

    #[test]
    fn the_means_of_blocks_are_those_of_the_image() {
        for (width, height) in [(64, 40), (71, 50), (8, 8)] {
            let level = |x: u32, y: u32| (40 + 2 * x + y) as u8;
            let bytes = gray(width, height, 100, level);
            let whole = whole(&bytes).unwrap();
            let plan = whole.plan.unwrap();
            assert!(plan.is_full_size());
            let mut seen = 0;
            plan.walk(&whole.bytes, |[x, y], mean| {
                let (x, y) = (8 * x as u32, 8 * y as u32);
                if x + 8 <= width && y + 8 <= height {
                    seen += 1;
                    let want = 40.0 + 2.0 * (f64::from(x) + 3.5) + f64::from(y) + 3.5;
                    assert!((f64::from(mean) / 8.0 - want).abs() < 0.6, "{mean} {want}");
                }
            })
            .unwrap();
            assert_eq!(seen, (width / 8) * (height / 8));
        }
    }

    #[test]
    fn the_tables_of_the_standard_are_those_of_the_standard() {
        // ITU-T T.81, annex K.3: how many codes of each length.
        let counts = [
            [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0],
            [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 125],
            [0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0],
            [0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 119],
        ];
        for count in counts {
            let found = STANDARD_TABLES.windows(16).any(|w| w == count);
            assert!(found, "{count:?}");
        }
    }
}

//! Whether a JPEG is whole. Decoders draw what is missing as grey or shift what follows, and say nothing; an image with a hole, as a
//! lost packet leaves it, must not pass for a view. So the codes are walked through and its blocks counted, without decoding them.

use crate::camera::picture_error::PictureError;
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use std::borrow::Cow;
use std::sync::LazyLock;

const END_OF_IMAGE: [u8; 2] = [0xff, 0xd9];

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
const SCAN: u8 = 0xda;
const RESTART_INTERVAL: u8 = 0xdd;
/// Baseline and extended sequential frames: one scan, or one for each component.
const SEQUENTIAL: [u8; 2] = [0xc0, 0xc1];

/// A segment before the first scan's data, that of the scan included.
struct Segment<'a> {
    kind: u8,
    /// With its marker.
    whole: &'a [u8],
    /// Where it ends in the file.
    end: usize,
}

impl<'a> Segment<'a> {
    fn data(&self) -> &'a [u8] {
        &self.whole[4..]
    }
}

fn segments(bytes: &[u8]) -> impl Iterator<Item = Segment<'_>> {
    let mut at = 2;
    let mut over = false;
    std::iter::from_fn(move || {
        // Any number of 0xff may stand before a marker.
        while bytes.get(at) == Some(&0xff) && bytes.get(at + 1) == Some(&0xff) {
            at += 1;
        }
        let &[0xff, kind, high, low] = bytes.get(at..at + 4)?.first_chunk()? else {
            return None;
        };
        let end = at + 2 + usize::from(u16::from_be_bytes([high, low]));
        let whole = bytes.get(at..end).filter(|w| w.len() >= 4 && !over)?;
        over = kind == SCAN;
        at = end;
        Some(Segment { kind, whole, end })
    })
}

/// A JPEG with its Huffman tables, when all its blocks are there. Progressive files, and those in several scans, are taken on trust
/// but for their end.
///
/// # Errors
/// [`PictureError::Cut`], [`PictureError::Hole`].
pub(crate) fn whole(bytes: &[u8]) -> Result<Cow<'_, [u8]>, PictureError> {
    // Buffers of a fixed size are filled up with zeros, and streams with line ends.
    let filling = |b: &&u8| matches!(**b, 0 | b'\r' | b'\n');
    let end = bytes.len() - bytes.iter().rev().take_while(filling).count();
    let bytes = &bytes[..end];
    if !bytes.ends_with(&END_OF_IMAGE) {
        return Err(PictureError::Cut { bytes: end });
    }
    let bytes = match segments(bytes).any(|s| s.kind == TABLES) {
        true => Cow::Borrowed(bytes),
        false => Cow::Owned([&bytes[..2], &STANDARD_TABLES, &bytes[2..]].concat()),
    };
    if let Some(plan) = Plan::read(&bytes) {
        plan.walk(&bytes)?;
    }
    Ok(bytes)
}

/// A Huffman table: for each length, the first code beyond it and where its values lie.
#[derive(Debug, Clone)]
struct Table {
    /// For lengths 1 to 16: first code, number of codes, place of the first value.
    lengths: [(u32, u32, usize); 16],
    values: Vec<u8>,
}

impl Table {
    fn new(counts: &[u8], values: &[u8]) -> Self {
        let (mut code, mut place) = (0, 0);
        let mut lengths = [(0, 0, 0); 16];
        for (length, count) in lengths.iter_mut().zip(counts) {
            *length = (code, u32::from(*count), place);
            code = (code + u32::from(*count)) << 1;
            place += usize::from(*count);
        }
        Self {
            lengths,
            values: values.to_vec(),
        }
    }

    fn read(&self, bits: &mut Bits<'_>) -> Option<u8> {
        let mut code = 0;
        for (first, count, place) in &self.lengths {
            code = code << 1 | bits.next()?;
            if code >= *first && code - first < *count {
                return self.values.get(place + (code - first) as usize).copied();
            }
        }
        None
    }
}

/// What a scan is made of.
struct Plan {
    /// The tables of each block of an MCU, DC and AC.
    blocks: Vec<[Table; 2]>,
    /// How many MCUs there are.
    count: usize,
    /// How many between two restart markers; 0 without.
    interval: usize,
    /// Where the data begins.
    start: usize,
}

impl Plan {
    /// `None` for what is not one sequential scan, or makes no sense, which the decoder tells better.
    fn read(bytes: &[u8]) -> Option<Self> {
        let mut tables: [[Option<Table>; 4]; 2] = Default::default();
        let (mut frame, mut interval) = (None, 0);
        for segment in segments(bytes) {
            let data = segment.data();
            match segment.kind {
                TABLES => {
                    let mut rest = data;
                    while let [class, more @ ..] = rest {
                        let counts = more.get(..16)?;
                        let n = counts.iter().map(|c| usize::from(*c)).sum::<usize>();
                        let values = more.get(16..16 + n)?;
                        let place = tables.get_mut(usize::from(class >> 4))?;
                        *place.get_mut(usize::from(class & 15))? = Some(Table::new(counts, values));
                        rest = &more[16 + n..];
                    }
                }
                RESTART_INTERVAL => {
                    interval = usize::from(u16::from_be_bytes([*data.first()?, *data.get(1)?]));
                }
                kind if SEQUENTIAL.contains(&kind) => frame = Some(data),
                SCAN => return Self::of(frame?, data, &tables, interval, segment.end),
                _ => {}
            }
        }
        None
    }

    fn of(
        frame: &[u8],
        scan: &[u8],
        tables: &[[Option<Table>; 4]; 2],
        interval: usize,
        start: usize,
    ) -> Option<Self> {
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
        let most = |shift: u8| parts.iter().map(|p| usize::from(p[1] >> shift & 15)).max();
        let (across, down) = (most(4)?, most(0)?);
        let mut blocks = Vec::new();
        for part in &parts {
            let chosen = scan[1..].chunks_exact(2).find(|s| s[0] == part[0])?[1];
            let table = |class: usize, id: u8| tables[class].get(usize::from(id))?.clone();
            let pair = [table(0, chosen >> 4)?, table(1, chosen & 15)?];
            // A component alone is not interleaved, whatever it says.
            let n = match parts.len() {
                1 => 1,
                _ => usize::from(part[1] >> 4) * usize::from(part[1] & 15),
            };
            blocks.extend(std::iter::repeat_n(pair, n));
        }
        let size = match parts.len() {
            1 => [8, 8],
            _ => [8 * across, 8 * down],
        };
        if blocks.is_empty() || blocks.len() > 16 || size.contains(&0) {
            return None;
        }
        Some(Self {
            blocks,
            count: width.div_ceil(size[0]) * height.div_ceil(size[1]),
            interval,
            start,
        })
    }

    /// Walks through all blocks.
    fn walk(&self, bytes: &[u8]) -> Result<(), PictureError> {
        let mut bits = Bits {
            bytes: &bytes[self.start..],
            at: 0,
            held: 0,
            left: 0,
        };
        for mcu in 0..self.count {
            let hole = || PictureError::Hole {
                part: mcu,
                of: self.count,
            };
            if self.interval > 0 && mcu > 0 && mcu % self.interval == 0 {
                bits.restart(mcu / self.interval).ok_or_else(hole)?;
            }
            for [dc, ac] in &self.blocks {
                block(&mut bits, dc, ac).ok_or_else(hole)?;
            }
        }
        Ok(())
    }
}

/// Passes over a block of 64 coefficients. `None` when the bits end or mean nothing.
fn block(bits: &mut Bits<'_>, dc: &Table, ac: &Table) -> Option<()> {
    let size = dc.read(bits)?;
    bits.skip(size)?;
    let mut k = 1;
    while k < 64 {
        let symbol = ac.read(bits)?;
        let (zeros, size) = (usize::from(symbol >> 4), symbol & 15);
        match (size, zeros) {
            (0, 15) => k += 16,
            (0, _) => return Some(()),
            _ => {
                k += zeros + 1;
                bits.skip(size)?;
            }
        }
    }
    // More than 64: it has lost its way.
    (k == 64).then_some(())
}

/// The bits of a scan, up to a marker.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    held: u32,
    left: u32,
}

impl Bits<'_> {
    fn next(&mut self) -> Option<u32> {
        if self.left == 0 {
            let byte = *self.bytes.get(self.at)?;
            if byte == 0xff {
                // A zero after it is filling; anything else is a marker.
                if self.bytes.get(self.at + 1) != Some(&0) {
                    return None;
                }
                self.at += 1;
            }
            self.at += 1;
            (self.held, self.left) = (u32::from(byte), 8);
        }
        self.left -= 1;
        Some(self.held >> self.left & 1)
    }

    fn skip(&mut self, count: u8) -> Option<()> {
        for _ in 0..count {
            self.next()?;
        }
        Some(())
    }

    /// Passes over the restart marker of that number, which must come next.
    fn restart(&mut self, number: usize) -> Option<()> {
        self.left = 0;
        while self.bytes.get(self.at) == Some(&0xff) && self.bytes.get(self.at + 1) == Some(&0xff) {
            self.at += 1;
        }
        let marker = [0xff, 0xd0 + ((number - 1) % 8) as u8];
        let found = self.bytes.get(self.at..self.at + 2)? == marker;
        self.at += 2;
        found.then_some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::picture::tests::jpeg;

    /// Where the data of the scan begin.
    fn start(bytes: &[u8]) -> usize {
        segments(bytes).find(|s| s.kind == SCAN).unwrap().end
    }

    #[test]
    fn whole_pictures_pass_in_every_shape() {
        for (width, height) in [(1, 1), (7, 9), (16, 16), (17, 33), (64, 48), (333, 101)] {
            let colour = jpeg(width, height, 77);
            assert_eq!(*whole(&colour).unwrap(), colour[..], "{width} {height}");
            let pixels: Vec<u8> = (0..width * height).map(|i| (i * i % 251) as u8).collect();
            for quality in [5, 50, 100] {
                let mut grey = Vec::new();
                JpegEncoder::new_with_quality(&mut grey, quality)
                    .encode(&pixels, width, height, ExtendedColorType::L8)
                    .unwrap();
                assert!(Plan::read(&grey).is_some());
                whole(&grey).unwrap();
            }
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
            assert!(matches!(whole(&cut), Err(PictureError::Hole { .. })), "{k}");
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
        assert_eq!(
            whole(&announced).unwrap_err(),
            PictureError::Hole { part: 4, of: 64 }
        );
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

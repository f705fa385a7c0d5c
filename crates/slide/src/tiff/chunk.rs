//! A strip or tile of a TIFF, row by row: decompressed as it is read, so that one of any size takes no more memory than a row, but for those
//! that are images of their own (JPEG, JPEG 2000) and faxes.

use std::io::{self, BufRead, BufReader, Cursor, Read};

use super::page::{Compression, Page};
use crate::input::Input;
use crate::jpeg::{Colours, Jpeg};
use crate::{Budget, Fault};

/// Bytes read ahead.
const AHEAD: usize = 1 << 14;

/// The bytes of a chunk, decompressed.
fn open<'i>(
    page: &Page,
    input: &'i Input<'_>,
    [at, count]: [u64; 2],
    [rows, samples]: [u32; 2],
    budget: Budget,
) -> Result<Box<dyn Read + 'i>, Fault> {
    let source = BufReader::with_capacity(
        AHEAD,
        Reversed {
            input: input.part(at, count),
            reversed: page.reversed_bits,
        },
    );
    let size = [page.chunk[0], rows];
    let row_bytes = page.layout.row_bytes(size[0], samples as usize);
    let all = || {
        budget.check(size, count)?;
        input.bytes(at, count)
    };
    Ok(match page.compression {
        Compression::None => Box::new(source),
        Compression::Deflate => Box::new(flate2::bufread::ZlibDecoder::new(source)),
        Compression::PackBits => Box::new(PackBits {
            input: source,
            left: 0,
            repeated: None,
        }),
        Compression::Lzw => Box::new(Lzw {
            input: source,
            decoder: weezl::decode::Decoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8),
        }),
        Compression::Zstd => Box::new(
            ruzstd::decoding::StreamingDecoder::new(source)
                .map_err(|e| Fault::Damaged(format!("its zstd data make no sense: {e}")))?,
        ),
        Compression::Fax3 | Compression::Fax4 => {
            budget.check(size, 2 * row_bytes * u64::from(rows) + count)?;
            Box::new(Cursor::new(fax(page, source, size)?))
        }
        Compression::Jpeg => {
            let bytes = all()?;
            let bytes = with_tables(bytes, page.jpeg_tables.as_deref());
            let jpeg = Jpeg::open(bytes, budget)?;
            let [width, height] = jpeg.place.stored;
            if width != size[0] || height < rows {
                return Err(Fault::Damaged(format!(
                    "a tile or strip of {} x {rows} pixels holds a JPEG of {width} x {height}",
                    size[0]
                )));
            }
            let colours = match (page.jpeg_is_rgb, samples) {
                (true, _) | (_, 4) => Colours::Unconverted,
                _ => Colours::Own,
            };
            let (decoded, channels) = jpeg.samples(colours, budget, count)?;
            if channels != samples as usize {
                return Err(Fault::Damaged(format!(
                    "a JPEG of {channels} components stands for {samples} samples"
                )));
            }
            Box::new(Cursor::new(decoded))
        }
        Compression::Jpeg2000 => {
            let (decoded, [width, height], channels) = crate::jpeg2000::decode(&all()?, budget)?;
            if width != size[0] || height < rows || channels != samples as usize {
                return Err(Fault::Damaged(
                    "a tile holds a JPEG 2000 of another shape".into(),
                ));
            }
            Box::new(Cursor::new(decoded))
        }
    })
}

/// Calls `each` with the samples of each row of a chunk that is inside the image, planes put together. Returns false, and calls nothing, for a
/// chunk that was never written.
pub(crate) fn rows(
    page: &Page,
    input: &Input<'_>,
    index: u64,
    budget: Budget,
    mut each: impl FnMut(u32, &[u8]) -> Result<(), Fault>,
) -> Result<bool, Fault> {
    let [_, _, columns, rows] = page.inside(index);
    let one = [0];
    let planes: &[usize] = page.planes.as_deref().unwrap_or(&one);
    let samples = match page.planes {
        Some(_) => 1,
        None => page.layout.samples,
    };
    let mut streams = Vec::with_capacity(planes.len());
    for plane in planes {
        let Some(bytes) = page.bytes_of(*plane, index) else {
            return Ok(false);
        };
        streams.push(open(page, input, bytes, [rows, samples as u32], budget)?);
    }
    let row_bytes = page.layout.row_bytes(page.chunk[0], samples) as usize;
    let mut row = vec![0; row_bytes];
    let mut scratch = Vec::new();
    let sample_bytes = usize::from(page.layout.bits / 8).max(1);
    let mut together = match planes.len() {
        1 => Vec::new(),
        n => vec![0; n * columns as usize * sample_bytes],
    };
    for y in 0..rows {
        for (k, stream) in streams.iter_mut().enumerate() {
            stream.read_exact(&mut row).map_err(|e| fault(&e, index))?;
            unpredict(page, &mut row, &mut scratch, samples);
            if planes.len() > 1 {
                let pixels = together.chunks_exact_mut(planes.len() * sample_bytes);
                for (pixel, sample) in pixels.zip(row.chunks_exact(sample_bytes)) {
                    pixel[k * sample_bytes..][..sample_bytes].copy_from_slice(sample);
                }
            }
        }
        each(y, if planes.len() > 1 { &together } else { &row })?;
    }
    Ok(true)
}

fn fault(e: &io::Error, index: u64) -> Fault {
    Fault::Damaged(match e.kind() {
        io::ErrorKind::UnexpectedEof => format!("tile or strip {index} holds too few samples"),
        _ => format!("tile or strip {index}: {e}"),
    })
}

/// Undoes the differences in a row.
fn unpredict(page: &Page, row: &mut [u8], scratch: &mut Vec<u8>, samples: usize) {
    let bytes = usize::from(page.layout.bits / 8).max(1);
    let big = page.layout.big_endian;
    match (page.predictor, bytes) {
        (2, 1) => {
            for i in samples..row.len() {
                row[i] = row[i].wrapping_add(row[i - samples]);
            }
        }
        (2, _) => {
            let number = |b: &[u8]| {
                let fold = |v: u64, b: &u8| v << 8 | u64::from(*b);
                match big {
                    true => b.iter().fold(0, fold),
                    false => b.iter().rev().fold(0, fold),
                }
            };
            for i in (samples * bytes..row.len() / bytes * bytes).step_by(bytes) {
                let before = number(&row[i - samples * bytes..][..bytes]);
                let sum = number(&row[i..i + bytes]).wrapping_add(before);
                match big {
                    true => row[i..i + bytes].copy_from_slice(&sum.to_be_bytes()[8 - bytes..]),
                    false => row[i..i + bytes].copy_from_slice(&sum.to_le_bytes()[..bytes]),
                }
            }
        }
        (3, _) => {
            for i in samples..row.len() {
                row[i] = row[i].wrapping_add(row[i - samples]);
            }
            // All high bytes lie first, then the next ones.
            scratch.clear();
            scratch.extend_from_slice(row);
            let n = row.len() / bytes;
            for i in 0..n {
                for k in 0..bytes {
                    let to = if big { k } else { bytes - 1 - k };
                    row[i * bytes + to] = scratch[k * n + i];
                }
            }
        }
        _ => {}
    }
}

/// A JPEG with the tables that stand in the directory.
fn with_tables(bytes: Vec<u8>, tables: Option<&[u8]>) -> Vec<u8> {
    match tables.and_then(|t| t.strip_suffix(&[0xff, 0xd9])) {
        Some(tables) if bytes.starts_with(&[0xff, 0xd8]) => [tables, &bytes[2..]].concat(),
        _ => bytes,
    }
}

/// Black and white as faxes send it, packed from the high bit on, where 0 is white.
fn fax(page: &Page, source: impl BufRead, [width, rows]: [u32; 2]) -> Result<Vec<u8>, Fault> {
    let bad = || Fault::Damaged("its fax data make no sense".into());
    let (Ok(width), Ok(rows)) = (u16::try_from(width), u16::try_from(rows)) else {
        return Err(Fault::Unsupported(
            "a fax of more than 65535 pixels each way".into(),
        ));
    };
    let row_bytes = usize::from(width).div_ceil(8);
    let mut out = Vec::with_capacity(row_bytes * usize::from(rows));
    let mut line = |changes: &[u16]| {
        if out.len() < row_bytes * usize::from(rows) {
            let from = out.len();
            out.resize(from + row_bytes, 0);
            for (x, pel) in fax::decoder::pels(changes, width).enumerate() {
                if pel == fax::Color::Black {
                    out[from + x / 8] |= 0x80 >> (x % 8);
                }
            }
        }
    };
    let bytes = source.bytes().map_while(Result::ok);
    match page.compression {
        Compression::Fax4 => fax::decoder::decode_g4(bytes, width, Some(rows), &mut line),
        _ => fax::decoder::decode_g3(bytes, &mut line),
    }
    .ok_or_else(bad)?;
    match out.len() == row_bytes * usize::from(rows) {
        true => Ok(out),
        false => Err(bad()),
    }
}

/// Bytes whose bits may run the other way.
struct Reversed<R> {
    input: R,
    reversed: bool,
}

impl<R: Read> Read for Reversed<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.input.read(buffer)?;
        if self.reversed {
            buffer[..n].iter_mut().for_each(|b| *b = b.reverse_bits());
        }
        Ok(n)
    }
}

/// Runs of bytes.
struct PackBits<R> {
    input: R,
    left: usize,
    repeated: Option<u8>,
}

impl<R: BufRead> PackBits<R> {
    fn next(&mut self) -> io::Result<Option<u8>> {
        let mut byte = [0];
        Ok((self.input.read(&mut byte)? == 1).then_some(byte[0]))
    }
}

impl<R: BufRead> Read for PackBits<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.left == 0 {
            let Some(head) = self.next()? else {
                return Ok(0);
            };
            (self.left, self.repeated) = match head {
                0..=127 => (usize::from(head) + 1, None),
                128 => (0, None),
                _ => (257 - usize::from(head), self.next()?),
            };
            if head > 128 && self.repeated.is_none() {
                return Ok(0);
            }
        }
        let n = self.left.min(buffer.len());
        let n = match self.repeated {
            Some(byte) => {
                buffer[..n].fill(byte);
                n
            }
            None => self.input.read(&mut buffer[..n])?,
        };
        self.left -= n;
        Ok(n)
    }
}

/// The codes of Lempel, Ziv and Welch.
struct Lzw<R> {
    input: R,
    decoder: weezl::decode::Decoder,
}

impl<R: BufRead> Read for Lzw<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if buffer.is_empty() {
            return Ok(0);
        }
        loop {
            let input = self.input.fill_buf()?;
            let ended = input.is_empty();
            let result = self.decoder.decode_bytes(input, buffer);
            self.input.consume(result.consumed_in);
            let status = result
                .status
                .map_err(|e| io::Error::new(io::ErrorKind::InvalidData, e.to_string()))?;
            let stuck = ended || matches!(status, weezl::LzwStatus::Done);
            if result.consumed_out > 0 || stuck {
                return Ok(result.consumed_out);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_bytes() {
        let unpack = |bytes: &'static [u8]| {
            let mut out = Vec::new();
            let mut packed = PackBits {
                input: bytes,
                left: 0,
                repeated: None,
            };
            packed.read_to_end(&mut out).unwrap();
            out
        };
        // The example of the TIFF standard, of Apple's note.
        let packed = b"\xfe\xaa\x02\x80\x00\x2a\xfd\xaa\x03\x80\x00\x2a\x22\xf7\xaa";
        let mut want = vec![
            0xaa, 0xaa, 0xaa, 0x80, 0, 0x2a, 0xaa, 0xaa, 0xaa, 0xaa, 0x80, 0, 0x2a, 0x22,
        ];
        want.extend([0xaa; 10]);
        assert_eq!(unpack(packed), want);
        assert_eq!(unpack(b"\x80\x80\x00x"), b"x");
        assert_eq!(unpack(b"\xff"), b"");
        assert_eq!(unpack(b"\x05ab"), b"ab");
    }
}

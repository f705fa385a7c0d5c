//! TIFF pages: which of them are levels, and their tiles or strips decoded one by one.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use tiff::decoder::{ChunkType, Decoder, DecodingResult, Limits};
use tiff::tags::{CompressionMethod, Tag};
use tiff::{ColorType, TiffResult};

use crate::cache::Lru;
use crate::raster::{luma, over_white_8, over_white_16, to_8, ycbcr_to_rgb};
use crate::{Gray, Rgb8, SlideError, TILE_CACHE_BYTES};

type Reader = Decoder<BufReader<File>>;

/// Largest tile or strip, decoded, bytes: a whole gigapixel RGB image stored as one strip.
const MAX_CHUNK_BYTES: usize = 3 << 30;
/// Pages looked at before the file is taken for something other than a pyramid.
const MAX_PAGES: usize = 1000;
/// Pixel sizes that a microscope can have, um. Others are print resolutions.
const PLAUSIBLE_UM: std::ops::RangeInclusive<f64> = 0.05..=50.0;

/// The pages of one TIFF file that are levels of one picture, finest first.
#[derive(Debug)]
pub(crate) struct TiffPages {
    path: PathBuf,
    pages: Vec<Page>,
    um_per_px: Option<f64>,
    tiles: Lru<(usize, u32), Rgb8>,
}

/// One level. Each has its own reader, placed on its page once: finding a page again reads all its tile offsets.
struct Page {
    reader: Mutex<Reader>,
    width: u32,
    height: u32,
    chunk_w: u32,
    chunk_h: u32,
    layout: Layout,
    deep: bool,
    tiled: bool,
}

impl std::fmt::Debug for Page {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "Page({} x {} in {} x {})",
            self.width, self.height, self.chunk_w, self.chunk_h
        )
    }
}

/// Samples of one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Layout {
    Gray,
    GrayAlpha,
    Rgb,
    Rgba,
    YCbCr,
}

impl TiffPages {
    pub(crate) fn open(path: &Path) -> Result<Self, SlideError> {
        let tiff = |e| SlideError::from_tiff(path, e);
        let mut scan = reader(path)?;
        let mut seen = Vec::new();
        loop {
            let (width, height) = scan.dimensions().map_err(tiff)?;
            seen.push((
                seen.len(),
                width,
                height,
                scan.get_chunk_type() == ChunkType::Tile,
            ));
            if !scan.more_images() || seen.len() == MAX_PAGES {
                break;
            }
            // A later page of an unknown kind (a mask, a palette label) does not spoil the picture.
            if scan.next_image().is_err() {
                break;
            }
        }
        let mut pages = Vec::new();
        for index in levels_among(&seen) {
            pages.push(Page::open(path, index)?);
        }
        let um_per_px = pages.first().and_then(Page::um_per_px);
        Ok(Self {
            path: path.to_path_buf(),
            pages,
            um_per_px,
            tiles: Lru::new(TILE_CACHE_BYTES),
        })
    }

    pub(crate) fn len(&self) -> usize {
        self.pages.len()
    }

    pub(crate) fn size(&self, level: usize) -> (u32, u32) {
        (self.pages[level].width, self.pages[level].height)
    }

    /// More than 8 bits per sample.
    pub(crate) fn is_deep(&self, level: usize) -> bool {
        self.pages[level].deep
    }

    pub(crate) fn is_tiled(&self) -> bool {
        self.pages[0].tiled
    }

    pub(crate) fn um_per_px(&self) -> Option<f64> {
        self.um_per_px
    }

    /// A region by its tiles or strips. `x` and `y` are far from overflow.
    pub(crate) fn read_rgb8(
        &self,
        level: usize,
        x: i64,
        y: i64,
        w: u32,
        h: u32,
        outside: [u8; 3],
    ) -> Result<Rgb8, SlideError> {
        let page = &self.pages[level];
        let mut out = Rgb8::filled(w, h, outside);
        for (index, cx, cy) in page.chunks_in(x, y, w, h) {
            let key = (level, index);
            let chunk = match self.tiles.get(&key) {
                Some(chunk) => chunk,
                None => {
                    let chunk = Arc::new(page.decode_rgb8(&self.path, index)?);
                    if self.is_tiled() {
                        self.tiles.put(key, Arc::clone(&chunk), chunk.data.len());
                    }
                    chunk
                }
            };
            out.paste(&chunk, cx - x, cy - y);
        }
        Ok(out)
    }

    pub(crate) fn read_gray(&self, level: usize) -> Result<Gray, SlideError> {
        let page = &self.pages[level];
        let (width, height) = (page.width as usize, page.height as usize);
        let mut data = vec![0.0; width * height];
        for (index, cx, cy) in page.chunks_in(0, 0, page.width, page.height) {
            let chunk = page.decode_gray(&self.path, index)?;
            for (j, row) in chunk.data.chunks_exact(chunk.width).enumerate() {
                let at = (cy as usize + j) * width + cx as usize;
                data[at..at + chunk.width].copy_from_slice(row);
            }
        }
        Ok(Gray {
            width,
            height,
            data,
        })
    }
}

impl Page {
    fn open(path: &Path, index: usize) -> Result<Self, SlideError> {
        let tiff = |e| SlideError::from_tiff(path, e);
        let mut reader = reader(path)?;
        reader.seek_to_image(index).map_err(tiff)?;
        let (width, height) = reader.dimensions().map_err(tiff)?;
        if width == 0 || height == 0 {
            SlideError::check_size(path, width, height)?;
        }
        let compression = reader
            .find_tag_unsigned::<u16>(Tag::Compression)
            .map_err(tiff)?;
        if let Some(33003 | 33005 | 34712) = compression {
            return Err(SlideError::unsupported(path, "JPEG 2000 compression"));
        }
        if reader
            .find_tag_unsigned::<u16>(Tag::PlanarConfiguration)
            .map_err(tiff)?
            == Some(2)
        {
            return Err(SlideError::unsupported(
                path,
                "a TIFF with one plane per colour",
            ));
        }
        let jpeg = compression == Some(CompressionMethod::ModernJPEG.to_u16());
        let (layout, deep) = layout_of(path, &mut reader, jpeg)?;
        check_chunks_in_file(path, &mut reader)?;
        let (chunk_w, chunk_h) = reader.chunk_dimensions();
        SlideError::check_size(path, chunk_w, chunk_h.min(height))?;
        let tiled = reader.get_chunk_type() == ChunkType::Tile;
        Ok(Self {
            reader: Mutex::new(reader),
            width,
            height,
            chunk_w,
            chunk_h,
            layout,
            deep,
            tiled,
        })
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Reader> {
        // The reader seeks before every read, so a panic elsewhere does not spoil it.
        self.reader.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Index and first pixel of every chunk that touches the region.
    fn chunks_in(
        &self,
        x: i64,
        y: i64,
        w: u32,
        h: u32,
    ) -> impl Iterator<Item = (u32, i64, i64)> + use<> {
        let (cw, ch) = (i64::from(self.chunk_w), i64::from(self.chunk_h));
        let across = i64::from(self.width.div_ceil(self.chunk_w));
        let span = |from: i64, n: u32, size: u32, chunk: i64| {
            let (a, b) = (from.max(0), (from + i64::from(n)).min(size.into()));
            if b > a {
                a / chunk..(b - 1) / chunk + 1
            } else {
                0..0
            }
        };
        let columns = span(x, w, self.width, cw);
        span(y, h, self.height, ch).flat_map(move |r| {
            columns
                .clone()
                .map(move |c| ((r * across + c) as u32, c * cw, r * ch))
        })
    }

    fn decode(&self, path: &Path, index: u32) -> Result<(u32, u32, DecodingResult), SlideError> {
        let mut reader = self.lock();
        let (w, h) = reader.chunk_data_dimensions(index);
        let samples = reader
            .read_chunk(index)
            .map_err(|e| SlideError::from_tiff(path, e))?;
        let have = match &samples {
            DecodingResult::U8(v) => v.len(),
            DecodingResult::U16(v) => v.len(),
            _ => 0,
        };
        if have < w as usize * h as usize * self.layout.samples() {
            return Err(SlideError::damaged(
                path,
                format!("tile {index} holds too few samples"),
            ));
        }
        Ok((w, h, samples))
    }

    fn decode_rgb8(&self, path: &Path, index: u32) -> Result<Rgb8, SlideError> {
        let (width, height, samples) = self.decode(path, index)?;
        let n = width as usize * height as usize;
        let data = match samples {
            DecodingResult::U8(mut v) if self.layout == Layout::Rgb => {
                v.truncate(3 * n);
                v
            }
            samples => {
                let mut data = Vec::with_capacity(3 * n);
                self.for_each(&samples, n, |p| match p {
                    Colour::Bits8(rgb) => data.extend(rgb),
                    Colour::Bits16(rgb) => data.extend(rgb.map(to_8)),
                });
                data
            }
        };
        Ok(Rgb8 {
            width,
            height,
            data,
        })
    }

    fn decode_gray(&self, path: &Path, index: u32) -> Result<Gray, SlideError> {
        let (w, h, samples) = self.decode(path, index)?;
        let (width, height) = (w as usize, h as usize);
        let mut data = Vec::with_capacity(width * height);
        self.for_each(&samples, width * height, |p| {
            data.push(match p {
                Colour::Bits8([r, g, b]) => luma(r.into(), g.into(), b.into(), 255.0),
                Colour::Bits16([r, g, b]) => luma(r.into(), g.into(), b.into(), 65535.0),
            });
        });
        Ok(Gray {
            width,
            height,
            data,
        })
    }

    /// Calls `each` with the opaque colour of the first `n` pixels.
    fn for_each(&self, samples: &DecodingResult, n: usize, mut each: impl FnMut(Colour)) {
        let k = self.layout.samples();
        match samples {
            DecodingResult::U8(v) => {
                for p in v.chunks_exact(k).take(n) {
                    each(Colour::Bits8(match self.layout {
                        Layout::Gray => [p[0]; 3],
                        Layout::GrayAlpha => [over_white_8(p[0], p[1]); 3],
                        Layout::Rgb => [p[0], p[1], p[2]],
                        Layout::Rgba => [p[0], p[1], p[2]].map(|c| over_white_8(c, p[3])),
                        Layout::YCbCr => ycbcr_to_rgb([p[0], p[1], p[2]]),
                    }));
                }
            }
            DecodingResult::U16(v) => {
                for p in v.chunks_exact(k).take(n) {
                    each(Colour::Bits16(match self.layout {
                        Layout::Gray => [p[0]; 3],
                        Layout::GrayAlpha => [over_white_16(p[0], p[1]); 3],
                        Layout::Rgba => [p[0], p[1], p[2]].map(|c| over_white_16(c, p[3])),
                        Layout::Rgb | Layout::YCbCr => [p[0], p[1], p[2]],
                    }));
                }
            }
            _ => {}
        }
    }

    fn um_per_px(&self) -> Option<f64> {
        let mut reader = self.lock();
        let text = reader
            .get_tag_ascii_string(Tag::ImageDescription)
            .unwrap_or_default();
        if let Some(mpp) = aperio_mpp(&text) {
            return Some(mpp);
        }
        let um_per_unit = match reader.find_tag_unsigned::<u16>(Tag::ResolutionUnit) {
            Ok(Some(2)) => 25_400.0,
            Ok(Some(3)) => 10_000.0,
            _ => return None,
        };
        let x = um_per_unit / rational(&mut reader, Tag::XResolution)?;
        let y = um_per_unit / rational(&mut reader, Tag::YResolution)?;
        let um = 0.5 * (x + y);
        (PLAUSIBLE_UM.contains(&x) && PLAUSIBLE_UM.contains(&y)).then_some(um)
    }
}

enum Colour {
    Bits8([u8; 3]),
    Bits16([u16; 3]),
}

impl Layout {
    fn samples(self) -> usize {
        match self {
            Layout::Gray => 1,
            Layout::GrayAlpha => 2,
            Layout::Rgb | Layout::YCbCr => 3,
            Layout::Rgba => 4,
        }
    }
}

fn reader(path: &Path) -> Result<Reader, SlideError> {
    let file = File::open(path).map_err(|e| SlideError::io(path, e))?;
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_CHUNK_BYTES;
    limits.intermediate_buffer_size = MAX_CHUNK_BYTES;
    // Offsets of a gigapixel of small tiles, and no more.
    limits.ifd_value_size = 64 << 20;
    Decoder::new(BufReader::new(file))
        .map(|d| d.with_limits(limits))
        .map_err(|e| SlideError::from_tiff(path, e))
}

/// The pages that are one picture at falling resolution, given (page, width, height, tiled).
///
/// A file with tiled pages is a pyramid of those; its stripped pages are thumbnail, label and macro. A file without is
/// its first page.
fn levels_among(pages: &[(usize, u32, u32, bool)]) -> Vec<usize> {
    let area = |w: u32, h: u32| u64::from(w) * u64::from(h);
    let tiled: Vec<_> = pages.iter().filter(|p| p.3).collect();
    let Some(&&(_, w0, h0, _)) = tiled.iter().rev().max_by_key(|&&&(_, w, h, _)| area(w, h)) else {
        return vec![0];
    };
    let mut levels: Vec<_> = tiled
        .into_iter()
        .filter(|&&(_, w, h, _)| {
            let expected = f64::from(h0) * f64::from(w) / f64::from(w0);
            (f64::from(h) - expected).abs() <= (0.01 * expected).max(2.0)
        })
        .collect();
    levels.sort_by_key(|&&(page, w, h, _)| (std::cmp::Reverse(area(w, h)), page));
    levels.dedup_by_key(|&mut &(_, w, h, _)| (w, h));
    levels.into_iter().map(|p| p.0).collect()
}

fn layout_of(path: &Path, reader: &mut Reader, jpeg: bool) -> Result<(Layout, bool), SlideError> {
    let tiff = |e| SlideError::from_tiff(path, e);
    if let Some(kind) = sample_format(reader).map_err(tiff)?
        && kind != 1
    {
        return Err(SlideError::unsupported(
            path,
            "a TIFF of signed or floating-point samples",
        ));
    }
    let photometric = reader
        .find_tag_unsigned::<u16>(Tag::PhotometricInterpretation)
        .map_err(tiff)?;
    if photometric == Some(3) {
        return Err(SlideError::unsupported(
            path,
            "a TIFF with a colour palette",
        ));
    }
    let colour = reader.colortype().map_err(tiff)?;
    let alpha = reader
        .find_tag_unsigned_vec::<u16>(Tag::ExtraSamples)
        .map_err(tiff)?
        .is_some_and(|v| matches!(v.first(), Some(1 | 2)));
    let (layout, bits) = match colour {
        ColorType::Gray(bits) => (Layout::Gray, bits),
        ColorType::Multiband {
            bit_depth,
            num_samples: 2,
        } if alpha => (Layout::GrayAlpha, bit_depth),
        ColorType::RGB(bits) => (Layout::Rgb, bits),
        ColorType::RGBA(bits) => (Layout::Rgba, bits),
        ColorType::YCbCr(8) if jpeg => (Layout::YCbCr, 8),
        other => {
            return Err(SlideError::unsupported(
                path,
                format!("a TIFF of pixel kind {other:?}"),
            ));
        }
    };
    if bits != 8 && bits != 16 {
        return Err(SlideError::unsupported(
            path,
            format!("a TIFF of {bits} bits per sample"),
        ));
    }
    Ok((layout, bits == 16))
}

fn sample_format(reader: &mut Reader) -> TiffResult<Option<u16>> {
    let formats = reader.find_tag_unsigned_vec::<u16>(Tag::SampleFormat)?;
    Ok(formats.and_then(|v| v.first().copied()))
}

/// A cut file is found out here, not in the middle of a run.
fn check_chunks_in_file(path: &Path, reader: &mut Reader) -> Result<(), SlideError> {
    let length = reader
        .inner()
        .get_ref()
        .metadata()
        .map_err(|e| SlideError::io(path, e))?
        .len();
    let (offsets, counts) = match reader.get_chunk_type() {
        ChunkType::Tile => (Tag::TileOffsets, Tag::TileByteCounts),
        ChunkType::Strip => (Tag::StripOffsets, Tag::StripByteCounts),
    };
    let tiff = |e| SlideError::from_tiff(path, e);
    let offsets = reader.get_tag_u64_vec(offsets).map_err(tiff)?;
    let counts = reader.get_tag_u64_vec(counts).map_err(tiff)?;
    let end = offsets
        .iter()
        .zip(&counts)
        .map(|(&at, &n)| at.saturating_add(n))
        .max()
        .unwrap_or(0);
    if end > length {
        let why = format!("the image data needs {end} bytes and the file has {length}");
        return Err(SlideError::truncated(path, why));
    }
    Ok(())
}

/// `MPP = 0.4990` in an Aperio description.
fn aperio_mpp(description: &str) -> Option<f64> {
    if !description.starts_with("Aperio") {
        return None;
    }
    let value = description
        .split('|')
        .filter_map(|field| field.split_once('='))
        .find(|(key, _)| key.trim() == "MPP")?
        .1;
    let mpp: f64 = value.trim().trim_end_matches('\0').parse().ok()?;
    PLAUSIBLE_UM.contains(&mpp).then_some(mpp)
}

fn rational(reader: &mut Reader, tag: Tag) -> Option<f64> {
    use tiff::decoder::ifd::Value;
    let (n, d) = match reader.find_tag(tag).ok()?? {
        Value::Rational(n, d) => (f64::from(n), f64::from(d)),
        _ => return None,
    };
    (n > 0.0 && d > 0.0).then_some(n / d)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_the_tiled_pages_of_one_shape() {
        // As in an SVS: level 0, thumbnail (strips), level 1, label and macro (strips), and a tiled stranger.
        let pages = [
            (0, 4000, 3000, true),
            (1, 1024, 768, false),
            (2, 1000, 750, true),
            (3, 387, 463, false),
            (4, 1280, 431, false),
            (5, 500, 700, true),
            (6, 250, 187, true),
        ];
        assert_eq!(levels_among(&pages), [0, 2, 6]);
        assert_eq!(levels_among(&pages[1..2]), [0]);
    }

    #[test]
    fn mpp_is_read_from_aperio_only() {
        assert_eq!(
            aperio_mpp("Aperio Image\r\n1x1|AppMag = 20|MPP = 0.4990|Left = 2"),
            Some(0.499)
        );
        assert_eq!(aperio_mpp("Aperio|AppMag = 20"), None);
        assert_eq!(aperio_mpp("Other|MPP = 0.5"), None);
        assert_eq!(aperio_mpp("Aperio|MPP = 0"), None);
    }
}

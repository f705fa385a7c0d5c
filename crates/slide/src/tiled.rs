//! TIFF pages: which of them are levels, and their tiles or strips decoded one by one.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use tiff::decoder::{ChunkType, Decoder, DecodingResult, Limits};
use tiff::tags::{CompressionMethod, Tag};

use crate::cache::Lru;
use crate::raster::{luma, over_white_8, over_white_16, to_8, ycbcr_to_rgb};
use crate::tags::{self, Layout, Reader};
use crate::{Gray, Rgb8, SlideError, TILE_CACHE_BYTES};

/// Largest tile or strip, decoded, bytes: a whole gigapixel RGB image stored as one strip.
const MAX_CHUNK_BYTES: usize = 3 << 30;
/// Pages looked at before the file is taken for something other than a pyramid.
const MAX_PAGES: usize = 1000;

/// The pages of one TIFF file that are levels of one image, finest first.
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
            // A later page of an unknown kind (a mask, a palette label) does not spoil the image.
            if scan.next_image().is_err() {
                break;
            }
        }
        let mut pages = Vec::new();
        for index in tags::levels_among(&seen) {
            pages.push(Page::open(path, index)?);
        }
        let um_per_px = pages.first().and_then(|p| tags::um_per_px(&mut p.lock()));
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
        let (layout, deep) = tags::layout_of(path, &mut reader, jpeg)?;
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
}

enum Colour {
    Bits8([u8; 3]),
    Bits16([u16; 3]),
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

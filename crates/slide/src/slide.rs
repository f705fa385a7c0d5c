//! The slide: one file, its levels, and regions of them.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use crate::cache::Lru;
use crate::input::Input;
use crate::orientation::Orientation;
use crate::sink::{Place, RgbSink, Sink};
use crate::source::Source;
use crate::tiff::Tiff;
use crate::{Choices, Fault, Gray, Rgb8, SlideError, TILE_CACHE_BYTES, Wanted};

/// One resolution of a slide.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelInfo {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Level-0 pixels per pixel of this level, mean of x and y. Level 0 has 1.
    pub downsample: f64,
}

/// An image file opened for reading by regions. Shared freely between threads.
#[derive(Debug)]
pub struct Slide {
    path: PathBuf,
    levels: Vec<LevelInfo>,
    source: Source<'static>,
    /// The finest level of a file that is not read by tiles, with what is shown where the file says nothing.
    whole: Mutex<Option<(Arc<Rgb8>, [u8; 3])>>,
    tiles: Lru<(usize, u64), Option<Rgb8>>,
}

impl Slide {
    /// Opens a PNG, JPEG, JPEG 2000, TIFF or SVS file, judged by its first bytes.
    ///
    /// # Errors
    /// As [`Slide::open_as`].
    pub fn open(path: &Path) -> Result<Self, SlideError> {
        Self::open_as(path, &Wanted::default())
    }

    /// Opens one image of a file. A JPEG is looked through to its end; of others what is damaged is found when it is read.
    ///
    /// # Errors
    /// A missing, empty, cut, damaged, oversized or unsupported file, a page or channel that is not there, each as its own [`SlideError`].
    pub fn open_as(path: &Path, wanted: &Wanted) -> Result<Self, SlideError> {
        let opened = Input::open(path)
            .and_then(|input| Source::open(input, wanted.choice, wanted.budget, wanted.alpha));
        let source = opened.map_err(|fault| SlideError::of(path, fault))?;
        let [width, height] = source.place(0).shown();
        let levels = (0..source.levels())
            .map(|k| {
                let [w, h] = source.place(k).shown();
                let ratio =
                    [(width, w), (height, h)].map(|(full, part)| f64::from(full) / f64::from(part));
                LevelInfo {
                    width: w,
                    height: h,
                    downsample: 0.5 * (ratio[0] + ratio[1]),
                }
            })
            .collect();
        Ok(Self {
            path: path.to_path_buf(),
            levels,
            source,
            whole: Mutex::new(None),
            tiles: Lru::new(TILE_CACHE_BYTES),
        })
    }

    /// The resolutions, finest first; at least one.
    #[must_use]
    pub fn levels(&self) -> &[LevelInfo] {
        &self.levels
    }

    /// Pixel size of level 0 in micrometres, when the file states it: OME-XML, the `MPP` of an SVS, ImageJ's text, or TIFF resolution tags
    /// with a unit, where it is 0.01 to 50 um. Print resolutions and PNG `pHYs` are not believed.
    #[must_use]
    pub fn um_per_px(&self) -> Option<f64> {
        self.source.um_per_px()
    }

    /// The pages and channels that the file has, and which is looked at.
    #[must_use]
    pub fn choices(&self) -> Choices {
        self.source.choices()
    }

    /// The `w` x `h` region of `level` whose first pixel is column `x`, row `y` of that level. What lies outside the
    /// level, and tiles that were never written, have the colour `outside`. Alpha is composited on white.
    ///
    /// # Errors
    /// [`SlideError::Level`] for a level that is not there, [`SlideError::TooLarge`] for more memory than there may be, and what
    /// reading and decoding may meet.
    pub fn read_rgb8(
        &self,
        level: usize,
        x: i64,
        y: i64,
        w: u32,
        h: u32,
        outside: [u8; 3],
    ) -> Result<Rgb8, SlideError> {
        self.region(level, [x, y], [w, h], outside)
            .map_err(|fault| SlideError::of(&self.path, fault))
    }

    fn region(
        &self,
        level: usize,
        [x, y]: [i64; 2],
        [w, h]: [u32; 2],
        outside: [u8; 3],
    ) -> Result<Rgb8, Fault> {
        self.source.check_level(level)?;
        let bytes = 3 * u64::from(w) * u64::from(h);
        self.source.budget.check([w, h], bytes)?;
        // Far outside is as good as just outside, and cannot overflow.
        let far = i64::from(u32::MAX) * 2;
        let (x, y) = (x.clamp(-far, far), y.clamp(-far, far));
        if let Some(tiff) = self.source.tiff().filter(|t| self.by_chunks(t, level)) {
            return self.by_tiles(tiff, level, [x, y, w.into(), h.into()], outside);
        }
        let mut out = Rgb8::filled(w, h, outside);
        out.paste(&*self.whole(outside)?, -x, -y);
        Ok(out)
    }

    /// Whether a level is read tile by tile, or strip by strip where all of it is too much.
    fn by_chunks(&self, tiff: &Tiff, level: usize) -> bool {
        let [w, h] = self.source.place(level).stored.map(u64::from);
        tiff.is_tiled() || level > 0 || 3 * w * h > self.source.budget.bytes
    }

    /// The finest level of what is held in one piece.
    fn whole(&self, outside: [u8; 3]) -> Result<Arc<Rgb8>, Fault> {
        let mut held = self.whole.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((whole, _)) = held.as_ref().filter(|(_, o)| *o == outside) {
            return Ok(Arc::clone(whole));
        }
        // Not two at a time.
        *held = None;
        let whole = Arc::new(self.source.rgb8(0, outside)?);
        *held = Some((Arc::clone(&whole), outside));
        Ok(whole)
    }

    fn by_tiles(
        &self,
        tiff: &Tiff,
        level: usize,
        shown: [i64; 4],
        outside: [u8; 3],
    ) -> Result<Rgb8, Fault> {
        let Place {
            stored,
            orientation,
        } = self.source.place(level);
        let from @ [x, y, w, h] = orientation.stored(stored, shown);
        let mut out = Rgb8::filled(w as u32, h as u32, outside);
        for (index, [cx, cy, columns, rows]) in tiff.chunks_in(level, from) {
            let key = (level, index);
            let chunk = match self.tiles.get(&key) {
                Some(chunk) => chunk,
                None => {
                    let size = [columns, rows];
                    self.source.budget.check(size, tiff.chunk_bytes(level))?;
                    let place = Place {
                        stored: size,
                        orientation: Orientation::default(),
                    };
                    let mut sink = RgbSink::new(place, outside);
                    let written = tiff.chunk(
                        &self.source.input,
                        level,
                        index,
                        self.source.budget,
                        &mut sink,
                    )?;
                    let chunk = Arc::new(written.then_some(sink.out));
                    let bytes = chunk.as_ref().as_ref().map_or(64, |c| c.data.len());
                    self.tiles.put(key, Arc::clone(&chunk), bytes);
                    chunk
                }
            };
            if let Some(chunk) = chunk.as_ref() {
                out.paste(chunk, i64::from(cx) - x, i64::from(cy) - y);
            }
        }
        Ok(upright(out, orientation))
    }

    /// A whole level as grey, 0 to 1: Rec. 601 luma, alpha composited on white, 16-bit precision kept.
    ///
    /// # Errors
    /// As [`Slide::read_rgb8`].
    pub fn read_gray(&self, level: usize) -> Result<Gray, SlideError> {
        Ok(self.read_gray_reduced(level, u64::MAX)?.0)
    }

    /// A whole level as grey, as means of blocks of so many pixels each way that at most `most` remain; and how many. It is reduced while it is
    /// decoded: what is held is the result.
    ///
    /// # Errors
    /// As [`Slide::read_rgb8`].
    pub fn read_gray_reduced(&self, level: usize, most: u64) -> Result<(Gray, usize), SlideError> {
        self.source
            .check_level(level)
            .and_then(|()| self.source.gray(level, most))
            .map_err(|fault| SlideError::of(&self.path, fault))
    }
}

/// A stored region as it is shown.
fn upright(stored: Rgb8, orientation: Orientation) -> Rgb8 {
    if orientation.is_upright() {
        return stored;
    }
    let place = Place {
        stored: [stored.width, stored.height],
        orientation,
    };
    let mut sink = RgbSink::new(place, [0; 3]);
    for (y, row) in stored
        .data
        .chunks_exact(3 * (stored.width as usize).max(1))
        .enumerate()
    {
        let values = crate::layout::Values::U8(row.to_vec());
        let row = crate::layout::Row {
            channels: 3,
            values,
        };
        sink.row(0, y as u32, 1, &row);
    }
    sink.out
}

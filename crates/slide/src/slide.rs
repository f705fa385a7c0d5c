//! The slide: one file, its levels, and regions of them.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use image::ImageFormat;

use crate::raster::luma;
use crate::tiled::TiffPages;
use crate::{Gray, Rgb8, SlideError, whole};

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
    um_per_px: Option<f64>,
    source: Source,
}

#[derive(Debug)]
enum Source {
    /// PNG or JPEG in memory. `deep`: the file has 16 bits per channel.
    Whole {
        rgb: Rgb8,
        deep: bool,
        format: ImageFormat,
    },
    /// Stripped TIFF in memory; the pages serve only for 16-bit grey.
    Strips { rgb: Rgb8, pages: TiffPages },
    /// Tiled TIFF on disk.
    Tiles(TiffPages),
}

impl Slide {
    /// Opens a PNG, JPEG, TIFF or SVS file, judged by its first bytes.
    ///
    /// # Errors
    /// A missing, empty, cut, damaged, oversized or unsupported file, each as its own [`SlideError`].
    pub fn open(path: &Path) -> Result<Self, SlideError> {
        match sniff(path)? {
            Kind::Raster(format) => {
                let (rgb, deep) = whole::decode_rgb8(path, format)?;
                Ok(Self {
                    path: path.to_path_buf(),
                    levels: vec![LevelInfo {
                        width: rgb.width,
                        height: rgb.height,
                        downsample: 1.0,
                    }],
                    um_per_px: None,
                    source: Source::Whole { rgb, deep, format },
                })
            }
            Kind::Tiff => {
                let pages = TiffPages::open(path)?;
                let (width, height) = pages.size(0);
                let levels = (0..pages.len())
                    .map(|i| {
                        let (w, h) = pages.size(i);
                        let ratio = [(width, w), (height, h)]
                            .map(|(full, part)| f64::from(full) / f64::from(part));
                        LevelInfo {
                            width: w,
                            height: h,
                            downsample: 0.5 * (ratio[0] + ratio[1]),
                        }
                    })
                    .collect();
                let um_per_px = pages.um_per_px();
                let source = if pages.is_tiled() {
                    Source::Tiles(pages)
                } else {
                    SlideError::check_size(path, width, height)?;
                    let rgb = pages.read_rgb8(0, 0, 0, width, height, [255; 3])?;
                    Source::Strips { rgb, pages }
                };
                Ok(Self {
                    path: path.to_path_buf(),
                    levels,
                    um_per_px,
                    source,
                })
            }
        }
    }

    /// The resolutions, finest first; at least one.
    #[must_use]
    pub fn levels(&self) -> &[LevelInfo] {
        &self.levels
    }

    /// Pixel size of level 0 in micrometres, when the file states it: the `MPP` of an SVS, or TIFF resolution tags with
    /// a unit that give 0.05 to 50 um. Print resolutions and PNG `pHYs` are not believed.
    #[must_use]
    pub fn um_per_px(&self) -> Option<f64> {
        self.um_per_px
    }

    /// The `w` x `h` region of `level` whose first pixel is column `x`, row `y` of that level. What lies outside the
    /// level has the colour `outside`. Alpha is composited on white.
    ///
    /// # Errors
    /// [`SlideError::Level`] for a level that is not there, [`SlideError::TooLarge`] for a region over
    /// [`crate::MAX_PIXELS`], and what reading and decoding tiles may meet.
    pub fn read_rgb8(
        &self,
        level: usize,
        x: i64,
        y: i64,
        w: u32,
        h: u32,
        outside: [u8; 3],
    ) -> Result<Rgb8, SlideError> {
        self.check_level(level)?;
        if w > 0 && h > 0 {
            SlideError::check_size(&self.path, w, h)?;
        }
        // Far outside is as good as just outside, and cannot overflow.
        let far = i64::from(u32::MAX) * 2;
        let (x, y) = (x.clamp(-far, far), y.clamp(-far, far));
        match &self.source {
            Source::Whole { rgb, .. } | Source::Strips { rgb, .. } => {
                let mut out = Rgb8::filled(w, h, outside);
                out.paste(rgb, -x, -y);
                Ok(out)
            }
            Source::Tiles(pages) => pages.read_rgb8(level, x, y, w, h, outside),
        }
    }

    /// A whole level as grey, 0 to 1: Rec. 601 luma, alpha composited on white, 16-bit precision kept.
    ///
    /// # Errors
    /// As [`Slide::read_rgb8`].
    pub fn read_gray(&self, level: usize) -> Result<Gray, SlideError> {
        self.check_level(level)?;
        let LevelInfo { width, height, .. } = self.levels[level];
        SlideError::check_size(&self.path, width, height)?;
        match &self.source {
            Source::Whole {
                deep: true, format, ..
            } => whole::decode_gray_16(&self.path, *format),
            Source::Strips { pages, .. } | Source::Tiles(pages) if pages.is_deep(level) => {
                pages.read_gray(level)
            }
            Source::Tiles(pages) => pages.read_gray(level),
            Source::Whole { rgb, .. } | Source::Strips { rgb, .. } => Ok(gray_of(rgb)),
        }
    }

    fn check_level(&self, asked: usize) -> Result<(), SlideError> {
        if asked < self.levels.len() {
            return Ok(());
        }
        Err(SlideError::Level {
            path: self.path.clone(),
            asked,
            available: self.levels.len(),
        })
    }
}

fn gray_of(rgb: &Rgb8) -> Gray {
    let data = rgb.data.as_chunks::<3>().0.iter();
    Gray {
        width: rgb.width as usize,
        height: rgb.height as usize,
        data: data
            .map(|&[r, g, b]| luma(r.into(), g.into(), b.into(), 255.0))
            .collect(),
    }
}

enum Kind {
    Raster(ImageFormat),
    Tiff,
}

/// Tells the format by the first bytes.
fn sniff(path: &Path) -> Result<Kind, SlideError> {
    let io = |e| SlideError::io(path, e);
    let not_an_image = |why: &str| SlideError::NotAnImage {
        path: path.to_path_buf(),
        why: why.into(),
    };
    let file = File::open(path).map_err(io)?;
    if file.metadata().map_err(io)?.is_dir() {
        return Err(not_an_image("it is a folder"));
    }
    let mut head = Vec::new();
    file.take(8).read_to_end(&mut head).map_err(io)?;
    const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
    match head.as_slice() {
        [] => Err(not_an_image("the file is empty")),
        PNG => Ok(Kind::Raster(ImageFormat::Png)),
        [0xFF, 0xD8, 0xFF, ..] => Ok(Kind::Raster(ImageFormat::Jpeg)),
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => Ok(Kind::Tiff),
        short if PNG.starts_with(short) => Err(SlideError::truncated(
            path,
            "only the first bytes of a PNG are there",
        )),
        _ => Err(not_an_image(
            "its first bytes are not those of a PNG, JPEG or TIFF",
        )),
    }
}

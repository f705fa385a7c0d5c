//! An image file under the objective.

use std::path::{Path, PathBuf};

use scopeservo_slide::Slide;

use super::pyramid::{Grid, Pyramid, Source, TILE};
use super::{GLASS, Patch, Specimen, SpecimenError};

/// An image file lying with its centre at the origin, x along its columns, y against its rows.
///
/// Coarse levels are box means of the file's finest level, made tile by tile when asked for; the file's own coarse
/// levels, whose filters are unknown, are not used.
#[derive(Debug)]
pub struct FileSpecimen {
    path: PathBuf,
    slide: Slide,
    grid: Grid,
    pyramid: Pyramid,
}

impl FileSpecimen {
    /// Opens an image file. A pixel size given here wins over the one stated by the file.
    ///
    /// # Errors
    /// A file that does not open, no pixel size from either side, or one that is not a finite number above 0.
    pub fn open(path: &Path, um_per_px: Option<f64>) -> Result<Self, SpecimenError> {
        if let Some(um_per_px) = um_per_px
            && !(um_per_px > 0.0 && um_per_px.is_finite())
        {
            return Err(SpecimenError::BadScale {
                path: path.to_path_buf(),
                um_per_px,
            });
        }
        let slide = Slide::open(path)?;
        // What is damaged is told now, not in the middle of a run.
        slide.read_rgb8(0, 0, 0, 1, 1, GLASS)?;
        let finest_um =
            um_per_px
                .or(slide.um_per_px())
                .ok_or_else(|| SpecimenError::MissingScale {
                    path: path.to_path_buf(),
                })?;
        let full = slide.levels()[0];
        let longest = full.width.max(full.height);
        // Halved while some ten samples are left.
        let levels = 1 + (longest / 8).checked_ilog2().unwrap_or(0) as usize;
        let half = |n: u32| 0.5 * f64::from(n) * finest_um;
        let grid = Grid {
            finest_um,
            levels,
            corner_um: [-half(full.width), half(full.height)],
        };
        Ok(Self {
            path: path.to_path_buf(),
            slide,
            grid,
            pyramid: Pyramid::new(),
        })
    }

    /// Pixels of the file's finest level: columns, rows.
    #[must_use]
    pub fn size_px(&self) -> [u32; 2] {
        let full = self.slide.levels()[0];
        [full.width, full.height]
    }
}

impl Source for Slide {
    fn finest(&self, tx: i64, ty: i64) -> Result<Vec<u8>, SpecimenError> {
        let n = TILE as u32;
        let tile = self.read_rgb8(0, tx * i64::from(n), ty * i64::from(n), n, n, GLASS)?;
        Ok(tile.data)
    }

    fn is_blank(&self, column: i64, row: i64, side: i64) -> bool {
        let full = self.levels()[0];
        let beside = |from: i64, n: u32| from + side <= 0 || from >= n.into();
        beside(column, full.width) || beside(row, full.height)
    }
}

impl Specimen for FileSpecimen {
    fn finest_um(&self) -> f64 {
        self.grid.finest_um
    }

    fn levels(&self) -> usize {
        self.grid.levels
    }

    fn patch(
        &self,
        level: usize,
        x_um: [f64; 2],
        y_um: [f64; 2],
        margin: usize,
    ) -> Result<Patch, SpecimenError> {
        let w = self.grid.window(level, x_um, y_um, margin)?;
        let rgb = if level == 0 {
            // The slide holds these samples itself; a second copy of them would only cost memory.
            let (width, height) = (w.width as u32, w.height as u32);
            self.slide
                .read_rgb8(0, w.column, w.row, width, height, GLASS)?
                .data
        } else {
            self.pyramid.read(&self.slide, &w)?
        };
        Ok(self.grid.patch(&w, rgb))
    }

    fn extent_um(&self) -> Option<[f64; 4]> {
        let [x, y] = self.grid.corner_um;
        Some([x, -x, -y, y])
    }

    fn describe(&self) -> String {
        let [w, h] = self.size_px();
        let um = self.grid.finest_um;
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        format!(
            "{name}, {w} x {h} px at {um} um, {:.0} x {:.0} um",
            f64::from(w) * um,
            f64::from(h) * um
        )
    }
}

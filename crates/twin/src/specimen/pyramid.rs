//! Box pyramids in tiles: where the samples are, tiles made when asked for, kept as long as there is room.

use std::sync::Arc;

use rayon::prelude::*;
use scopeservo_slide::cache::Lru;

use super::{GLASS, MAX_PATCH_SAMPLES, Patch, SpecimenError};

/// Samples along the side of a tile of level 0, as a source makes it.
pub(super) const TILE: usize = 256;
/// Samples along the side of a coarser tile: level 1 halves one tile of level 0, higher ones join four of the level
/// below. Small, because the finest samples of a coarse tile are all made, wanted or not.
const COARSE_TILE: usize = TILE / 2;
/// Tiles of level 0 kept per specimen, and tiles of the coarser levels, bytes. A coarse tile takes many fine ones to make: in one store they
/// would push out all that is coarse.
const FINEST_BYTES: usize = 48 << 20;
const COARSE_BYTES: usize = 208 << 20;

/// Where the samples of every level lie.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    pub(super) finest_um: f64,
    pub(super) levels: usize,
    /// The outer corner of sample (0, 0), the same for all levels: x, y (up), micrometres.
    pub(super) corner_um: [f64; 2],
}

/// A block of samples of one level, by column (right) and row (down).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Window {
    pub(super) level: usize,
    pub(super) column: i64,
    pub(super) row: i64,
    pub(super) width: usize,
    pub(super) height: usize,
}

impl Grid {
    fn spacing_um(&self, level: usize) -> f64 {
        self.finest_um * (1_u64 << level) as f64
    }

    /// The samples that surround the rectangle, and `margin` more.
    pub(super) fn window(
        &self,
        level: usize,
        x_um: [f64; 2],
        y_um: [f64; 2],
        margin: usize,
    ) -> Result<Window, SpecimenError> {
        if level >= self.levels {
            return Err(SpecimenError::Level {
                asked: level,
                available: self.levels,
            });
        }
        let ends = [x_um, y_um].concat();
        if x_um[0] > x_um[1]
            || y_um[0] > y_um[1]
            || ends.iter().any(|v| !v.is_finite() || v.abs() > 1e12)
        {
            return Err(SpecimenError::Rectangle { x_um, y_um });
        }
        let s = self.spacing_um(level);
        let [cx, cy] = self.corner_um;
        // Sample k is centred at (k + 1/2) s from the corner.
        let margin_f = margin as f64;
        let low = |from: f64| (from / s - 0.5).floor() - margin_f;
        let high = |to: f64| (to / s - 0.5).floor() + 1.0 + margin_f;
        let (i0, i1) = (low(x_um[0] - cx), high(x_um[1] - cx));
        let (j0, j1) = (low(cy - y_um[1]), high(cy - y_um[0]));
        let (width, height) = (i1 - i0 + 1.0, j1 - j0 + 1.0);
        if width * height > MAX_PATCH_SAMPLES as f64 {
            return Err(SpecimenError::PatchTooLarge { width, height });
        }
        Ok(Window {
            level,
            column: i0 as i64,
            row: j0 as i64,
            width: width as usize,
            height: height as usize,
        })
    }

    /// Dresses samples with their place.
    pub(super) fn patch(&self, w: &Window, rgb: Vec<u8>) -> Patch {
        let spacing_um = self.spacing_um(w.level);
        Patch {
            x0_um: self.corner_um[0] + (w.column as f64 + 0.5) * spacing_um,
            y0_um: self.corner_um[1] - (w.row as f64 + 0.5) * spacing_um,
            spacing_um,
            width: w.width,
            height: w.height,
            rgb,
        }
    }
}

/// Where the finest samples come from. A pure function of the place.
pub(super) trait Source: Sync {
    /// The finest samples of tile column `tx`, row `ty`.
    fn finest(&self, tx: i64, ty: i64) -> Result<Vec<u8>, SpecimenError>;

    /// True if the finest samples from these columns and rows on are known to be blank glass without looking.
    fn is_blank(&self, column: i64, row: i64, side: i64) -> bool;
}

/// Tiles of all levels of one source. What is kept depends on what was asked; what is returned does not.
#[derive(Debug)]
pub(super) struct Pyramid {
    finest: Lru<(usize, i64, i64), Vec<u8>>,
    coarse: Lru<(usize, i64, i64), Vec<u8>>,
    blank: Arc<Vec<u8>>,
}

impl Pyramid {
    pub(super) fn new() -> Self {
        Self {
            finest: Lru::new(FINEST_BYTES),
            coarse: Lru::new(COARSE_BYTES),
            blank: Arc::new(GLASS.repeat(TILE * TILE)),
        }
    }

    /// The samples of a window. Missing tiles are made in parallel.
    pub(super) fn read(&self, source: &impl Source, w: &Window) -> Result<Vec<u8>, SpecimenError> {
        let side = side_of(w.level);
        let t = side as i64;
        let columns = w.column.div_euclid(t)..=(w.column + w.width as i64 - 1).div_euclid(t);
        let rows = w.row.div_euclid(t)..=(w.row + w.height as i64 - 1).div_euclid(t);
        let places: Vec<(i64, i64)> = rows
            .flat_map(|ty| columns.clone().map(move |tx| (tx, ty)))
            .collect();
        let mut rgb = vec![0; 3 * w.width * w.height];
        // In portions, so that a large window holds few tiles besides its own samples.
        for portion in places.chunks(64) {
            let tiles: Vec<Arc<Vec<u8>>> = portion
                .par_iter()
                .map(|&(tx, ty)| self.tile(source, w.level, tx, ty))
                .collect::<Result<_, _>>()?;
            for (&(tx, ty), tile) in portion.iter().zip(&tiles) {
                copy_overlap(
                    tile,
                    side,
                    [tx * t - w.column, ty * t - w.row],
                    &mut rgb,
                    [w.width, w.height],
                );
            }
        }
        Ok(rgb)
    }

    fn tile(
        &self,
        source: &impl Source,
        level: usize,
        tx: i64,
        ty: i64,
    ) -> Result<Arc<Vec<u8>>, SpecimenError> {
        let finest = (side_of(level) as i64) << level;
        if source.is_blank(tx * finest, ty * finest, finest) {
            return Ok(Arc::clone(&self.blank));
        }
        let key = (level, tx, ty);
        let kept = if level == 0 {
            &self.finest
        } else {
            &self.coarse
        };
        if let Some(tile) = kept.get(&key) {
            return Ok(tile);
        }
        let mut coarse = Vec::new();
        match level {
            0 => coarse = source.finest(tx, ty)?,
            1 => {
                coarse.resize(3 * COARSE_TILE * COARSE_TILE, 0);
                halve_into(&self.tile(source, 0, tx, ty)?, TILE, &mut coarse, [0, 0]);
            }
            _ => {
                let finer: Vec<Arc<Vec<u8>>> = (0..4_i64)
                    .into_par_iter()
                    .map(|q| self.tile(source, level - 1, 2 * tx + q % 2, 2 * ty + q / 2))
                    .collect::<Result<_, _>>()?;
                coarse.resize(3 * COARSE_TILE * COARSE_TILE, 0);
                let half = COARSE_TILE / 2;
                for (q, tile) in finer.iter().enumerate() {
                    halve_into(tile, COARSE_TILE, &mut coarse, [q % 2 * half, q / 2 * half]);
                }
            }
        }
        let made = Arc::new(coarse);
        kept.put(key, Arc::clone(&made), made.len());
        Ok(made)
    }
}

fn side_of(level: usize) -> usize {
    if level == 0 { TILE } else { COARSE_TILE }
}

/// Rounded means of 2 x 2 samples of a tile of `side`, written from column `x`, row `y` of a coarse tile.
fn halve_into(fine: &[u8], side: usize, coarse: &mut [u8], [x, y]: [usize; 2]) {
    for j in 0..side / 2 {
        let (upper, lower) = fine[6 * j * side..][..6 * side].split_at(3 * side);
        let to = &mut coarse[3 * ((y + j) * COARSE_TILE + x)..][..3 * side / 2];
        let pairs = upper
            .as_chunks::<6>()
            .0
            .iter()
            .zip(lower.as_chunks::<6>().0);
        for (out, (a, b)) in to.as_chunks_mut::<3>().0.iter_mut().zip(pairs) {
            for c in 0..3 {
                let sum = [a[c], a[c + 3], b[c], b[c + 3]]
                    .map(u16::from)
                    .iter()
                    .sum::<u16>();
                out[c] = ((sum + 2) / 4) as u8;
            }
        }
    }
}

/// Copies the part of a tile of `side` that falls into an image when its first sample lies at (x, y).
fn copy_overlap(
    tile: &[u8],
    side: usize,
    [x, y]: [i64; 2],
    rgb: &mut [u8],
    [width, height]: [usize; 2],
) {
    let clip = |from: i64, n: usize| {
        (
            from.max(0) as usize,
            (from + side as i64).min(n as i64) as usize,
        )
    };
    let ((x0, x1), (y0, y1)) = (clip(x, width), clip(y, height));
    let n = 3 * (x1 - x0);
    for row in y0..y1 {
        let from = 3 * ((row as i64 - y) as usize * side + (x0 as i64 - x) as usize);
        let to = 3 * (row * width + x0);
        rgb[to..to + n].copy_from_slice(&tile[from..from + n]);
    }
}

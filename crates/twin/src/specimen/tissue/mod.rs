//! Tissue without end, made up from a seed: an H&E section with structure from 0.5 um to 1 mm.
//!
//! Every sample is a pure function of the seed and its place. Rows of the world run down, so `v = -y`.

mod cast;
mod cells;
mod grid;
mod noise;
mod paint;
mod plan;
mod stain;

use self::grid::Plans;
use super::pyramid::{Grid, Pyramid, Source, TILE};
use super::{Patch, Specimen, SpecimenError};

/// Levels 0.25, 0.5, 1, 2, 4 and 8 um.
const LEVELS: usize = 6;

/// Procedural H&E-like tissue: unlimited, never repeating, the same for the same seed.
#[derive(Debug)]
pub struct Tissue {
    seed: u64,
    plans: Plans,
    grid: Grid,
    pyramid: Pyramid,
}

impl Tissue {
    /// The section of this seed. Nothing is computed before it is looked at.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        // Stirred so that neighbouring seeds share nothing.
        let half = |k| u64::from(noise::hash(seed, k, 2026));
        Self {
            seed,
            plans: Plans::new(half(1) << 32 | half(2)),
            grid: Grid {
                finest_um: plan::SAMPLE_UM,
                levels: LEVELS,
                corner_um: [0.0, 0.0],
            },
            pyramid: Pyramid::new(),
        }
    }
}

impl Source for Plans {
    fn finest(&self, tx: i64, ty: i64) -> Result<Vec<u8>, SpecimenError> {
        let t = TILE as i64;
        Ok(paint::window(self, [tx * t, ty * t], [TILE, TILE]))
    }

    fn is_blank(&self, _column: i64, _row: i64, _side: i64) -> bool {
        false
    }
}

impl Specimen for Tissue {
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
        let rgb = self.pyramid.read(&self.plans, &w)?;
        Ok(self.grid.patch(&w, rgb))
    }

    fn extent_um(&self) -> Option<[f64; 4]> {
        None
    }

    fn describe(&self) -> String {
        format!(
            "procedural H&E tissue, seed {}, from {} um",
            self.seed, self.grid.finest_um
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_window_gives_the_same_samples() {
        let made = |origin, size| paint::window(&Plans::new(77), origin, size);
        let whole = made([-300, 120], [256, 256]);
        for (dx, dy, w, h) in [
            (0, 0, 64, 64),
            (37, 91, 150, 101),
            (200, 250, 56, 6),
            (255, 0, 1, 256),
        ] {
            let part = made([-300 + dx as i64, 120 + dy as i64], [w, h]);
            for j in 0..h {
                let from = 3 * ((dy + j) * 256 + dx);
                assert_eq!(
                    part[3 * j * w..3 * (j + 1) * w],
                    whole[from..from + 3 * w],
                    "row {j} at {dx}, {dy}"
                );
            }
        }
    }
}

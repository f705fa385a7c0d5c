//! A piece of a specimen that is there a second time.

use super::{Patch, Specimen, SpecimenError};
use std::sync::Arc;

/// Another specimen, in which a rectangle shows what lies elsewhere, sample by sample.
pub struct Twice {
    specimen: Arc<dyn Specimen>,
    /// The copy: x from, to; y from, to, um.
    copy_um: [[f64; 2]; 2],
    /// From the copy to what it shows, um.
    offset_um: [f64; 2],
}

impl Twice {
    /// Shows the piece of `size_um` around `original_um` at `copy_um` too. Places and sizes are rounded to samples of the
    /// specimen's coarsest level, so that both are alike at every level.
    #[must_use]
    pub fn new(
        specimen: Arc<dyn Specimen>,
        original_um: [f64; 2],
        copy_um: [f64; 2],
        size_um: [f64; 2],
    ) -> Self {
        let step = specimen.finest_um() * (1u64 << (specimen.levels() - 1).min(62)) as f64;
        let whole = |v: f64| (v / step).round() * step;
        let side = |k: usize| {
            [
                whole(copy_um[k] - 0.5 * size_um[k]),
                whole(copy_um[k] + 0.5 * size_um[k]),
            ]
        };
        Self {
            copy_um: [side(0), side(1)],
            offset_um: [0, 1].map(|k| whole(original_um[k] - copy_um[k])),
            specimen,
        }
    }
}

impl Specimen for Twice {
    fn finest_um(&self) -> f64 {
        self.specimen.finest_um()
    }

    fn levels(&self) -> usize {
        self.specimen.levels()
    }

    fn patch(
        &self,
        level: usize,
        x_um: [f64; 2],
        y_um: [f64; 2],
        margin: usize,
    ) -> Result<Patch, SpecimenError> {
        let mut patch = self.specimen.patch(level, x_um, y_um, margin)?;
        let s = patch.spacing_um;
        let [columns, rows] = [patch.width, patch.height].map(|n| (n - 1) as f64 * s);
        let within = |[from, to]: [f64; 2], v: f64| from < v && v < to;
        let [x, y] = self.copy_um;
        if patch.x0_um > x[1]
            || patch.x0_um + columns < x[0]
            || patch.y0_um < y[0]
            || patch.y0_um - rows > y[1]
        {
            return Ok(patch);
        }
        // A rectangle that lies between the outer samples asks for exactly the samples of this patch, offset.
        let [dx, dy] = self.offset_um;
        let left = patch.x0_um + dx;
        let upper = patch.y0_um + dy;
        let other = self.specimen.patch(
            level,
            [left + 0.3 * s, left + columns - 0.6 * s],
            [upper - rows + 0.6 * s, upper - 0.3 * s],
            0,
        )?;
        debug_assert_eq!([other.width, other.height], [patch.width, patch.height]);
        for j in 0..patch.height {
            if !within(y, patch.y0_um - j as f64 * s) {
                continue;
            }
            for i in 0..patch.width {
                if within(x, patch.x0_um + i as f64 * s) {
                    let at = 3 * (j * patch.width + i);
                    patch.rgb[at..at + 3].copy_from_slice(&other.rgb[at..at + 3]);
                }
            }
        }
        Ok(patch)
    }

    fn extent_um(&self) -> Option<[f64; 4]> {
        self.specimen.extent_um()
    }

    fn describe(&self) -> String {
        format!("{}, a piece of it twice", self.specimen.describe())
    }
}

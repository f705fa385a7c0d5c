//! Nothing but glass.

use super::pyramid::Grid;
use super::{GLASS, Patch, Specimen, SpecimenError};

/// Blank glass everywhere: what a camera sees when there is nothing to hold on to.
#[derive(Clone, Copy, Debug, Default)]
pub struct Blank;

impl Specimen for Blank {
    fn finest_um(&self) -> f64 {
        0.25
    }

    fn levels(&self) -> usize {
        6
    }

    fn patch(
        &self,
        level: usize,
        x_um: [f64; 2],
        y_um: [f64; 2],
        margin: usize,
    ) -> Result<Patch, SpecimenError> {
        let grid = Grid {
            finest_um: self.finest_um(),
            levels: self.levels(),
            corner_um: [0.0, 0.0],
        };
        let window = grid.window(level, x_um, y_um, margin)?;
        Ok(grid.patch(&window, GLASS.repeat(window.width * window.height)))
    }

    fn extent_um(&self) -> Option<[f64; 4]> {
        None
    }

    fn describe(&self) -> String {
        "blank glass".into()
    }
}

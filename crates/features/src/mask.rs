//! Which parts of an image count.

use serde::{Deserialize, Serialize};

/// A mask over an image, in square cells: what is known to belong to the specimen, and not to the camera.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mask {
    width: usize,
    height: usize,
    cell: usize,
    counts: Vec<bool>,
}

impl Mask {
    /// Asks for each cell of `cell` pixels, by its middle, whether it counts.
    pub fn of_cells(
        width: usize,
        height: usize,
        cell: usize,
        mut counts: impl FnMut([f64; 2]) -> bool,
    ) -> Self {
        let cell = cell.max(1);
        let middle = |i: usize| (i * cell) as f64 + (cell as f64 - 1.0) / 2.0;
        let (columns, rows) = (width.div_ceil(cell), height.div_ceil(cell));
        let cells = (0..rows).flat_map(|row| (0..columns).map(move |column| [column, row]));
        Self {
            width,
            height,
            cell,
            counts: cells.map(|c| counts(c.map(middle))).collect(),
        }
    }

    /// Of the bytes of a grey image of its cells, row by row: what is not black counts. `None` when the numbers disagree.
    pub fn from_cells(width: usize, height: usize, cell: usize, cells: &[u8]) -> Option<Self> {
        let fits = cell > 0 && width.div_ceil(cell) * height.div_ceil(cell) == cells.len();
        fits.then(|| Self {
            width,
            height,
            cell,
            counts: cells.iter().map(|&v| v > 0).collect(),
        })
    }

    /// Side of a cell, pixels.
    pub fn cell(&self) -> usize {
        self.cell
    }

    /// Columns and rows of cells, and a byte for each: 255 where it counts.
    pub fn cells(&self) -> ([usize; 2], Vec<u8>) {
        let size = [self.width, self.height].map(|side| side.div_ceil(self.cell));
        let bytes = self.counts.iter().map(|&c| if c { 255 } else { 0 });
        (size, bytes.collect())
    }

    /// Whether the cell of a place counts; outside of the image nothing does.
    pub fn holds(&self, [x, y]: [f64; 2]) -> bool {
        // The first pixel begins half a pixel before its centre.
        let (x, y) = (x + 0.5, y + 0.5);
        if !(x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64) {
            return false;
        }
        let columns = self.width.div_ceil(self.cell);
        let [column, row] = [x, y].map(|v| v as usize / self.cell);
        self.counts[row * columns + column]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_speaks_for_its_pixels_and_the_outside_for_nothing() {
        let left = Mask::of_cells(20, 10, 8, |[x, _]| x < 8.0);
        let (size, cells) = left.cells();
        assert_eq!(size, [3, 2]);
        assert_eq!(cells, [255, 0, 0, 255, 0, 0]);
        assert!(left.holds([0.0, 0.0]) && left.holds([7.4, 9.0]) && left.holds([-0.5, 0.0]));
        assert!(!left.holds([7.5, 9.0]) && !left.holds([-0.6, 0.0]) && !left.holds([3.0, 9.5]));
        assert!(!left.holds([f64::NAN, 0.0]));
        assert_eq!(Mask::from_cells(20, 10, 8, &cells), Some(left));
        assert_eq!(Mask::from_cells(20, 10, 8, &cells[1..]), None);
    }
}

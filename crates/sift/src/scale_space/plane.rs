//! A plane of pixels.

use std::ops::Range;

/// A row-major plane of f32.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Plane {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Pixels of the chain it was made in from one pixel to the next: 1 or 2.
    pub(crate) pitch: usize,
    pub(crate) data: Vec<f32>,
}

impl Plane {
    /// Takes a size and keeps its memory. What the pixels are is left open.
    pub(crate) fn resize(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width, height);
        self.data.resize(width * height, 0.0);
    }

    #[inline(always)]
    pub(crate) fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.width..][..self.width]
    }

    /// Brings a window into the first cache. These loads do not wait for each other, as those between arithmetic do.
    #[inline(always)]
    pub(crate) fn touch(&self, columns: Range<usize>, rows: Range<usize>) {
        let mut sum = 0;
        for y in rows.start..rows.end.min(self.height) {
            let row = &self.row(y)[columns.start.min(self.width)..columns.end.min(self.width)];
            for line in row.chunks(16) {
                sum ^= line[0].to_bits();
            }
            sum ^= row.last().map_or(0, |v| v.to_bits());
        }
        std::hint::black_box(sum);
    }
}

//! The rows of a level that are still needed.

use std::ops::Range;

use crate::aligned::Aligned;
use crate::blur::mirrored;

/// The last rows of one level within a tile.
#[derive(Debug, Default)]
pub(super) struct Ring {
    pub(super) data: Aligned,
    pub(super) stride: usize,
    /// Rows that are kept.
    pub(super) kept: usize,
    /// Columns of the level that this tile computes.
    pub(super) columns: Range<usize>,
    /// Column at which the rows begin.
    pub(super) origin: usize,
    /// Rows of the level that this tile computes.
    pub(super) rows: Range<usize>,
    /// The next row to compute.
    pub(super) next: usize,
}

impl Ring {
    /// Begin of row `y`, which must still be there; its first value is column `origin` of the tile.
    #[inline(always)]
    pub(super) fn start(&self, y: usize) -> usize {
        debug_assert!(
            y < self.next && y + self.kept >= self.next,
            "row {y} is gone or not there yet: {} kept before {}",
            self.kept,
            self.next
        );
        y % self.kept * self.stride
    }

    /// Where the rows `rows` of a level with `height` rows are from column `column` on, mirrored at its ends.
    /// Rows of the level that come after the last computed one are not needed: the last one stands for them.
    pub(super) fn starts(
        &self,
        rows: Range<isize>,
        height: usize,
        column: usize,
        out: &mut Vec<usize>,
    ) {
        out.clear();
        let offset = column - self.origin;
        if rows.start >= 0 && rows.end as usize <= self.next {
            let (begin, count) = (rows.start as usize, rows.len());
            debug_assert!(begin + self.kept >= self.next);
            // Up to the end of the memory, and on from its begin.
            let slot = begin % self.kept;
            let wrapped = (slot + count).saturating_sub(self.kept);
            out.extend((slot..slot + count - wrapped).map(|slot| slot * self.stride + offset));
            out.extend((0..wrapped).map(|slot| slot * self.stride + offset));
        } else {
            out.extend(rows.map(|y| {
                let y = mirrored(y, height).min(self.next - 1);
                self.start(y) + offset
            }));
        }
    }

    pub(super) fn is_complete(&self) -> bool {
        self.next == self.rows.end
    }
}

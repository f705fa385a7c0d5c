//! The plan of a tile: which rows and columns of each level, and the memory for them.

use std::ops::Range;

use super::chain::{Chain, LevelSource, WINDOW, WINDOW_COLUMNS, seen};
use super::ring::Ring;
use crate::aligned::Aligned;
use crate::blur::{BLOCK, lead};

impl Chain<'_> {
    /// Gives each level its rows, columns and memory; returns the column at which the rows of the visible levels begin.
    pub(super) fn plan(
        &self,
        rows: &Range<usize>,
        columns: &Range<usize>,
        rings: &mut Vec<Ring>,
        padded: &mut [Aligned; 2],
    ) -> usize {
        let (w, h) = self.size;
        rings.resize_with(self.levels.len(), Ring::default);
        let seen = seen(rows, h);
        let wide =
            columns.start.saturating_sub(WINDOW_COLUMNS)..(columns.end + WINDOW_COLUMNS).min(w);
        let wide = wide.start - wide.start % 2..wide.end;
        for ring in rings.iter_mut() {
            (ring.rows, ring.columns) = (seen.clone(), wide.clone());
            ring.kept = 2 * WINDOW + 4;
            ring.next = 0;
        }
        if !self.is_visible(0) {
            let ring = &mut rings[0];
            ring.rows = seen.start / 2..seen.start / 2 + 1;
            ring.columns = wide.start / 2..wide.start / 2 + 1;
        }
        let mut widest = 0;
        for level in (0..rings.len()).rev() {
            let (r, scale) = match &self.levels[level] {
                LevelSource::Taken(_) => continue,
                LevelSource::Blurred(kernel) => (kernel.radius(), 1),
                LevelSource::Doubled(kernel) => (kernel.radius(), 2),
            };
            widest = widest.max(r);
            let (w, h) = (w.div_ceil(scale), h.div_ceil(scale));
            let grown = |r1: &Range<usize>, r2: &Range<usize>, n: usize| {
                let start = (r1.start / scale).saturating_sub(r);
                start.min(r2.start)..(r1.end.div_ceil(scale) + r).min(n).max(r2.end)
            };
            let (above, below) = (
                &rings[level],
                &rings[if scale == 2 { 0 } else { level - 1 }],
            );
            let rows = grown(&above.rows, &below.rows, h);
            let columns = grown(&above.columns, &below.columns, w);
            let kept = (above.kept + r + 4).max(2 * r + 8);
            let below = &mut rings[if scale == 2 { 0 } else { level - 1 }];
            below.kept = below.kept.max(kept);
            (below.rows, below.columns) = (rows, columns);
        }
        let origin = (0..rings.len())
            .filter(|&level| self.is_visible(level))
            .map(|level| rings[level].columns.start)
            .min()
            .unwrap_or(0);
        let stride = (rings
            .iter()
            .map(|r| r.columns.end - r.columns.start.min(origin)))
        .max()
        .unwrap_or(0)
        .next_multiple_of(BLOCK)
            + 2 * BLOCK;
        for (level, ring) in rings.iter_mut().enumerate() {
            ring.next = ring.rows.start;
            ring.origin = if self.is_visible(level) {
                origin
            } else {
                ring.columns.start
            };
            ring.stride = stride;
            // Old values may remain: whatever is read as a pixel has been computed before.
            ring.data.resize(ring.kept * stride + BLOCK);
        }
        for row in padded {
            row.resize(lead(widest) + stride + widest + 2 * BLOCK);
        }
        origin
    }
}

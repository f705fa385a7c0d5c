//! The sweep: rows of a tile pushed through all levels, and shown to a visitor.

use std::ops::Range;

use fearless_simd::Simd;

use super::chain::{Chain, LevelSource, WINDOW, seen};
use super::ring::Ring;
use super::source::copy_even;
use crate::aligned::Aligned;
use crate::blur::{along, along_doubled, down, down_doubled, lead, mirrored};

/// Buffers of one tile, reused for the next.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    rings: Vec<Ring>,
    padded: [Aligned; 2],
    starts: Vec<usize>,
}

/// The levels of a tile around the visited row.
pub(crate) struct Levels<'a> {
    rings: &'a [Ring],
    /// Column of the octave at which the rows of all levels begin that are not of another size.
    pub(crate) origin: usize,
    /// Size of the octave: columns and rows.
    pub(crate) size: (usize, usize),
    /// The tile: columns and rows.
    pub(crate) columns: Range<usize>,
    pub(crate) rows: Range<usize>,
    /// The row after the last one that will be visited.
    pub(crate) end: usize,
}

impl Levels<'_> {
    /// Row `y` of level `level`, from column [`origin`](Self::origin) on.
    #[inline(always)]
    pub(crate) fn row(&self, level: usize, y: usize) -> &[f32] {
        let ring = &self.rings[level];
        let start = ring.start(y);
        &ring.data[start..start + ring.stride]
    }
}

impl Chain<'_> {
    /// Computes the levels for the tile `rows` x `columns`.
    ///
    /// `planes[i]` takes what is kept of the tile's rows of level `kept[i]`: whole rows of the octave, beginning with
    /// `rows.start`, which is even.
    /// `visit` is called for each row of the tile and of [`WINDOW`] rows around it, in order, as soon as all levels have it. The
    /// `2 * WINDOW` rows before it are still there.
    #[inline(always)]
    pub(crate) fn sweep<S: Simd>(
        &self,
        s: S,
        rows: Range<usize>,
        columns: Range<usize>,
        scratch: &mut Scratch,
        planes: &mut [&mut [f32]],
        mut visit: impl FnMut(&Levels<'_>, usize),
    ) {
        let Scratch {
            rings,
            padded,
            starts,
        } = scratch;
        let origin = self.plan(&rows, &columns, rings, padded);
        let (w, h) = self.size;
        let seen = seen(&rows, h);
        let mut visited = seen.start;
        while visited < seen.end {
            let mut moved = false;
            for level in 0..rings.len() {
                let ring = &rings[level];
                let (y, count) = (ring.next, (ring.rows.end - ring.next).min(2));
                if count == 0 || y + count > self.needed(level, rings, visited) + ring.kept {
                    continue;
                }
                if !self.make_rows(s, level, count, rings, padded, starts) {
                    continue;
                }
                moved = true;
                let ring = &mut rings[level];
                ring.next += count;
                for (kept, plane) in self.kept.iter().zip(planes.iter_mut()) {
                    if kept.level != level {
                        continue;
                    }
                    let columns = kept.count(columns.start)..kept.count(columns.end);
                    let pitch = if kept.halved { 2 } else { 1 };
                    for y in (y..y + count).filter(|y| rows.contains(y) && y % pitch == 0) {
                        let from = ring.start(y) + (columns.start * pitch - ring.origin);
                        let row = &ring.data[from..from + columns.len() * pitch];
                        let out = &mut plane[(y - rows.start) / pitch * kept.count(w)..];
                        let out = &mut out[columns.clone()];
                        if kept.halved {
                            copy_even(s, row, out);
                        } else {
                            out.copy_from_slice(row);
                        }
                    }
                }
            }
            while visited < seen.end
                && (rings.iter().enumerate())
                    .all(|(level, ring)| !self.is_visible(level) || visited < ring.next)
            {
                let levels = Levels {
                    rings,
                    origin,
                    size: self.size,
                    columns: columns.clone(),
                    rows: rows.clone(),
                    end: seen.end,
                };
                visit(&levels, visited);
                visited += 1;
                moved = true;
            }
            assert!(moved, "rings hold what the next row of each level needs");
        }
    }

    /// The first row of `level` to which another level or the visitor comes back: those before may be overwritten.
    fn needed(&self, level: usize, rings: &[Ring], visited: usize) -> usize {
        let mut needed = usize::MAX;
        if self.is_visible(level) {
            needed = visited.saturating_sub(2 * WINDOW);
        }
        for (above, ring) in rings.iter().enumerate().skip(level + 1) {
            if self.below(above) == Some(level) && !ring.is_complete() {
                needed = needed.min(self.rows_below(above, ring.next).start.max(0) as usize);
            }
        }
        needed.min(usize::MAX / 2)
    }

    /// Makes the next `count` rows of `level`; `false` when the level below is not there yet.
    #[inline(always)]
    fn make_rows<S: Simd>(
        &self,
        s: S,
        level: usize,
        count: usize,
        rings: &mut [Ring],
        padded: &mut [Aligned; 2],
        starts: &mut Vec<usize>,
    ) -> bool {
        let (before, from) = rings.split_at_mut(level);
        let ring = &mut from[0];
        let y = ring.next;
        let at = [y, y + count - 1].map(|y| y % ring.kept * ring.stride);
        let Some(below) = self.below(level).map(|below| &before[below]) else {
            if let LevelSource::Taken(source) = &self.levels[level] {
                for y in y..y + count {
                    let at = y % ring.kept * ring.stride + (ring.columns.start - ring.origin);
                    source.row(s, y, ring.columns.clone(), &mut ring.data[at..]);
                }
            }
            return true;
        };
        let (r, scale) = match &self.levels[level] {
            LevelSource::Taken(_) => return true,
            LevelSource::Blurred(kernel) => (kernel.radius(), 1),
            LevelSource::Doubled(kernel) => (kernel.radius(), 2),
        };
        let rows = self.rows_below(level, y);
        let last = rows.end - if scale == 1 && count == 1 { 1 } else { 0 };
        if !(below.is_complete() || last as usize <= below.next) {
            return false;
        }
        // Size of the level below; the columns of it that there are, and where they stand in the padded rows: column `start` at
        // `lead`.
        let (w, h) = (self.size.0.div_ceil(scale), self.size.1.div_ceil(scale));
        let (start, end) = (ring.columns.start / scale, ring.columns.end.div_ceil(scale));
        let (from, to) = (start.saturating_sub(r), (end + r).min(w));
        let lead = lead(r);
        let place = lead - (start - from);
        below.starts(rows, h, from, starts);
        let [first, second] = padded;
        let (data, width) = (&below.data, to - from);
        let out = [&mut first[place..], &mut second[place..]];
        match &self.levels[level] {
            LevelSource::Taken(_) => {}
            LevelSource::Blurred(kernel) => down(s, kernel, data, starts, width, out),
            LevelSource::Doubled(kernel) => down_doubled(s, kernel, data, starts, width, out),
        }
        for (padded, at) in [first, second].into_iter().zip(at).take(count) {
            let pixel = |column: isize| mirrored(column, w) - from + place;
            for i in lead - r..place {
                padded[i] = padded[pixel(i as isize + start as isize - lead as isize)];
            }
            for column in to..end + r {
                padded[column - from + place] = padded[pixel(column as isize)];
            }
            let out = &mut ring.data[at + (ring.columns.start - ring.origin)..];
            match &self.levels[level] {
                LevelSource::Taken(_) => {}
                LevelSource::Blurred(kernel) => along(s, kernel, padded, ring.columns.len(), out),
                LevelSource::Doubled(kernel) => {
                    along_doubled(s, kernel, padded, ring.columns.len(), out)
                }
            }
        }
        true
    }
}

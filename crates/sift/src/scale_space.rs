//! Gaussian scale space (Lowe, IJCV 2004, section 3), one octave at a time, in one sweep over cache-sized tiles.
//!
//! Pixel grid: sample i of octave o lies at input coordinate `i * 2^o`, exactly. Doubling keeps every input pixel as an even
//! sample and puts averages between them, so `w` columns become `2 w - 1`; halving keeps the even samples. Nothing is shifted
//! by fractions of a pixel anywhere, and no correction is needed later. Borders are mirrored about the border pixel.
//!
//! A [`Chain`] is the list of blurs of an octave; [`Chain::sweep`] pushes the rows of a tile through all of them. Each level keeps
//! only the rows that the next blur and the visitor still need, in a [`Ring`], so that a tile of [`TILE_WIDTH`] columns stays in
//! the second cache. Levels that are wanted later are copied to whole planes on the way. Tiles overlap by what the kernels reach;
//! every value is computed by the same operations in whatever tile, so the result depends neither on tiles nor on threads.

use std::ops::Range;

use fearless_simd::{Simd, f32x8, prelude::*};

use crate::GrayImage;
use crate::blur::{BLOCK, Kernel, along, down, mirrored};

/// Columns of a tile, without its overlap.
const TILE_WIDTH: usize = 640;

/// Rows before and after the visited one that the visitor may look at.
pub(crate) const WINDOW: usize = 8;

/// Columns to either side of the visited ones that the visitor may look at.
const WINDOW_COLUMNS: usize = 10;

/// A row-major plane of f32.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Plane {
    pub(crate) width: usize,
    pub(crate) height: usize,
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
}

/// Where the rows of level 0 come from.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Source<'a> {
    /// The image itself.
    Image(&'a GrayImage),
    /// The image at twice its sampling, linearly interpolated.
    Doubled(&'a GrayImage),
    /// Every second pixel of every second row, starting with the first.
    Halved(&'a Plane),
}

impl Source<'_> {
    /// Columns and rows.
    pub(crate) fn size(&self) -> (usize, usize) {
        match self {
            Self::Image(i) => (i.width(), i.height()),
            Self::Doubled(i) => (2 * i.width() - 1, 2 * i.height() - 1),
            Self::Halved(p) => (p.width.div_ceil(2), p.height.div_ceil(2)),
        }
    }

    /// Columns `columns` of row `y`.
    #[inline(always)]
    fn row<S: Simd>(&self, s: S, y: usize, columns: Range<usize>, out: &mut [f32]) {
        let out = &mut out[..columns.len()];
        match self {
            Self::Image(image) => {
                out.copy_from_slice(&image.data()[y * image.width()..][columns]);
            }
            Self::Halved(plane) => {
                let even = plane.row(2 * y)[2 * columns.start..].iter().step_by(2);
                out.iter_mut().zip(even).for_each(|(o, v)| *o = *v);
            }
            Self::Doubled(image) => {
                let w = image.width();
                let row = |y: usize| &image.data()[y * w..][..w];
                let (above, below) = (row(y / 2), row(y.div_ceil(2)));
                debug_assert!(columns.start.is_multiple_of(2), "tiles begin at even columns");
                let (above, below) = (&above[columns.start / 2..], &below[columns.start / 2..]);
                let mut done = 0;
                while done + 16 <= out.len() && done / 2 + 9 <= above.len() {
                    let i = done / 2;
                    let here = double::<S>(s, &above[i..i + 8], &below[i..i + 8]);
                    let next = double::<S>(s, &above[i + 1..i + 9], &below[i + 1..i + 9]);
                    let (low, high) = here.interleave((here + next) * 0.5);
                    low.store_slice(&mut out[done..done + 8]);
                    high.store_slice(&mut out[done + 8..done + 16]);
                    done += 16;
                }
                for (i, out) in out.iter_mut().enumerate().skip(done) {
                    let at = |x: usize| 0.5 * (above[x] + below[x]);
                    *out = if i % 2 == 0 { at(i / 2) } else { 0.5 * (at(i / 2) + at(i / 2 + 1)) };
                }
            }
        }
    }
}

/// Means of two rows.
#[inline(always)]
fn double<S: Simd>(s: S, above: &[f32], below: &[f32]) -> f32x8<S> {
    (f32x8::from_slice(s, above) + f32x8::from_slice(s, below)) * 0.5
}

/// The last rows of one level within a tile.
#[derive(Debug, Default)]
struct Ring {
    data: Vec<f32>,
    stride: usize,
    /// Rows that are kept.
    kept: usize,
    /// Columns of the level that this tile computes.
    columns: Range<usize>,
    /// Rows of the level that this tile computes.
    rows: Range<usize>,
    /// The next row to compute.
    next: usize,
}

impl Ring {
    /// Begin of row `y`, which must still be there; its first value is column `origin` of the tile.
    #[inline(always)]
    fn start(&self, y: usize) -> usize {
        debug_assert!(
            y < self.next && y + self.kept >= self.next,
            "row {y} is gone or not there yet: {} kept before {}",
            self.kept,
            self.next
        );
        y % self.kept * self.stride
    }

    /// Begins of the rows from `y - radius` to `y + count - 1 + radius`, mirrored at the ends of `height` rows; as many as two
    /// rows need, the last one repeated when `count` is 1.
    fn starts(&self, y: usize, count: usize, radius: usize, height: usize, out: &mut Vec<usize>) {
        out.clear();
        let rows = 2 * radius + count;
        if y >= radius && y + count + radius <= height {
            let mut slot = (y - radius) % self.kept;
            debug_assert_eq!(self.start(y - radius), slot * self.stride);
            debug_assert!(y + count + radius <= self.next);
            for _ in 0..rows {
                out.push(slot * self.stride);
                slot += 1;
                if slot == self.kept {
                    slot = 0;
                }
            }
        } else {
            let begin = y as isize - radius as isize;
            out.extend((0..rows as isize).map(|i| self.start(mirrored(begin + i, height))));
        }
        out.resize(2 * radius + 2, out[rows - 1]);
    }

    fn is_complete(&self) -> bool {
        self.next == self.rows.end
    }
}

/// Buffers of one tile, reused for the next.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    rings: Vec<Ring>,
    padded: [Vec<f32>; 2],
    starts: Vec<usize>,
    /// For the visitor.
    pub(crate) rows: Vec<f32>,
}

/// The levels of a tile around the visited row.
pub(crate) struct Levels<'a> {
    rings: &'a [Ring],
    /// Column of the octave at which the rows begin.
    pub(crate) origin: usize,
    /// Size of the octave: columns and rows.
    pub(crate) size: (usize, usize),
    /// What is to be visited.
    pub(crate) columns: Range<usize>,
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

/// The levels of one octave: first the sources as they are, then the last source after `kernels[0]`, that after `kernels[1]`,
/// and so on.
#[derive(Debug)]
pub(crate) struct Chain<'a> {
    /// At least one; all have the same size.
    pub(crate) sources: Vec<Source<'a>>,
    pub(crate) kernels: Vec<Kernel>,
    /// Levels that are copied to planes.
    pub(crate) kept: Range<usize>,
}

impl Chain<'_> {
    /// Column ranges of the tiles of an octave.
    pub(crate) fn tiles(width: usize) -> impl Iterator<Item = Range<usize>> {
        let count = width.div_ceil(TILE_WIDTH).max(1);
        (0..count).map(move |i| width * i / count..width * (i + 1) / count)
    }

    /// Columns and rows of the octave.
    pub(crate) fn size(&self) -> (usize, usize) {
        self.sources[0].size()
    }

    /// The blur that makes `level` of the level below it; `None` for a source and beyond the last level.
    fn kernel(&self, level: usize) -> Option<&Kernel> {
        self.kernels.get(level.checked_sub(self.sources.len())?)
    }

    /// Computes the levels for the tile `rows` x `columns`.
    ///
    /// `planes[i]` takes the tile's rows of level `kept.start + i`: whole rows of the octave, beginning with `rows.start`.
    /// `visit` is called for each row of the tile in order, with all levels within [`WINDOW`] rows of it.
    #[inline(always)]
    pub(crate) fn sweep<S: Simd>(
        &self,
        s: S,
        rows: Range<usize>,
        columns: Range<usize>,
        scratch: &mut Scratch,
        planes: &mut [&mut [f32]],
        mut visit: impl FnMut(&Levels<'_>, &mut Vec<f32>, usize),
    ) {
        let (w, h) = self.size();
        let Scratch {
            rings,
            padded,
            starts,
            rows: visitor_rows,
        } = scratch;
        let origin = self.plan((w, h), &rows, &columns, rings, padded);
        let levels = rings.len();
        let mut visited = rows.start;
        while visited < rows.end {
            for level in 0..levels {
                let (before, from) = rings.split_at_mut(level);
                let (ring, after) = from.split_first_mut().expect("plan made a ring per level");
                // A row may be overwritten when neither the next blur nor the visitor comes back to it.
                let next = after.first().zip(self.kernel(level + 1));
                let needed = match next {
                    Some((next, kernel)) if !next.is_complete() => {
                        next.next.saturating_sub(kernel.radius())
                    }
                    _ => usize::MAX,
                };
                let needed = needed.min(visited.saturating_sub(WINDOW));
                let count = (ring.rows.end - ring.next).min(2);
                if count == 0 || ring.next + count > needed + ring.kept {
                    continue;
                }
                let y = ring.next;
                if let Some(kernel) = self.kernel(level) {
                    let below = &before[level - 1];
                    if !(below.is_complete() || y + count + kernel.radius() <= below.next) {
                        continue;
                    }
                    below.starts(y, count, kernel.radius(), h, starts);
                    let at = [y, y + count - 1].map(|y| y % ring.kept * ring.stride);
                    blur_pair(s, kernel, below, starts, padded, (origin, w), ring, at, count);
                } else {
                    for y in y..y + count {
                        let at = y % ring.kept * ring.stride + (ring.columns.start - origin);
                        self.sources[level].row(s, y, ring.columns.clone(), &mut ring.data[at..]);
                    }
                }
                ring.next += count;
                if self.kept.contains(&level) {
                    let plane = &mut planes[level - self.kept.start];
                    for y in (y..y + count).filter(|y| rows.contains(y)) {
                        let from = y % ring.kept * ring.stride + (columns.start - origin);
                        plane[(y - rows.start) * w..][columns.clone()]
                            .copy_from_slice(&ring.data[from..from + columns.len()]);
                    }
                }
            }
            while visited < rows.end
                && rings.iter().all(|r| r.is_complete() || visited + WINDOW < r.next)
            {
                let levels = Levels {
                    rings,
                    origin,
                    size: (w, h),
                    columns: columns.clone(),
                };
                visit(&levels, visitor_rows, visited);
                visited += 1;
            }
        }
    }

    /// Gives each level its rows, columns and memory; returns the column at which all rows begin.
    fn plan(
        &self,
        (w, h): (usize, usize),
        rows: &Range<usize>,
        columns: &Range<usize>,
        rings: &mut Vec<Ring>,
        padded: &mut [Vec<f32>; 2],
    ) -> usize {
        rings.resize_with(self.sources.len() + self.kernels.len(), Ring::default);
        let mut rows = rows.start.saturating_sub(WINDOW)..(rows.end + WINDOW).min(h);
        let mut columns =
            columns.start.saturating_sub(WINDOW_COLUMNS)..(columns.end + WINDOW_COLUMNS).min(w);
        let mut kept = 2 * WINDOW + 4;
        for level in (0..rings.len()).rev() {
            if level + 1 == self.sources.len() {
                // The doubled image is made in pairs of columns.
                columns.start -= columns.start % 2;
            }
            let ring = &mut rings[level];
            (ring.rows, ring.columns) = (rows.clone(), columns.clone());
            (ring.kept, ring.next) = (kept, rows.start);
            if let Some(kernel) = self.kernel(level) {
                let r = kernel.radius();
                kept = (kept + r + 4).max(2 * r + 8);
                rows = rows.start.saturating_sub(r)..(rows.end + r).min(h);
                columns = columns.start.saturating_sub(r)..(columns.end + r).min(w);
            }
        }
        let origin = rings[0].columns.start;
        let stride = rings[0].columns.len().next_multiple_of(BLOCK) + 2 * BLOCK;
        for ring in rings.iter_mut() {
            ring.stride = stride;
            // Old values may remain: whatever is read as a pixel has been computed before.
            ring.data.resize(ring.kept * stride + BLOCK, 0.0);
        }
        let widest = self.kernels.iter().map(Kernel::radius).max().unwrap_or(0);
        for row in padded {
            row.resize(stride + 2 * widest + 2 * BLOCK, 0.0);
        }
        origin
    }
}

/// Rows `y` and `y + 1` of a level from the level below it, into the rows of `ring` that begin at `at`; only the first when
/// `count` is 1.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the inside of one loop")]
fn blur_pair<S: Simd>(
    s: S,
    kernel: &Kernel,
    below: &Ring,
    starts: &mut [usize],
    padded: &mut [Vec<f32>; 2],
    (origin, w): (usize, usize),
    ring: &mut Ring,
    at: [usize; 2],
    count: usize,
) {
    let r = kernel.radius();
    let Range { start, end } = ring.columns;
    // Columns of the level below that there are, and where they stand in the padded rows: `padded[i]` is column
    // `start - r + i`.
    let (from, to) = (start.saturating_sub(r), (end + r).min(w));
    let place = r - (start - from);
    starts.iter_mut().for_each(|s| *s += from - origin);
    let [first, second] = padded;
    down(
        s,
        kernel,
        &below.data,
        starts,
        to - from,
        &mut first[place..],
        &mut second[place..],
    );
    for (padded, at) in [first, second].into_iter().zip(at).take(count) {
        let pixel = |column: isize| mirrored(column, w) - from + place;
        for i in 0..place {
            padded[i] = padded[pixel(i as isize + start as isize - r as isize)];
        }
        for column in to..end + r {
            padded[column - from + place] = padded[pixel(column as isize)];
        }
        let at = at + (start - origin);
        along(s, kernel, padded, end - start, &mut ring.data[at..]);
    }
}

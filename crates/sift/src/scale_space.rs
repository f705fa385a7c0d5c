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
use crate::aligned::Aligned;
use crate::blur::{
    BLOCK, Doubling, Kernel, along, along_doubled, down, down_doubled, lead, mirrored,
};

/// Columns of a tile, without its overlap.
const TILE_WIDTH: usize = 1400;

/// Rows around those of a tile that the visitor may look at.
pub(crate) const WINDOW: usize = 8;

/// Columns to either side of those of a tile that the visitor may look at.
const WINDOW_COLUMNS: usize = 10;

/// The rows around a tile that are visited, of `h`: whole pairs of doubled rows.
fn seen(rows: &Range<usize>, h: usize) -> Range<usize> {
    let start = rows.start.saturating_sub(WINDOW);
    start - start % 2..(rows.end + WINDOW).min(h)
}

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

/// Rows that a level takes as they are.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Source<'a> {
    /// The image itself.
    Image(&'a GrayImage),
    /// A plane as it is.
    Whole(&'a Plane),
    /// Every second pixel of every second row, starting with the first.
    Halved(&'a Plane),
}

impl Source<'_> {
    /// Columns and rows.
    pub(crate) fn size(&self) -> (usize, usize) {
        match self {
            Self::Image(i) => (i.width(), i.height()),
            Self::Whole(p) => (p.width, p.height),
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
            Self::Whole(plane) => out.copy_from_slice(&plane.row(y)[columns]),
            Self::Halved(plane) => copy_even(s, &plane.row(2 * y)[2 * columns.start..], out),
        }
    }
}

/// The first, third, ... value of `row`, as many as `out` takes.
#[inline(always)]
fn copy_even<S: Simd>(s: S, row: &[f32], out: &mut [f32]) {
    let whole = (row.len() / 16).min(out.len() / 8);
    let (runs, rest) = out.split_at_mut(8 * whole);
    for (out, row) in runs.chunks_exact_mut(8).zip(row.chunks_exact(16)) {
        let (low, high) = (
            f32x8::from_slice(s, &row[..8]),
            f32x8::from_slice(s, &row[8..]),
        );
        low.deinterleave(high).0.store_slice(out);
    }
    for (out, value) in rest.iter_mut().zip(row[16 * whole..].iter().step_by(2)) {
        *out = *value;
    }
}

/// The last rows of one level within a tile.
#[derive(Debug, Default)]
struct Ring {
    data: Aligned,
    stride: usize,
    /// Rows that are kept.
    kept: usize,
    /// Columns of the level that this tile computes.
    columns: Range<usize>,
    /// Column at which the rows begin.
    origin: usize,
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

    /// Where the rows `rows` of a level with `height` rows are from column `column` on, mirrored at its ends.
    /// Rows of the level that come after the last computed one are not needed: the last one stands for them.
    fn starts(&self, rows: Range<isize>, height: usize, column: usize, out: &mut Vec<usize>) {
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

    fn is_complete(&self) -> bool {
        self.next == self.rows.end
    }
}

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

/// How the rows of a level are made.
#[derive(Debug)]
pub(crate) enum Make<'a> {
    /// Taken as they are.
    Taken(Source<'a>),
    /// The level before, blurred.
    Blurred(Kernel),
    /// Level 0, doubled and blurred.
    Doubled(Doubling),
}

/// The levels of one octave.
#[derive(Debug)]
pub(crate) struct Chain<'a> {
    /// The first is taken from a source. All have the size of the octave, but for a level 0 that is doubled by others.
    pub(crate) levels: Vec<Make<'a>>,
    /// Columns and rows of the octave.
    pub(crate) size: (usize, usize),
    /// What is copied to planes.
    pub(crate) kept: Vec<Kept>,
}

/// A level that is copied to a plane.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Kept {
    pub(crate) level: usize,
    /// Whether only every second pixel of every second row is copied, starting with the first.
    pub(crate) halved: bool,
}

impl Kept {
    /// Pixels of the level in `n` pixels of a row or column.
    pub(crate) fn count(self, n: usize) -> usize {
        if self.halved { n.div_ceil(2) } else { n }
    }
}

impl<'a> Chain<'a> {
    /// `levels` as above, the size as that of the first one asks for.
    pub(crate) fn new(levels: Vec<Make<'a>>, kept: Vec<Kept>) -> Self {
        let Some(Make::Taken(source)) = levels.first() else {
            unreachable!("the first level of a chain is taken from a source");
        };
        let (w, h) = source.size();
        let size = match levels.get(1) {
            Some(Make::Doubled(_)) => (2 * w - 1, 2 * h - 1),
            _ => (w, h),
        };
        Self { levels, size, kept }
    }
}

impl Chain<'_> {
    /// Column ranges of the tiles of an octave.
    pub(crate) fn tiles(width: usize) -> impl Iterator<Item = Range<usize>> {
        let count = width.div_ceil(TILE_WIDTH).max(1);
        (0..count).map(move |i| width * i / count..width * (i + 1) / count)
    }

    /// The level that `level` is made of.
    fn below(&self, level: usize) -> Option<usize> {
        match self.levels[level] {
            Make::Taken(_) => None,
            Make::Blurred(_) => Some(level - 1),
            Make::Doubled(_) => Some(0),
        }
    }

    /// Whether the visitor sees this level.
    fn is_visible(&self, level: usize) -> bool {
        level > 0 || !matches!(self.levels.get(1), Some(Make::Doubled(_)))
    }

    /// The rows of the level below, not yet mirrored, that row `y` of `level` and the one after it are made of.
    fn rows_below(&self, level: usize, y: usize) -> Range<isize> {
        let around = |y: usize, r: usize| y as isize - r as isize..(y + r) as isize + 1;
        match &self.levels[level] {
            Make::Taken(_) => 0..0,
            Make::Blurred(kernel) => {
                let one = around(y, kernel.radius());
                one.start..one.end + 1
            }
            Make::Doubled(kernel) => around(y / 2, kernel.radius()),
        }
    }

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
            if let Make::Taken(source) = &self.levels[level] {
                for y in y..y + count {
                    let at = y % ring.kept * ring.stride + (ring.columns.start - ring.origin);
                    source.row(s, y, ring.columns.clone(), &mut ring.data[at..]);
                }
            }
            return true;
        };
        let (r, scale) = match &self.levels[level] {
            Make::Taken(_) => return true,
            Make::Blurred(kernel) => (kernel.radius(), 1),
            Make::Doubled(kernel) => (kernel.radius(), 2),
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
            Make::Taken(_) => {}
            Make::Blurred(kernel) => down(s, kernel, data, starts, width, out),
            Make::Doubled(kernel) => down_doubled(s, kernel, data, starts, width, out),
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
                Make::Taken(_) => {}
                Make::Blurred(kernel) => along(s, kernel, padded, ring.columns.len(), out),
                Make::Doubled(kernel) => along_doubled(s, kernel, padded, ring.columns.len(), out),
            }
        }
        true
    }

    /// Gives each level its rows, columns and memory; returns the column at which the rows of the visible levels begin.
    fn plan(
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
                Make::Taken(_) => continue,
                Make::Blurred(kernel) => (kernel.radius(), 1),
                Make::Doubled(kernel) => (kernel.radius(), 2),
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

/// The scale space by its definition, in f64 and with whole planes: what the sweep is tested against.
#[cfg(test)]
pub(crate) mod oracle {
    use super::*;
    use crate::Options;

    /// A plane of f64.
    #[derive(Clone)]
    pub(crate) struct Field {
        pub(crate) width: usize,
        pub(crate) height: usize,
        pub(crate) data: Vec<f64>,
    }

    impl Field {
        fn from_fn(width: usize, height: usize, f: impl Fn(usize, usize) -> f64) -> Self {
            let data = (0..width * height).map(|i| f(i % width, i / width));
            Self {
                width,
                height,
                data: data.collect(),
            }
        }

        pub(crate) fn at(&self, x: usize, y: usize) -> f64 {
            self.data[y * self.width + x]
        }

        /// Bilinear value at (x / 2, y / 2).
        fn half(&self, x: usize, y: usize) -> f64 {
            let corner = |i, j| self.at((x + i) / 2, (y + j) / 2);
            (corner(0, 0) + corner(1, 0) + corner(0, 1) + corner(1, 1)) / 4.0
        }

        fn blurred(&self, sigma: f64) -> Self {
            let r = (4.0 * sigma).ceil().max(1.0) as isize;
            let weight = |i: isize| (-0.5 * (i as f64 / sigma).powi(2)).exp();
            let sum: f64 = (-r..=r).map(weight).sum();
            let along = Self::from_fn(self.width, self.height, |x, y| {
                (-r..=r)
                    .map(|i| weight(i) / sum * self.at(mirrored(x as isize + i, self.width), y))
                    .sum()
            });
            Self::from_fn(self.width, self.height, |x, y| {
                (-r..=r)
                    .map(|i| weight(i) / sum * along.at(x, mirrored(y as isize + i, self.height)))
                    .sum()
            })
        }

        pub(crate) fn halved(&self) -> Self {
            let size = (self.width.div_ceil(2), self.height.div_ceil(2));
            Self::from_fn(size.0, size.1, |x, y| self.at(2 * x, 2 * y))
        }
    }

    /// Gaussian layers `0..=intervals + 1` of the octaves from `options.first_octave` on; at most `count` octaves. Layers 0 and 1 of an
    /// octave after the first are the last two of the one before, halved.
    pub(crate) fn octaves(image: &GrayImage, options: &Options, count: usize) -> Vec<Vec<Field>> {
        let (w, h) = (image.width(), image.height());
        let image = Field::from_fn(w, h, |x, y| f64::from(image.get(x, y)));
        let (sigma, n) = (f64::from(options.sigma), options.intervals);
        let sigma_at = |s: usize| sigma * (s as f64 / n as f64).exp2();
        let between = |from: f64, to: f64| (to * to - from * from).sqrt();
        let blur = f64::from(options.assumed_blur);
        let (mut layer_0, first_blur) = if options.first_octave < 0 {
            (
                Field::from_fn(2 * w - 1, 2 * h - 1, |x, y| image.half(x, y)),
                2.0 * blur,
            )
        } else {
            (image, blur)
        };
        let mut before = first_blur;
        for _ in 0..options.first_octave {
            layer_0 = layer_0.blurred(between(before, 2.0 * sigma)).halved();
            before = sigma;
        }
        let blurred = |s: usize| match between(before, sigma_at(s)) {
            0.0 => layer_0.clone(),
            by => layer_0.blurred(by),
        };
        let mut octaves: Vec<Vec<Field>> = vec![(0..n + 2).map(blurred).collect()];
        while octaves.len() < count {
            let finer = &octaves[octaves.len() - 1];
            let mut layers = vec![finer[n].halved(), finer[n + 1].halved()];
            for s in 2..n + 2 {
                layers.push(layers[1].blurred(between(sigma_at(1), sigma_at(s))));
            }
            octaves.push(layers);
        }
        octaves
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::at_level;
    use crate::{Options, Sift, Simd};

    fn hash(w: usize, h: usize) -> GrayImage {
        GrayImage::from_fn(w, h, |x, y| ((x * 7919 + y * 104_729) % 101) as f32 / 101.0).unwrap()
    }

    #[test]
    fn copying_every_second_value_at_every_length() {
        let row: Vec<f32> = (0..90).map(|i| i as f32).collect();
        for simd in Simd::available() {
            for n in 0..44 {
                for len in [2 * n, 2 * n + 1, 90] {
                    let mut out = vec![-1.0; n];
                    at_level!(simd, s => copy_even(s, &row[..len], &mut out));
                    assert!(
                        out.iter().enumerate().all(|(i, v)| *v == 2.0 * i as f32),
                        "{n}"
                    );
                }
            }
        }
    }

    /// Every layer that is kept, at every level, for sizes with every tail, tiles of more than one column, and all kinds of
    /// first octaves; bands by the number of threads.
    #[test]
    fn planes_are_those_of_the_definition() {
        for (w, h) in [
            (12, 12),
            (13, 40),
            (33, 31),
            (64, 48),
            (90, 77),
            (700, 24),
            (660, 150),
        ] {
            for first_octave in [-1, 0, 1] {
                let options = Options {
                    first_octave,
                    ..Options::default()
                };
                let image = hash(w, h);
                let expected = oracle::octaves(&image, &options, 2);
                for simd in Simd::available() {
                    for threads in [1, 3] {
                        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
                        let mut sift = Sift::with(options.clone(), simd).unwrap();
                        pool.build().unwrap().install(|| sift.detect(&image));
                        let planes = sift.planes();
                        for (octave, layers) in expected.iter().enumerate() {
                            let small = layers[0].width.min(layers[0].height) < 12;
                            for (layer, expected) in layers.iter().enumerate().take(3) {
                                if small || (octave == 0 && layer < 2) {
                                    continue;
                                }
                                // Layers 0 and 1 were made in the octave before, layer 2 is smooth.
                                let found = match layer {
                                    0 | 1 => &planes[octave - 1][options.intervals - 1 + layer],
                                    _ => &planes[octave][layer - 1],
                                };
                                assert_eq!(found.pitch, 2);
                                let expected = if layer == 2 {
                                    &expected.halved()
                                } else {
                                    expected
                                };
                                assert_eq!(
                                    (found.width, found.height),
                                    (expected.width, expected.height)
                                );
                                for (a, b) in found.data.iter().zip(&expected.data) {
                                    assert!(
                                        (f64::from(*a) - b).abs() < 2e-4,
                                        "{w} x {h} from {first_octave}: octave {octave}, layer {layer}: {a} {b}"
                                    );
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

//! The levels of an octave: how each is made, of which rows, and what is kept of it.

use std::ops::Range;

use super::source::Source;
use crate::blur::{Doubling, Kernel};

/// Columns of a tile, without its overlap.
const TILE_WIDTH: usize = 1400;

/// Rows around those of a tile that the visitor may look at.
pub(crate) const WINDOW: usize = 8;

/// Columns to either side of those of a tile that the visitor may look at.
pub(super) const WINDOW_COLUMNS: usize = 10;

/// The rows around a tile that are visited, of `h`: whole pairs of doubled rows.
pub(super) fn seen(rows: &Range<usize>, h: usize) -> Range<usize> {
    let start = rows.start.saturating_sub(WINDOW);
    start - start % 2..(rows.end + WINDOW).min(h)
}

/// How the rows of a level are made.
#[derive(Debug)]
pub(crate) enum LevelSource<'a> {
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
    pub(crate) levels: Vec<LevelSource<'a>>,
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
    pub(crate) fn new(levels: Vec<LevelSource<'a>>, kept: Vec<Kept>) -> Self {
        let Some(LevelSource::Taken(source)) = levels.first() else {
            unreachable!("the first level of a chain is taken from a source");
        };
        let (w, h) = source.size();
        let size = match levels.get(1) {
            Some(LevelSource::Doubled(_)) => (2 * w - 1, 2 * h - 1),
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
    pub(super) fn below(&self, level: usize) -> Option<usize> {
        match self.levels[level] {
            LevelSource::Taken(_) => None,
            LevelSource::Blurred(_) => Some(level - 1),
            LevelSource::Doubled(_) => Some(0),
        }
    }

    /// Whether the visitor sees this level.
    pub(super) fn is_visible(&self, level: usize) -> bool {
        level > 0 || !matches!(self.levels.get(1), Some(LevelSource::Doubled(_)))
    }

    /// The rows of the level below, not yet mirrored, that row `y` of `level` and the one after it are made of.
    pub(super) fn rows_below(&self, level: usize, y: usize) -> Range<isize> {
        let around = |y: usize, r: usize| y as isize - r as isize..(y + r) as isize + 1;
        match &self.levels[level] {
            LevelSource::Taken(_) => 0..0,
            LevelSource::Blurred(kernel) => {
                let one = around(y, kernel.radius());
                one.start..one.end + 1
            }
            LevelSource::Doubled(kernel) => around(y / 2, kernel.radius()),
        }
    }
}

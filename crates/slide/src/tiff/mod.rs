//! TIFF, classic and big: its pages, channels and levels, whole or by regions.

mod chunk;
mod described;
mod directory;
mod page;
mod pages;

use crate::input::Input;
use crate::layout::{Alpha, Layout};
use crate::sink::{Place, Sink};
use crate::{Budget, Choice, Choices, Fault};
use page::Page;

/// Chunks from which the range of samples is estimated, and values.
const RANGE_CHUNKS: u64 = 64;
const RANGE_VALUES: usize = 1 << 16;

/// One image of a TIFF at all its resolutions, finest first.
#[derive(Debug)]
pub(crate) struct Tiff {
    levels: Vec<Page>,
    /// Of the finest level.
    pub(crate) um_per_px: Option<f64>,
    pub(crate) choices: Choices,
}

impl Tiff {
    pub(crate) fn open(
        input: &Input<'_>,
        choice: Choice,
        budget: Budget,
        alpha: Alpha,
    ) -> Result<Self, Fault> {
        let chosen = pages::choose(input, choice)?;
        let mut choices = chosen.choices;
        // Where channels are pages the page was chosen by the channel.
        let by_page = choices.channels.len() > 1 && choice.page.is_none();
        let sample = choice.channel.filter(|_| !by_page);
        let mut levels: Vec<Page> = Vec::new();
        let mut range = None;
        for (k, directory) in chosen.levels.iter().enumerate() {
            let mut page = match Page::open(input, directory, sample, budget, alpha) {
                // A level of an unknown kind does not spoil the image.
                Err(_) if k > 0 => continue,
                page => page?,
            };
            if page.layout.has_no_range() {
                let found = match range {
                    Some(range) => range,
                    None => estimate_range(&page, input, budget)?,
                };
                range = Some(found);
                page.layout.range = found;
            }
            levels.push(page);
        }
        let bands = levels[0].bands;
        if bands > 1 && choices.channels.len() < 2 {
            choices.channels = vec![String::new(); bands];
            choices.channel = sample.unwrap_or(0);
        } else if let Some(sample) = sample {
            choices.channel = sample;
        }
        Ok(Self {
            levels,
            um_per_px: chosen.um_per_px,
            choices,
        })
    }

    pub(crate) fn levels(&self) -> usize {
        self.levels.len()
    }

    pub(crate) fn place(&self, level: usize) -> Place {
        self.levels[level].place
    }

    pub(crate) fn layout(&self, level: usize) -> &Layout {
        &self.levels[level].layout
    }

    pub(crate) fn is_tiled(&self) -> bool {
        self.levels[0].tiled
    }

    /// A whole level.
    pub(crate) fn decode(
        &self,
        input: &Input<'_>,
        level: usize,
        budget: Budget,
        sink: &mut dyn Sink,
    ) -> Result<(), Fault> {
        let page = &self.levels[level];
        for index in 0..page.count() {
            let [x, y, columns, rows] = page.inside(index);
            let place = |row: &[u8]| page.layout.row(row, columns as usize);
            let written = chunk::rows(page, input, index, budget, |j, row| {
                sink.row(x, y + j, 1, &place(row)?);
                Ok(())
            })?;
            if !written {
                let level = page.layout.blank();
                (0..rows).for_each(|j| sink.blank(x, y + j, columns, level));
            }
        }
        Ok(())
    }

    /// The chunks that touch a rectangle of the stored image, each by its number and its place in that image.
    pub(crate) fn chunks_in(
        &self,
        level: usize,
        stored: [i64; 4],
    ) -> impl Iterator<Item = (u64, [u32; 4])> + '_ {
        let page = &self.levels[level];
        page.chunks_in(stored)
            .map(|index| (index, page.inside(index)))
    }

    /// Bytes of a chunk in colour.
    pub(crate) fn chunk_bytes(&self, level: usize) -> u64 {
        let [w, h] = self.levels[level].chunk.map(u64::from);
        3 * w * h
    }

    /// One chunk, as it is stored, as far as it is inside the image. False for one that was never written.
    pub(crate) fn chunk(
        &self,
        input: &Input<'_>,
        level: usize,
        index: u64,
        budget: Budget,
        sink: &mut dyn Sink,
    ) -> Result<bool, Fault> {
        let page = &self.levels[level];
        let columns = page.inside(index)[2] as usize;
        chunk::rows(page, input, index, budget, |j, row| {
            sink.row(0, j, 1, &page.layout.row(row, columns)?);
            Ok(())
        })
    }
}

/// What is black and what is white in an image whose numbers do not say: nearly all values, and twice as far again on either side, so that
/// no pixel alone decides. Real numbers from 0 to 1 are what they are.
fn estimate_range(page: &Page, input: &Input<'_>, budget: Budget) -> Result<[f64; 2], Fault> {
    let chunks = page.count();
    let every = chunks.div_ceil(RANGE_CHUNKS).max(1);
    let [_, _, columns, rows] = page.inside(0);
    let looked_at =
        u64::from(columns) * u64::from(rows) * chunks.div_ceil(every) * page.layout.samples as u64;
    let step = (looked_at / RANGE_VALUES as u64).max(1) as usize;
    let mut values = Vec::new();
    let mut skip = 0;
    for index in (0..chunks).step_by(every as usize) {
        let columns = page.inside(index)[2] as usize;
        chunk::rows(page, input, index, budget, |_, row| {
            let count = columns * page.layout.samples;
            let numbers = page.layout.numbers(row, count)?;
            let mut at = skip;
            while at < numbers.len() {
                values.extend(Some(numbers[at]).filter(|v| v.is_finite()));
                at += step;
            }
            skip = at - numbers.len();
            Ok(())
        })?;
    }
    values.sort_unstable_by(f64::total_cmp);
    let (Some(&least), Some(&most)) = (values.first(), values.last()) else {
        return Ok([0.0, 1.0]);
    };
    let last = values.len() - 1;
    // Of few values the extreme ones are some all the same.
    let rank = (last / 1000).max(4).min(last / 2);
    let (low, high) = (values[rank], values[last - rank]);
    if page.layout.kind == crate::layout::Kind::Float && low >= 0.0 && high <= 1.0 && high > 0.1 {
        return Ok([0.0, 1.0]);
    }
    let more = 2.0 * (high - low);
    Ok(match more > 0.0 {
        true => [least.max(low - more), most.min(high + more)],
        false => [least, most],
    })
}

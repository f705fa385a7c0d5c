//! The search of a band, row by row.

use fearless_simd::{Simd, prelude::*};

use super::differences::{Differences, RUN, run, scan_row};
use super::extremum::Extremum;
use super::neighbourhood::Neighbourhood;
use super::refine::refine;
use super::response_threshold::ResponseThreshold;
use super::scan::{BORDER, Hit, LEAST_SHARE, Scan};
use crate::aligned::Aligned;
use crate::scale_space::{Levels, WINDOW};

/// Finds the extrema of the tiles of a band, row by row, with memory that is kept from one to the next.
#[derive(Debug, Default)]
pub(crate) struct Scanner {
    /// See [`Differences`].
    differences: Aligned,
    /// Samples that beat their neighbours, in order of row, and wait until all rows that the fit may look at are there.
    hits: Vec<Hit>,
    found: Vec<Extremum>,
    threshold: ResponseThreshold,
}

impl Scanner {
    /// Forgets what was found.
    pub(crate) fn begin(&mut self, scan: &Scan<'_>) {
        self.found.clear();
        self.threshold
            .begin(scan.options.max_features, scan.weakest);
    }

    /// What was found, and how strong it must be to count.
    pub(crate) fn found(&mut self) -> (&[Extremum], f32) {
        (&self.found, self.threshold.raise())
    }

    /// Takes row `y`, the next one; looks for extrema in the row before.
    #[inline(always)]
    pub(crate) fn visit<S: Simd>(&mut self, s: S, scan: &Scan<'_>, levels: &Levels<'_>, y: usize) {
        let (w, h) = levels.size;
        if w <= 2 * BORDER || h <= 2 * BORDER {
            return;
        }
        // The differences of the layers to search, and of one more before and after.
        let layers = scan.layers.clone();
        let count = layers.len() + 2;
        let finest = scan.base + layers.start - 1;
        let stride = levels.row(finest, y).len();
        self.differences.resize(3 * count * stride);
        if (levels.rows.start..levels.rows.end + 2).contains(&(y + 1)) {
            for i in 0..count {
                let (fine, coarse) = (levels.row(finest + i, y), levels.row(finest + i + 1, y));
                let out = &mut self.differences[(3 * i + y % 3) * stride..][..stride];
                for ((out, a), b) in (out.chunks_exact_mut(RUN))
                    .zip(fine.chunks_exact(RUN))
                    .zip(coarse.chunks_exact(RUN))
                {
                    (run(s, b, 0) - run(s, a, 0)).store_slice(out);
                }
            }
        }
        let begin = levels.columns.start.max(BORDER);
        let end = levels.columns.end.min(w - BORDER);
        if let Some(y) = y.checked_sub(1)
            && levels.rows.contains(&y)
            && (BORDER..h - BORDER).contains(&y)
            && begin < end
        {
            let columns = begin - levels.origin..end - levels.origin;
            let differences = Differences {
                data: &self.differences,
                stride,
            };
            for (i, layer) in layers.enumerate() {
                let threshold = LEAST_SHARE * scan.thresholds[layer].max(self.threshold.weakest);
                scan_row(
                    s,
                    &differences,
                    i + 1,
                    y,
                    threshold,
                    columns.clone(),
                    #[inline(always)]
                    |x| {
                        let x = x + levels.origin;
                        self.hits.push(Hit { layer, x, y });
                    },
                );
            }
        }
        let last = if y + 1 == levels.end { usize::MAX } else { y };
        let ready = (self.hits.iter())
            .take_while(|hit| hit.y + WINDOW <= last)
            .count();
        let around = Neighbourhood {
            levels,
            base: scan.base,
        };
        for hit in &self.hits[..ready] {
            if let Some(e) = refine(s, &around, scan, *hit, &mut self.threshold) {
                self.found.push(e);
            }
        }
        self.hits.drain(..ready);
    }
}

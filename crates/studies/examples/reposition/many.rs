//! How many runs of each kind, by which numbers, and where they are kept.

use std::path::Path;

/// Runs of one kind have numbers from this times the kind's on.
pub(crate) const EACH: u64 = 100_000;

/// How many runs, and where they are kept.
pub(crate) struct Many<'a> {
    pub(crate) count: u64,
    pub(crate) only: Option<u64>,
    pub(crate) threads: usize,
    pub(crate) out: &'a Path,
}

impl Many<'_> {
    /// The numbers of the runs of these kinds.
    pub(crate) fn numbers(&self, kinds: impl Iterator<Item = usize>) -> Vec<u64> {
        let of = |kind: usize| (0..self.count).map(move |n| kind as u64 * EACH + n);
        kinds.flat_map(of).collect()
    }
}

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
    /// The numbers of the runs of these kinds, in turn: a study that is broken off has as many of each.
    pub(crate) fn numbers(&self, kinds: impl Iterator<Item = usize>) -> Vec<u64> {
        let kinds: Vec<u64> = kinds.map(|kind| kind as u64 * EACH).collect();
        let nth = |n: u64| kinds.iter().map(move |kind| kind + n);
        (0..self.count).flat_map(nth).collect()
    }
}

/// Whether it is one of those that were asked for.
pub(crate) fn is_named(name: &str, named: &[String]) -> bool {
    named.is_empty() || named.iter().any(|part| name.contains(part.as_str()))
}

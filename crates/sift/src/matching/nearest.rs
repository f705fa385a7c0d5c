//! The nearest two so far.

/// Index of what is not there.
pub(super) const NOTHING: usize = usize::MAX;

/// Nearest and second nearest so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Nearest {
    pub(super) index: usize,
    pub(super) first_sq: u32,
    pub(super) second_sq: u32,
}

impl Nearest {
    pub(super) const NONE: Self = Self {
        index: NOTHING,
        first_sq: u32::MAX,
        second_sq: u32::MAX,
    };

    /// Adds what was found further back in the list, so that a tie keeps the lowest index.
    #[inline(always)]
    pub(super) fn see(&mut self, later: Self) {
        if later.first_sq < self.first_sq {
            self.second_sq = self.first_sq.min(later.second_sq);
            (self.index, self.first_sq) = (later.index, later.first_sq);
        } else {
            self.second_sq = self.second_sq.min(later.first_sq);
        }
    }
}

/// Distance and index of nothing.
pub(super) const NEVER: (u32, usize) = (u32::MAX, NOTHING);

/// For each query its nearest two train features, for each train feature its nearest query.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Found {
    pub(super) forward: Vec<Nearest>,
    /// Squared distance and index; the lesser pair is the one to keep.
    pub(super) backward: Vec<(u32, usize)>,
}

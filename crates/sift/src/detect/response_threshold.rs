//! The least response that counts, raised as extrema are found.

/// How strong an extremum must be to count among the strongest, as far as is known.
///
/// The answer only leaves out what the final choice would leave out too, so it does not matter in which order, or in how many
/// parts, the extrema come.
#[derive(Debug, Default)]
pub(crate) struct ResponseThreshold {
    /// As many extrema as are wanted.
    wanted: usize,
    pub(super) weakest: f32,
    /// Responses of distinct extrema above it.
    above: Vec<f32>,
}

impl ResponseThreshold {
    /// Forgets what it has seen; extrema below `weakest` do not count.
    pub(crate) fn begin(&mut self, wanted: usize, weakest: f32) {
        (self.wanted, self.weakest) = (wanted, weakest);
        self.above.clear();
    }

    /// Takes the response of one more extremum, which no other call reports: of those that have not [moved](super::Extremum::moved).
    pub(crate) fn see(&mut self, response: f32) {
        if response <= self.weakest {
            return;
        }
        self.above.push(response);
        if self.above.len() >= self.wanted.saturating_add(self.wanted / 2 + 1) {
            self.raise();
        }
    }

    /// The threshold as high as what was seen allows.
    pub(crate) fn raise(&mut self) -> f32 {
        if self.above.len() >= self.wanted {
            let last = self.wanted - 1;
            let (_, weakest, _) = (self.above).select_nth_unstable_by(last, |a, b| b.total_cmp(a));
            self.weakest = *weakest;
            self.above.truncate(self.wanted);
        }
        self.weakest
    }
}

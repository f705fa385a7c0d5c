//! A refined extremum, and the order of strength.

use std::cmp::Ordering;

/// Refined extremum, in the frame of its octave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Extremum {
    pub(crate) octave: i32,
    /// Nearest Gaussian layer, `0..intervals`.
    pub(crate) layer: usize,
    /// Position in pixels of the octave.
    pub(crate) x: f32,
    pub(crate) y: f32,
    /// Gaussian sigma in pixels of the octave.
    pub(crate) sigma: f32,
    /// |DoG| at the refined place.
    pub(crate) response: f32,
    /// Whether it is a minimum, coarse less fine: brighter than its surroundings.
    pub(crate) bright: bool,
    /// Sample at which the fit ended: column, row.
    pub(crate) sample: (usize, usize),
    /// Whether the fit began elsewhere, so that another may have ended here too.
    pub(crate) moved: bool,
}

impl Extremum {
    /// Strongest first; a total order, so that a cut after N does not depend on the order of detection. The same extremum, found
    /// twice, stands side by side.
    pub(crate) fn rank(&self, other: &Self) -> Ordering {
        (other.response.total_cmp(&self.response))
            .then(self.octave.cmp(&other.octave))
            .then(self.layer.cmp(&other.layer))
            .then(self.y.total_cmp(&other.y))
            .then(self.x.total_cmp(&other.x))
            .then(self.sample.cmp(&other.sample))
    }
}

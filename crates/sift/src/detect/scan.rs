//! What is looked for in an octave, and what was hit.

use std::ops::Range;

use crate::Options;

/// Extrema nearer to the image border than this, in pixels of their octave, are not looked at.
pub(super) const BORDER: usize = 5;

/// A sample that leads to an extremum has at least this share of its response. Where the fit promises more it is not to be trusted,
/// and with this rule no weaker sample can matter.
pub(super) const LEAST_SHARE: f32 = 0.8;

/// What to look for in an octave.
#[derive(Debug)]
pub(crate) struct Scan<'a> {
    pub(crate) options: &'a Options,
    /// Least |DoG| by layer.
    pub(crate) thresholds: Vec<f32>,
    pub(crate) octave: i32,
    /// Level of the chain that is Gaussian layer 0.
    pub(crate) base: usize,
    /// Layers to search.
    pub(crate) layers: Range<usize>,
    /// What is weaker than this cannot be among the strongest `max_features`.
    pub(crate) weakest: f32,
}

/// A sample that beats its neighbours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hit {
    pub(super) layer: usize,
    pub(super) x: usize,
    pub(super) y: usize,
}

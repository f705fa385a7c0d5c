//! What is kept from image to image, and what all steps know.

use super::bands::Band;
use crate::describe::Weights;
use crate::descriptor::Descriptor;
use crate::detect::{Extremum, ResponseThreshold};
use crate::scale_space::Plane;
use crate::{Keypoint, Options, Simd};

/// What is kept from image to image.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    /// Gaussian layers `1..=intervals + 1` of each octave, the finest first: where keypoints are oriented and described. The last two
    /// are layers 0 and 1 of the next octave, so that layer 1 itself is left out where it can be.
    pub(super) octaves: Vec<Vec<Plane>>,
    /// The image reduced to each octave before the first.
    pub(super) reduced: Vec<Plane>,
    /// One for each band of rows that runs at the same time.
    pub(super) bands: Vec<Band>,
    pub(super) threshold: ResponseThreshold,
    pub(super) found: Vec<Extremum>,
    /// Extrema that are surely among the strongest, in order of strength, and what was made of them while others were looked for.
    pub(super) ahead: (Vec<Extremum>, Vec<Portion>),
    pub(super) portions: Vec<Portion>,
}

/// What all steps know.
#[derive(Debug, Clone, Copy)]
pub(super) struct Setting<'a> {
    pub(super) options: &'a Options,
    pub(super) simd: Simd,
    pub(super) weights: &'a Weights,
}

/// What a thread makes of some extrema, with the rank of the extremum.
#[derive(Debug, Default)]
pub(super) struct Portion {
    pub(super) keypoints: Vec<(usize, Keypoint)>,
    pub(super) descriptors: Vec<Descriptor>,
}

impl Portion {
    /// Keeps its memory.
    pub(super) fn clear(&mut self) {
        self.keypoints.clear();
        self.descriptors.clear();
    }
}

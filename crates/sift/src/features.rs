//! Keypoints with their descriptors.

use serde::{Deserialize, Serialize};

use crate::{Descriptor, SiftError};

/// A place in an image with a size and a direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Keypoint {
    /// Column in pixels of the input image; whole numbers are pixel centres.
    pub x: f32,
    /// Row in pixels of the input image; whole numbers are pixel centres.
    pub y: f32,
    /// Gaussian sigma of the scale at which the extremum was found, in pixels of the input image.
    pub sigma: f32,
    /// Dominant gradient direction in radians from +x towards +y (image rows run down), in `(-pi, pi]`.
    pub angle: f32,
    /// |DoG| at the refined extremum, in units of the image values.
    pub response: f32,
    /// Whether it is brighter than its surroundings, and not darker.
    pub bright: bool,
    /// Octave in which it was found: pixels there are `2^octave` input pixels; -1 is the doubled image.
    pub octave: i32,
    /// Nearest Gaussian layer within the octave, `0..intervals`.
    pub layer: u32,
}

impl Keypoint {
    /// Whether it has a place in an image of this size, a size and a direction.
    pub(crate) fn lies_in(&self, width: usize, height: usize) -> bool {
        let inside = |v: f32, size: usize| (-0.5..=size as f32 - 0.5).contains(&v);
        inside(self.x, width)
            && inside(self.y, height)
            && self.sigma.is_finite()
            && self.sigma > 0.0
            && self.angle.is_finite()
    }
}

/// All features of one image: a value of its own, which can be stored and compared later without the image.
///
/// `descriptors[i]` belongs to `keypoints[i]`. The strongest come first; several orientations of one extremum follow each other.
///
/// The default has none, of no image.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Features {
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
    /// Where the features are.
    pub keypoints: Vec<Keypoint>,
    /// What they look like.
    pub descriptors: Vec<Descriptor>,
}

impl Features {
    /// Number of features.
    #[must_use]
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }

    /// The features at `indices`, in that order.
    ///
    /// # Panics
    /// When an index is not below [`len`](Self::len).
    #[must_use]
    pub fn subset(&self, indices: &[usize]) -> Self {
        Self {
            width: self.width,
            height: self.height,
            keypoints: indices.iter().map(|&i| self.keypoints[i]).collect(),
            descriptors: indices.iter().map(|&i| self.descriptors[i]).collect(),
        }
    }

    /// Checks what a damaged file may break: equal numbers, finite keypoints with a size inside the image. Call it after
    /// deserialising.
    ///
    /// # Errors
    /// [`SiftError::EmptyImage`], [`SiftError::FeatureLengths`] or [`SiftError::BadKeypoint`].
    pub fn check(&self) -> Result<(), SiftError> {
        if self.width == 0 || self.height == 0 {
            return Err(SiftError::EmptyImage {
                width: self.width,
                height: self.height,
            });
        }
        if self.keypoints.len() != self.descriptors.len() {
            return Err(SiftError::FeatureLengths {
                keypoints: self.keypoints.len(),
                descriptors: self.descriptors.len(),
            });
        }
        let good = |k: &Keypoint| k.lies_in(self.width, self.height) && k.response.is_finite();
        match self.keypoints.iter().position(|k| !good(k)) {
            Some(index) => Err(SiftError::BadKeypoint { index }),
            None => Ok(()),
        }
    }
}

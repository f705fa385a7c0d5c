//! Keypoints with their descriptors, and the engine that made them.

use crate::{Descriptors, FeatureError, Keypoint};
use scopeservo_sift::SiftError;

/// All features of one image: a value that can be kept and compared later without it.
///
/// Descriptor `i` belongs to `keypoints[i]`; the strongest come first. In JSON it is text: the bytes of [`to_bytes`](Self::to_bytes) in
/// base64. What earlier versions wrote out feature by feature is read, too.
#[derive(Debug, Clone, PartialEq)]
pub struct Features {
    /// The name of the engine that made them.
    pub engine: String,
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
    /// Where they are.
    pub keypoints: Vec<Keypoint>,
    /// What they look like.
    pub descriptors: Descriptors,
}

impl Features {
    /// None, of an image of this size.
    pub fn none(engine: &str, width: usize, height: usize) -> Self {
        Self {
            engine: engine.into(),
            width,
            height,
            keypoints: Vec::new(),
            descriptors: Descriptors::none(),
        }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }

    /// Those at `indices`, in that order.
    ///
    /// # Panics
    /// When an index is not below [`len`](Self::len).
    #[must_use]
    pub fn subset(&self, indices: &[usize]) -> Self {
        Self {
            engine: self.engine.clone(),
            width: self.width,
            height: self.height,
            keypoints: indices.iter().map(|&i| self.keypoints[i]).collect(),
            descriptors: self.descriptors.subset(indices),
        }
    }

    /// Whether the two can be compared.
    ///
    /// # Errors
    /// [`FeatureError::OtherEngine`].
    pub fn comparable(&self, other: &Self) -> Result<(), FeatureError> {
        if self.engine == other.engine {
            return Ok(());
        }
        Err(FeatureError::OtherEngine {
            query: self.engine.clone(),
            train: other.engine.clone(),
        })
    }

    /// Checks what a damaged file or an engine with a mistake may break: equal numbers, finite keypoints with a size inside the image.
    ///
    /// # Errors
    /// [`FeatureError::Sift`] with what does not hold.
    pub fn check(&self) -> Result<(), FeatureError> {
        let (width, height) = (self.width, self.height);
        if width == 0 || height == 0 {
            return Err(SiftError::EmptyImage { width, height }.into());
        }
        let (keypoints, descriptors) = (self.keypoints.len(), self.descriptors.len());
        if keypoints != descriptors {
            let error = SiftError::FeatureLengths {
                keypoints,
                descriptors,
            };
            return Err(error.into());
        }
        let inside = |v: f32, side: usize| (-0.5..=side as f32 - 0.5).contains(&v);
        let good = |k: &Keypoint| {
            inside(k.x, width)
                && inside(k.y, height)
                && k.sigma.is_finite()
                && k.sigma > 0.0
                && k.angle.is_finite()
                && k.response.is_finite()
        };
        match self.keypoints.iter().position(|k| !good(k)) {
            Some(index) => Err(SiftError::BadKeypoint { index }.into()),
            None => Ok(()),
        }
    }
}

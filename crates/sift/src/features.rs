//! Keypoints with their descriptors, and the walk through the stages that makes them.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::contrast::Contrast;
use crate::describe::{Descriptor, describe};
use crate::detect::{Extremum, extrema};
use crate::orient::orientations;
use crate::scale_space::{Octaves, Plane};
use crate::{GrayImage, Options, SiftError};

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
    /// Octave in which it was found: pixels there are `2^octave` input pixels; -1 is the doubled image.
    pub octave: i32,
    /// Nearest Gaussian layer within the octave, `1..=intervals`.
    pub layer: u32,
}

/// All features of one image: a value of its own, which can be stored and compared later without the image.
///
/// `descriptors[i]` belongs to `keypoints[i]`. The strongest come first; several orientations of one extremum follow each other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
        let inside = |v: f32, size: usize| (-0.5..=size as f32 - 0.5).contains(&v);
        let good = |k: &Keypoint| {
            inside(k.x, self.width)
                && inside(k.y, self.height)
                && k.sigma.is_finite()
                && k.sigma > 0.0
                && k.angle.is_finite()
                && k.response.is_finite()
        };
        match self.keypoints.iter().position(|k| !good(k)) {
            Some(index) => Err(SiftError::BadKeypoint { index }),
            None => Ok(()),
        }
    }
}

/// Detects, orients and describes the features of `image`.
///
/// The `options.max_features` strongest extrema are kept and then oriented, so that the result may hold about a third more. The
/// result is the same on any number of threads. An image without structure, or too small for the first octave (fewer than 12
/// pixels on a side after doubling), gives no features.
///
/// Memory: the planes of one octave, `2 intervals + 5` floats per pixel of the (doubled) image, plus `intervals` per pixel of
/// each octave done.
///
/// # Errors
/// [`SiftError::Option`] when `options` fail their [check](Options::check).
pub fn detect_and_describe(image: &GrayImage, options: &Options) -> Result<Features, SiftError> {
    options.check()?;
    let mut features = Features {
        width: image.width(),
        height: image.height(),
        keypoints: Vec::new(),
        descriptors: Vec::new(),
    };
    let Some(contrast) = Contrast::of(image, options) else {
        return Ok(features);
    };

    let mut found = Vec::new();
    let mut layers: Vec<Vec<Plane>> = Vec::new();
    for mut octave in Octaves::new(image, options) {
        found.extend(extrema(&octave, &contrast, options));
        // Orientation and description need the Gaussian layers in which extrema can lie, and nothing else.
        octave.gaussians.truncate(options.intervals + 1);
        layers.push(octave.gaussians.split_off(1));
    }
    found.sort_unstable_by(Extremum::rank);
    found.truncate(options.max_features);

    // Neighbours in the image one after the other, which is kinder to the caches than order of strength.
    let mut walk: Vec<usize> = (0..found.len()).collect();
    walk.sort_unstable_by_key(|&i| {
        (
            found[i].octave,
            found[i].layer,
            found[i].y as u32 / 32,
            found[i].x as u32,
        )
    });
    let mut described: Vec<(usize, Vec<(Keypoint, Descriptor)>)> = walk
        .into_par_iter()
        .with_min_len(8)
        .map(|i| {
            let e = &found[i];
            let plane = &layers[(e.octave - options.first_octave()) as usize][e.layer - 1];
            let features = orientations(plane, e.x, e.y, e.sigma)
                .into_iter()
                .map(|angle| {
                    (
                        keypoint(e, angle),
                        describe(plane, e.x, e.y, e.sigma, angle),
                    )
                })
                .collect();
            (i, features)
        })
        .collect();
    described.sort_unstable_by_key(|(i, _)| *i);
    (features.keypoints, features.descriptors) = described.into_iter().flat_map(|(_, f)| f).unzip();
    Ok(features)
}

/// From the frame of the octave to that of the image.
fn keypoint(e: &Extremum, angle: f32) -> Keypoint {
    let pixel = (e.octave as f32).exp2();
    Keypoint {
        x: e.x * pixel,
        y: e.y * pixel,
        sigma: e.sigma * pixel,
        angle,
        response: e.response,
        octave: e.octave,
        layer: e.layer as u32,
    }
}

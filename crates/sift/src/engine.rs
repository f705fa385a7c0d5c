//! The walk through the stages.

use rayon::prelude::*;

use crate::contrast::Contrast;
use crate::describe::describe;
use crate::detect::{Extremum, extrema};
use crate::orient::orientations;
use crate::scale_space::{Octaves, Plane};
use crate::{Descriptor, Features, GrayImage, Keypoint, Options, SiftError, Simd};

/// Detects and describes features: checked options, an instruction set, and buffers that are kept from image to image.
///
/// The result is the same on any number of threads.
#[derive(Debug)]
pub struct Sift {
    options: Options,
    simd: Simd,
}

impl Sift {
    /// An engine at the best [`Level`](crate::Level) that this processor has.
    ///
    /// # Errors
    /// [`SiftError::Option`] when `options` fail their [check](Options::check).
    pub fn new(options: Options) -> Result<Self, SiftError> {
        Self::with(options, Simd::best())
    }

    /// An engine at a certain level.
    ///
    /// # Errors
    /// [`SiftError::Option`] when `options` fail their [check](Options::check).
    pub fn with(options: Options, simd: Simd) -> Result<Self, SiftError> {
        options.check()?;
        Ok(Self { options, simd })
    }

    /// The options it was made with.
    #[must_use]
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The instruction set it uses.
    #[must_use]
    pub fn simd(&self) -> Simd {
        self.simd
    }

    /// Keypoints with their orientations, not described: what [`detect_and_describe`](Self::detect_and_describe) gives, without
    /// the descriptors.
    pub fn detect(&mut self, image: &GrayImage) -> Vec<Keypoint> {
        self.detect_and_describe(image).keypoints
    }

    /// Detects, orients and describes the features of `image`.
    ///
    /// The `max_features` strongest extrema are kept and then oriented, so that the result may hold about a third more. An image
    /// without structure, or too small for the first octave (fewer than 12 pixels on a side after doubling), gives no features.
    pub fn detect_and_describe(&mut self, image: &GrayImage) -> Features {
        let options = &self.options;
        let mut features = Features {
            width: image.width(),
            height: image.height(),
            keypoints: Vec::new(),
            descriptors: Vec::new(),
        };
        let Some(contrast) = Contrast::of(image, options) else {
            return features;
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
                let plane = &layers[(e.octave - options.first_octave) as usize][e.layer - 1];
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
        (features.keypoints, features.descriptors) =
            described.into_iter().flat_map(|(_, f)| f).unzip();
        features
    }
}

/// One image with an engine of its own: [`Sift::new`], then [`Sift::detect_and_describe`]. For many images keep a [`Sift`].
///
/// # Errors
/// [`SiftError::Option`] when `options` fail their [check](Options::check).
pub fn detect_and_describe(image: &GrayImage, options: &Options) -> Result<Features, SiftError> {
    Ok(Sift::new(options.clone())?.detect_and_describe(image))
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

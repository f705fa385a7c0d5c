//! The walk through the stages.

mod bands;
mod frames;
mod levels;
mod octaves;
mod portions;
mod ranking;
mod workspace;

use rayon::prelude::*;

use self::frames::extremum;
use self::portions::PORTION;
use self::ranking::walk;
use self::workspace::{Setting, Workspace};
use crate::contrast::Contrast;
use crate::describe::{Patch, Weights, describe};
use crate::descriptor::Descriptor;
use crate::detect::Extremum;
#[cfg(test)]
use crate::scale_space::Plane;
use crate::simd::at_level;
use crate::{Features, GrayImage, Keypoint, Options, SiftError, Simd};

/// Detects and describes features: checked options, an instruction set, and buffers that are kept from image to image.
///
/// The result is the same on any number of threads.
///
/// Memory: about four floats per pixel of the image (one without the doubled octave), and some rows per thread.
#[derive(Debug)]
pub struct Sift {
    options: Options,
    simd: Simd,
    weights: Weights,
    work: Workspace,
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
        Ok(Self {
            options,
            simd,
            weights: Weights::new(),
            work: Workspace::default(),
        })
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
        let mut features = Features::default();
        self.features(image, false, &mut features);
        features.keypoints
    }

    /// Detects, orients and describes the features of `image`: the `max_features` strongest, as strong as the extremum they
    /// belong to.
    ///
    /// An image without structure, or too small for the first octave (fewer than 12 pixels on a side after doubling), gives no
    /// features.
    pub fn detect_and_describe(&mut self, image: &GrayImage) -> Features {
        let mut features = Features::default();
        self.detect_and_describe_into(image, &mut features);
        features
    }

    /// The same in place of what is in `features`, in the memory that they have: for frame after frame of a camera, where fresh memory
    /// of some hundred kilobytes costs as much as a hundred descriptors.
    pub fn detect_and_describe_into(&mut self, image: &GrayImage, features: &mut Features) {
        self.features(image, true, features);
    }

    /// The strongest keypoints, with their descriptors if wanted, into `features`.
    fn features(&mut self, image: &GrayImage, described: bool, features: &mut Features) {
        features.keypoints.clear();
        features.descriptors.clear();
        (features.width, features.height) = (image.width(), image.height());
        let (setting, work) = self.parts();
        // All stages on the threads of the pool, with one way there and back.
        rayon::scope(|_| {
            if let Some(contrast) = Contrast::of(image, setting.options) {
                setting.extrema(work, image, &contrast, described);
                setting.oriented(work, described, features);
            }
        });
    }

    fn parts(&mut self) -> (Setting<'_>, &mut Workspace) {
        let setting = Setting {
            options: &self.options,
            simd: self.simd,
            weights: &self.weights,
        };
        (setting, &mut self.work)
    }

    /// Describes places that are known already: those of another frame, or some of an image's own. `descriptors[i]` belongs to
    /// `keypoints[i]`, which may be as many as one likes; `max_features` does not matter, and nothing is searched.
    ///
    /// For all keypoints of [`detect`](Self::detect), the result is that of [`detect_and_describe`](Self::detect_and_describe).
    ///
    /// # Errors
    /// [`SiftError::ForeignKeypoint`] for one outside the image, with an octave or layer that is not searched in it, with a sigma that
    /// is not half to twice that of its layer, or with an angle that is not finite.
    pub fn describe(
        &mut self,
        image: &GrayImage,
        keypoints: &[Keypoint],
    ) -> Result<Vec<Descriptor>, SiftError> {
        let (setting, work) = self.parts();
        rayon::scope(|_| {
            let octaves = setting.planes(work, image);
            let is_ours = |k: &Keypoint| setting.is_ours(k, image, octaves.len());
            if let Some(index) = keypoints.iter().position(|k| !is_ours(k)) {
                return Err(SiftError::ForeignKeypoint { index });
            }
            let places: Vec<Extremum> = keypoints.iter().map(extremum).collect();
            let walk = walk(&places, 0..places.len());
            let described: Vec<Vec<Descriptor>> = (walk.par_chunks(PORTION))
                .map_init(Patch::new, |patch, portion| {
                    let mut described = Vec::with_capacity(portion.len());
                    for &i in portion {
                        let (plane, place) = setting.place_of(octaves, &places[i]);
                        let angle = keypoints[i].angle;
                        described.push(at_level!(setting.simd, s => {
                            describe(s, setting.weights, patch, plane, place, angle)
                        }));
                    }
                    described
                })
                .collect();
            let mut descriptors = vec![Descriptor::ZERO; keypoints.len()];
            for (&i, descriptor) in walk.iter().zip(described.iter().flatten()) {
                descriptors[i] = *descriptor;
            }
            Ok(descriptors)
        })
    }

    /// Gaussian layers by octave.
    #[cfg(test)]
    pub(crate) fn planes(&self) -> &[Vec<Plane>] {
        &self.work.octaves
    }
}

/// One image with an engine of its own: [`Sift::new`], then [`Sift::detect_and_describe`]. For many images keep a [`Sift`].
///
/// # Errors
/// [`SiftError::Option`] when `options` fail their [check](Options::check).
pub fn detect_and_describe(image: &GrayImage, options: &Options) -> Result<Features, SiftError> {
    Ok(Sift::new(options.clone())?.detect_and_describe(image))
}

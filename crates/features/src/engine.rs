//! The contract of an engine.

use crate::{FeatureError, Features, Gate, GrayImage, Match, MatchOptions, match_brute_force};
use serde::{Deserialize, Serialize};
use std::fmt::Debug;

/// Which code made the features of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EngineInfo {
    /// Name and version.
    pub name: String,
    /// What it computes with: of SIFT the instructions of the processor, scalar, avx2, avx512 or neon.
    pub cpu_level: String,
}

/// Finds features in images and compares them. The same image gives the same features, on any number of threads, and several threads
/// may ask at once.
pub trait FeatureEngine: Debug + Send + Sync {
    /// A short name. Features can be compared when those of their engines are the same.
    fn name(&self) -> &str;

    /// Which code it is, for the record of a run.
    fn info(&self) -> EngineInfo;

    /// The strongest features of an image, at most so many, the strongest first. An image without any gives none.
    ///
    /// Places are in pixels of the image, whole numbers at pixel centres; `sigma` is the size in pixels, and scales with the image;
    /// `angle` turns with it, radians from +x towards +y. An engine that knows no sizes or angles cannot take part.
    ///
    /// # Errors
    /// [`FeatureError`] with what the image or the settings lack.
    fn features(&self, image: &GrayImage, most: usize) -> Result<Features, FeatureError>;

    /// The same in much less time of an image with pixels to spare, without its finest features: enough where another image at the same
    /// magnification has as many. `None` where that saves nothing, and of an engine that knows no such way.
    fn quick_features(
        &self,
        _image: &GrayImage,
        _most: usize,
    ) -> Option<Result<Features, FeatureError>> {
        None
    }

    /// The nearest neighbours among the pairs that the gate admits, in order of `query`.
    ///
    /// # Errors
    /// [`FeatureError::OtherEngine`] when the two cannot be compared.
    fn matches(
        &self,
        query: &Features,
        train: &Features,
        options: &MatchOptions,
        gate: &Gate,
    ) -> Result<Vec<Match>, FeatureError> {
        match_brute_force(query, train, options, gate)
    }
}

//! The engine of this project.

use crate::{
    Descriptors, EngineInfo, FeatureEngine, FeatureError, Features, Gate, GrayImage, Match,
    MatchOptions,
};
use scopeservo_sift::{Descriptor, Features as Found, Options, Sift, Simd, match_features_gated};
use std::sync::{Mutex, PoisonError};

/// Features of this engine can be compared with those of the same name.
pub(crate) const NAME: &str = "sift";
/// Bytes of its descriptors.
pub(crate) const COMPONENTS: usize = 128;
/// So many detectors are kept from image to image, with their planes: 15 MB each for images of 640 x 480.
const KEPT: usize = 2;
/// An image of so many pixels has features enough without those that only show at twice its size, which take half the time.
const PIXELS_TO_SPARE: usize = 1_500_000;

/// SIFT with RootSIFT descriptors, on the instructions that the processor has.
#[derive(Debug, Default)]
pub struct SiftEngine {
    options: Options,
    /// The latest detectors, which nobody uses at the moment, each with room for its features.
    idle: Mutex<Vec<(Sift, Found)>>,
}

impl SiftEngine {
    /// An engine with these settings; how many features are wanted is said with each image.
    pub fn new(options: Options) -> Self {
        Self {
            options,
            idle: Mutex::default(),
        }
    }

    /// One that is idle and has the settings, or a new one.
    fn detector(&self, options: Options) -> Result<(Sift, Found), FeatureError> {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        match idle.iter().position(|(sift, _)| *sift.options() == options) {
            Some(i) => Ok(idle.swap_remove(i)),
            None => Ok((Sift::new(options)?, Found::default())),
        }
    }

    fn found(&self, image: &GrayImage, options: Options) -> Result<Features, FeatureError> {
        let (mut sift, mut found) = self.detector(options)?;
        sift.detect_and_describe_into(image, &mut found);
        let features = Features::from(&found);
        self.keep((sift, found));
        Ok(features)
    }

    fn keep(&self, detector: (Sift, Found)) {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        idle.push(detector);
        let extra = idle.len().saturating_sub(KEPT);
        idle.drain(..extra);
    }
}

impl FeatureEngine for SiftEngine {
    fn name(&self) -> &str {
        NAME
    }

    fn info(&self) -> EngineInfo {
        EngineInfo {
            name: format!("scopeservo-sift {}", env!("CARGO_PKG_VERSION")),
            cpu_level: Simd::best().level().to_string(),
        }
    }

    fn features(&self, image: &GrayImage, most: usize) -> Result<Features, FeatureError> {
        let options = Options {
            max_features: most,
            ..self.options.clone()
        };
        self.found(image, options)
    }

    fn quick_features(
        &self,
        image: &GrayImage,
        most: usize,
    ) -> Option<Result<Features, FeatureError>> {
        let options = Options {
            max_features: most,
            first_octave: 0,
            ..self.options.clone()
        };
        let saves = self.options.first_octave < 0 && image.data().len() >= PIXELS_TO_SPARE;
        saves.then(|| self.found(image, options))
    }

    fn matches(
        &self,
        query: &Features,
        train: &Features,
        options: &MatchOptions,
        gate: &Gate,
    ) -> Result<Vec<Match>, FeatureError> {
        query.comparable(train)?;
        let (query, train) = (typed(query)?, typed(train)?);
        Ok(match_features_gated(&query, &train, options, gate))
    }
}

impl From<&Found> for Features {
    fn from(features: &Found) -> Self {
        let mut data = Vec::with_capacity(COMPONENTS * features.len());
        for descriptor in &features.descriptors {
            data.extend_from_slice(descriptor.components());
        }
        Self {
            engine: NAME.into(),
            width: features.width,
            height: features.height,
            keypoints: features.keypoints.clone(),
            descriptors: Descriptors::Bytes {
                length: COMPONENTS,
                data,
            },
        }
    }
}

/// As the SIFT library has them; the bounds of its descriptors are checked.
pub(crate) fn typed(features: &Features) -> Result<Found, FeatureError> {
    let damaged = || FeatureError::Damaged("their descriptors are not those of SIFT".into());
    let descriptors = match &features.descriptors {
        none if none.is_empty() => Vec::new(),
        Descriptors::Bytes { length, data } if *length == COMPONENTS => {
            let (all, rest) = data.as_chunks::<COMPONENTS>();
            if !rest.is_empty() {
                return Err(damaged());
            }
            let typed = all.iter().map(|bytes| Descriptor::new(*bytes));
            typed.collect::<Result<Vec<_>, _>>()?
        }
        _ => return Err(damaged()),
    };
    if descriptors.len() != features.keypoints.len() {
        return Err(damaged());
    }
    Ok(Found {
        width: features.width,
        height: features.height,
        keypoints: features.keypoints.clone(),
        descriptors,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::match_brute_force;

    fn picture(shift: f32) -> GrayImage {
        let blob = |x: f32, y: f32| (0.3 * x).sin() * (0.4 * y).cos() + (0.13 * x + 0.21 * y).sin();
        GrayImage::from_fn(160, 120, |x, y| blob(x as f32 + shift, y as f32)).unwrap()
    }

    #[test]
    fn its_kernels_match_as_the_words_say() {
        let engine = SiftEngine::default();
        let see = |shift| engine.features(&picture(shift), 500).unwrap();
        let (a, b) = (see(0.0), see(2.5));
        assert!(a.len() > 30 && b.len() > 30);
        for gate in [
            Gate::default(),
            Gate {
                turn_rad: Some((0.1, 0.5)),
                sigma_ratio: Some((0.5, 2.0)),
                same_polarity: true,
            },
        ] {
            let options = MatchOptions::default();
            let found = engine.matches(&a, &b, &options, &gate).unwrap();
            assert!(!found.is_empty());
            assert_eq!(Ok(found), match_brute_force(&a, &b, &options, &gate));
        }
    }

    #[test]
    fn detectors_are_kept_and_may_be_asked_at_once() {
        let engine = SiftEngine::default();
        let alone = engine.features(&picture(0.0), 300).unwrap();
        std::thread::scope(|threads| {
            for _ in 0..4 {
                threads.spawn(|| {
                    for _ in 0..3 {
                        assert_eq!(engine.features(&picture(0.0), 300).unwrap(), alone);
                    }
                });
            }
        });
        assert!(engine.idle.lock().unwrap().len() <= KEPT);
    }
}

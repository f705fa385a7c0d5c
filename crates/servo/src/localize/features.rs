//! Features of view and target, matched and fitted: the paper's way. Where what they look like says nothing, how they lie may.

use super::{Expected, Localizer, Measurement, says_nothing};
use crate::target::{MIN_MOVED_FEATURES, MIN_TARGET_FEATURES};
use crate::{LocatedBy, ServoError, Target, VisionOptions};
use scopeservo_features::{Features, GrayImage};
use scopeservo_registration::constellation::constellation;
use scopeservo_registration::{
    Correspondences, NotFound, Rival, find_rivals, register_correspondences,
};
use std::borrow::Cow;

/// Magnifications are alike below this ratio, target pixels per pixel of the view: above it the finest features of the view are those that the target has.
const ALIKE: f64 = 1.5;
/// So many that agree are enough without the finest.
const MANY: usize = 100;

/// Matches the features of any engine, and fits the transform that they agree on.
#[derive(Debug, Clone, Copy)]
pub struct FeatureLocalizer<'a> {
    /// The engine and the settings.
    pub vision: &'a VisionOptions,
}

impl Localizer for FeatureLocalizer<'_> {
    fn prepare<'a>(&self, target: &'a Target) -> Result<Cow<'a, Target>, ServoError> {
        if target.features.engine == self.vision.engine.name() {
            return Ok(Cow::Borrowed(target));
        }
        let image = target.gray()?;
        let all = self.vision.of_target(&image)?;
        let (features, moved) = match &target.mask {
            // What was seen to move with the stage, and nothing else, counts as when it was saved.
            Some(mask) => {
                let at = |i: &usize| [all.keypoints[*i].x, all.keypoints[*i].y].map(f64::from);
                let moving: Vec<usize> = (0..all.len()).filter(|i| mask.holds(at(i))).collect();
                (all.subset(&moving), Some(moving.len()))
            }
            None => (all, None),
        };
        let needed = match moved {
            Some(_) => MIN_MOVED_FEATURES,
            None => MIN_TARGET_FEATURES,
        };
        if features.len() < needed {
            return Err(ServoError::PoorTarget {
                features: features.len(),
                moved,
                needed,
            });
        }
        Ok(Cow::Owned(Target {
            features,
            moved,
            ..target.clone()
        }))
    }

    fn locate(
        &self,
        target: &Target,
        view: &GrayImage,
        expected: &Expected<'_>,
    ) -> Result<Result<Measurement, NotFound>, ServoError> {
        if expected.prior.scale.is_some_and(|s| s.ratio < ALIKE)
            && let Some(quick) = self.vision.of_view_quickly(view)
            && let Ok(measured) = self.measure(target, quick?, expected)
            && measured.registration.inliers >= MANY
        {
            return Ok(Ok(measured));
        }
        let features = self.vision.of_view(view)?;
        Ok(self.measure(target, features, expected))
    }

    fn rivals(
        &self,
        target: &Target,
        measured: &Measurement,
        expected: &Expected<'_>,
        without_identity: bool,
    ) -> Vec<Rival> {
        let Some(view) = &measured.features else {
            return Vec::new();
        };
        find_rivals(
            &expected.fixed.without(view),
            &expected.fixed.without(&target.features),
            &measured.registration,
            &expected.prior,
            &self.vision.registration,
            without_identity,
        )
    }
}

impl FeatureLocalizer<'_> {
    fn measure(
        &self,
        target: &Target,
        features: Features,
        expected: &Expected<'_>,
    ) -> Result<Measurement, NotFound> {
        let (prior, options) = (&expected.prior, &self.vision.registration);
        let free = expected.fixed.without(&features);
        let of_target = expected.fixed.without(&target.features);
        let engine = &*self.vision.engine;
        let matched = Correspondences::of(engine, &free, &of_target, prior, options);
        let seen = matched.and_then(|correspondences| {
            let registration = register_correspondences(&correspondences, prior, options);
            let estimate = registration.outcome.clone()?;
            Ok((LocatedBy::Features, estimate, registration, correspondences))
        });
        let (by, estimate, registration, correspondences) = seen.or_else(|reason| {
            let lie = says_nothing(&reason)
                .then(|| constellation(&free, &of_target, prior, options))
                .flatten();
            // What could lie elsewhere as well is not a place: another magnification may tell.
            let sure = lie
                .filter(|lie| lie.rivals.is_empty())
                .ok_or(reason.clone())?;
            let estimate = sure.registration.outcome.clone().map_err(|_| reason)?;
            let (by, all) = (LocatedBy::Arrangement, sure.correspondences);
            Ok((by, estimate, sure.registration, all))
        })?;
        Ok(Measurement {
            estimate,
            by,
            registration,
            correspondences,
            features: Some(features),
            rivals: Vec::new(),
        })
    }
}

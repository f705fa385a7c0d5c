//! Features first; where they say nothing, correlation.
//!
//! What the blocks of a correlation agree on are correspondences as those of features are, at places of the target that are the same from frame to
//! frame: the proof by motion asks of them what it asks of features. What else looks like the target is told as a rival.

use super::{Expected, FeatureLocalizer, Localizer, Measurement, says_nothing};
use crate::{LocatedBy, ServoError, Target, VisionOptions};
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Affine2, Vec2};
use scopeservo_registration::correlation::{Correlation, Perhaps, Picture, correlate, look_alikes};
use scopeservo_registration::{NotFound, Rival, ScalePrior};
use std::borrow::Cow;

/// Fewer agreeing features than these, below the target's magnification by at least this factor, are looked for elsewhere as well.
const FEW: usize = 12;
const LOWER: f64 = 1.5;

/// Asks features, and correlation where these are too few, do not match or do not agree.
#[derive(Debug, Clone, Copy)]
pub struct CorrelationLocalizer<'a> {
    /// The engine and the settings.
    pub vision: &'a VisionOptions,
}

impl CorrelationLocalizer<'_> {
    fn features(&self) -> FeatureLocalizer<'_> {
        FeatureLocalizer {
            vision: self.vision,
        }
    }

    /// Looks without features; `None` where nothing is known of the scale.
    fn correlated(
        &self,
        target: &Target,
        view: &GrayImage,
        expected: &Expected<'_>,
    ) -> Option<Correlation> {
        let (rotation, periods_px) = (expected.prior.rotation, &target.periods_px);
        let options = &self.vision.registration;
        pictures(target, view, expected, |view, of_target, scale| {
            correlate(view, (of_target, periods_px), scale, rotation, options)
        })
    }

    /// What is as like the target as the place where features found it, at any angle.
    fn look_alikes(
        &self,
        target: &Target,
        view: &GrayImage,
        expected: &Expected<'_>,
        first: &Affine2,
    ) -> Vec<Rival> {
        let options = &self.vision.registration;
        let alike = pictures(target, view, expected, |view, of_target, scale| {
            look_alikes(view, of_target, scale, first, options)
        });
        alike.unwrap_or_default()
    }
}

/// Asks of view and target as a correlation looks at them; `None` where nothing is known of the scale.
fn pictures<T>(
    target: &Target,
    view: &GrayImage,
    expected: &Expected<'_>,
    ask: impl FnOnce(&Picture<'_>, &Picture<'_>, ScalePrior) -> T,
) -> Option<T> {
    let scale = expected.prior.scale?;
    let image = target.gray().ok()?;
    let free = expected.fixed.free(view);
    let of_target = expected.fixed.free(&image);
    let moved = target.mask.as_ref();
    let in_view = |p: Vec2| free.as_ref().is_none_or(|m| m.holds(p));
    let in_target =
        |p: Vec2| of_target.as_ref().is_none_or(|m| m.holds(p)) && moved.is_none_or(|m| m.holds(p));
    Some(ask(
        &Picture {
            image: view,
            counts: free.is_some().then_some(&in_view),
        },
        &Picture {
            image: &image,
            counts: (of_target.is_some() || moved.is_some()).then_some(&in_target),
        },
        scale,
    ))
}

/// What was found.
fn measurement(seen: Correlation) -> Option<Measurement> {
    Some(Measurement {
        estimate: seen.registration.found()?.clone(),
        by: LocatedBy::Correlation,
        registration: seen.registration,
        correspondences: seen.correspondences,
        features: None,
        rivals: seen.rivals,
    })
}

impl Localizer for CorrelationLocalizer<'_> {
    fn prepare<'a>(&self, target: &'a Target) -> Result<Cow<'a, Target>, ServoError> {
        self.features().prepare(target)
    }

    fn locate(
        &self,
        target: &Target,
        view: &GrayImage,
        expected: &Expected<'_>,
    ) -> Result<Result<Measurement, NotFound>, ServoError> {
        let reason = match self.features().locate(target, view, expected)? {
            Ok(measured) if measured.registration.inliers >= FEW => return Ok(Ok(measured)),
            // Few things agree as well where they are there a second time, and then hardly a match passes for one of the two.
            Ok(mut measured) => {
                let found = measured.estimate.target_from_view;
                if found.linear.det().abs() >= LOWER * LOWER {
                    let alike = self.look_alikes(target, view, expected, &found);
                    measured.rivals.extend(alike);
                }
                return Ok(Ok(measured));
            }
            Err(reason) => reason,
        };
        let seen = match says_nothing(&reason) {
            true => self.correlated(target, view, expected),
            false => None,
        };
        Ok(seen.and_then(measurement).ok_or(reason))
    }

    fn perhaps(&self, target: &Target, view: &GrayImage, expected: &Expected<'_>) -> Vec<Perhaps> {
        let seen = self.correlated(target, view, expected);
        seen.map_or_else(Vec::new, |seen| seen.perhaps)
    }

    fn rivals(
        &self,
        target: &Target,
        measured: &Measurement,
        expected: &Expected<'_>,
        without_identity: bool,
    ) -> Vec<Rival> {
        let mut rivals = measured.rivals.clone();
        let all = (self.features()).rivals(target, measured, expected, without_identity);
        rivals.extend(all);
        rivals
    }
}

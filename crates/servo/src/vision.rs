//! From the camera to features.

use crate::event::tell;
use crate::{Event, FrameRole, ServoError, Sink};
use scopeservo_features::{Engine, FeatureError, Features, GrayImage};
use scopeservo_registration::{Prior, Registration, RotationPrior, ScalePrior, register};
use scopeservo_scope::{FlatField, Frame, Instrument, ObjectiveId};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;

/// So long an image is waited for that differs from the one before, and so often it is looked for.
const FROZEN: Duration = Duration::from_secs(2);
const POLL: Duration = Duration::from_millis(50);

/// The engine, its budgets and the registration settings of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VisionOptions {
    /// Finds features and compares them.
    pub engine: Engine,
    /// Features of a view, at most.
    pub view_features: usize,
    /// Features of a target, at most: made once, so it keeps more. At a lower magnification only its coarse ones can be seen, and those
    /// are weak ones at 400x.
    pub target_features: usize,
    /// Registration settings.
    pub registration: scopeservo_registration::Options,
    /// Whether a target that features do not find is looked for by correlation.
    pub correlation: bool,
}

impl Default for VisionOptions {
    fn default() -> Self {
        Self {
            engine: Engine::default(),
            view_features: 3000,
            target_features: 8000,
            registration: scopeservo_registration::Options::default(),
            correlation: true,
        }
    }
}

impl VisionOptions {
    /// Features of a view.
    pub(crate) fn of_view(&self, image: &GrayImage) -> Result<Features, ServoError> {
        self.found(image, self.view_features)
    }

    /// Features of a view in less time, without the finest; `None` where that saves nothing.
    pub(crate) fn of_view_quickly(
        &self,
        image: &GrayImage,
    ) -> Option<Result<Features, ServoError>> {
        let quick = self.engine.quick_features(image, self.view_features)?;
        Some(checked(quick))
    }

    /// Features of a target.
    pub(crate) fn of_target(&self, image: &GrayImage) -> Result<Features, ServoError> {
        self.found(image, self.target_features)
    }

    fn found(&self, image: &GrayImage, most: usize) -> Result<Features, ServoError> {
        checked(self.engine.features(image, most))
    }

    /// Registers one image's features to another's.
    pub(crate) fn register(
        &self,
        view: &Features,
        target: &Features,
        prior: &Prior,
    ) -> Registration {
        register(&*self.engine, view, target, prior, &self.registration)
    }
}

/// An engine may be anybody's: what it gives is checked before a state or a file holds it.
fn checked(found: Result<Features, FeatureError>) -> Result<Features, ServoError> {
    let features = found?;
    features.check()?;
    Ok(features)
}

/// Grabs a fresh frame and tells of it. The stage is not asked for that where it stands, which may be a round trip for each frame: who
/// needs the place has just asked, and the gate remembers what was said.
pub(crate) fn grab(
    scope: &Instrument,
    sink: &mut dyn Sink,
    role: FrameRole,
    objective: &ObjectiveId,
) -> Result<Arc<Frame>, ServoError> {
    let stood = scope.gate().last_reported();
    let frame = Arc::new(scope.grab()?);
    sink.shared_frame(&frame, role);
    let event = Event::FrameGrabbed {
        sequence: frame.sequence,
        role,
        objective: objective.clone(),
        exposure_start_s: Some(frame.exposure_start.seconds()),
        exposure_s: (!frame.exposure.is_zero()).then(|| frame.exposure.as_secs_f64()),
        stage: stood.filter(|at| scope.gate().last_reported().as_ref() == Some(at)),
    };
    tell(scope, sink, event);
    scope.check_new(&frame)?;
    Ok(frame)
}

/// The same, and not once more what was seen before the last move, as of a frame that was sent twice.
pub(crate) fn grab_from_here(
    scope: &Instrument,
    sink: &mut dyn Sink,
    role: FrameRole,
    objective: &ObjectiveId,
) -> Result<Arc<Frame>, ServoError> {
    let frame = grab(scope, sink, role, objective)?;
    match scope.shows_from_before() {
        // If that is so again, it is told as frozen.
        true => grab(scope, sink, role, objective),
        false => Ok(frame),
    }
}

/// The same, and where it can be not the image that came before once more: it could not confirm that one. Also whether it is, as the camera shows nothing new
/// for so long: it has frozen, or it has no noise, which the next move will show.
pub(crate) fn grab_another(
    scope: &Instrument,
    sink: &mut dyn Sink,
    role: FrameRole,
    objective: &ObjectiveId,
) -> Result<(Arc<Frame>, bool), ServoError> {
    let begun = scope.clock().now();
    loop {
        let frame = grab(scope, sink, role, objective)?;
        if !scope.shows_again() {
            return Ok((frame, false));
        }
        if scope.clock().now().since(begun) > FROZEN {
            scope.doubt_camera();
            return Ok((frame, true));
        }
        scope.clock().sleep(POLL);
        scope.check_cancel()?;
    }
}

/// A frame's luminance, without what is known to lie on the camera.
pub(crate) fn gray(scope: &Instrument, frame: &Frame) -> Result<GrayImage, ServoError> {
    gray_of(frame, scope.flat_field().as_deref())
}

/// The same with what lay on the camera when the frame was taken.
pub(crate) fn gray_of(
    frame: &Frame,
    flat_field: Option<&FlatField>,
) -> Result<GrayImage, ServoError> {
    let mut luminance = frame.luminance();
    if let Some(flat_field) = flat_field {
        flat_field.correct(frame.width, frame.height, &mut luminance);
    }
    Ok(to_gray(frame, luminance)?)
}

/// An image of a frame's size.
pub(crate) fn to_gray(frame: &Frame, luminance: Vec<f32>) -> Result<GrayImage, FeatureError> {
    Ok(GrayImage::new(frame.width, frame.height, luminance)?)
}

/// What is known of two views that one objective takes a small move apart: the same scale, and nearly the same angle.
pub(crate) fn same_objective(tolerance_rad: f64) -> Prior {
    Prior {
        scale: Some(ScalePrior {
            ratio: 1.0,
            tolerance: 0.03,
        }),
        rotation: Some(RotationPrior {
            angle_rad: 0.0,
            tolerance_rad,
        }),
        ..Prior::default()
    }
}

/// The pixel that everything is measured from: the image's centre, each image its own.
pub(crate) fn centre_px(width: usize, height: usize) -> [f64; 2] {
    [(width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_centre_lies_between_the_middle_pixels() {
        assert_eq!(centre_px(640, 480), [319.5, 239.5]);
        assert_eq!(centre_px(3, 1), [1.0, 0.0]);
    }
}

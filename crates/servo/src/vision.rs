//! From the camera to features.

use crate::event::tell;
use crate::{Event, FrameRole, ServoError, Sink};
use scopeservo_registration::{Prior, RotationPrior, ScalePrior};
use scopeservo_scope::{FlatField, Frame, Instrument, ObjectiveId};
use scopeservo_sift::{Features, GrayImage, Sift, Simd};
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::sync::Arc;

/// Feature budgets and registration settings of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VisionOptions {
    /// Detector settings for views.
    pub view: scopeservo_sift::Options,
    /// Detector settings for the target: made once, so it keeps more features. At a lower magnification only its coarse
    /// ones can be seen, and those are weak ones at 400x.
    pub target: scopeservo_sift::Options,
    /// Registration settings.
    pub registration: scopeservo_registration::Options,
}

impl Default for VisionOptions {
    fn default() -> Self {
        Self {
            view: scopeservo_sift::Options {
                max_features: 3000,
                ..Default::default()
            },
            target: scopeservo_sift::Options {
                max_features: 8000,
                ..Default::default()
            },
            registration: scopeservo_registration::Options::default(),
        }
    }
}

/// Which code made the features of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Engine {
    /// Name and version.
    pub name: String,
    /// CPU level of its kernels: scalar, avx2, avx512 or neon.
    pub cpu_level: String,
}

impl Engine {
    /// The engine of this build on this processor.
    pub fn current() -> Self {
        Self {
            name: format!("scopeservo-sift {}", env!("CARGO_PKG_VERSION")),
            cpu_level: Simd::best().level().to_string(),
        }
    }
}

/// Grabs a fresh frame and tells of it.
pub(crate) fn grab(
    scope: &Instrument,
    sink: &mut dyn Sink,
    role: FrameRole,
    objective: &ObjectiveId,
) -> Result<Arc<Frame>, ServoError> {
    let frame = Arc::new(scope.grab()?);
    sink.shared_frame(&frame, role);
    let event = Event::FrameGrabbed {
        sequence: frame.sequence,
        role,
        objective: objective.clone(),
    };
    tell(scope, sink, event);
    Ok(frame)
}

thread_local! {
    /// The engine of the last frame: its planes, 15 MB for a frame of 640 x 480, serve the next one.
    static ENGINE: RefCell<Option<Sift>> = const { RefCell::new(None) };
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
    Ok(GrayImage::new(frame.width, frame.height, luminance)?)
}

/// Features of a picture.
pub(crate) fn features(
    image: &GrayImage,
    options: &scopeservo_sift::Options,
) -> Result<Features, ServoError> {
    ENGINE.with_borrow_mut(|kept| {
        let engine = match kept {
            Some(engine) if engine.options() == options => engine,
            _ => kept.insert(Sift::new(options.clone())?),
        };
        Ok(engine.detect_and_describe(image))
    })
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

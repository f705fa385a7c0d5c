//! A saved view: its features, its image and how it was taken.

mod in_focus;
mod picture;
mod quality;
mod save;
mod trials;

use crate::vision::{grab, gray};
use crate::{Calibration, FrameRole, ServoError, Sink, VisionOptions};
use scopeservo_features::{Features, GrayImage, Mask};
use scopeservo_registration::periods;
use scopeservo_scope::{FlatField, Frame, Instrument, Kinematics, ObjectiveId, StagePose};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

pub use in_focus::InFocus;
pub use picture::Picture;
pub use quality::{TargetQuality, Tried, Weakness};
pub use save::{SaveOptions, SaveTarget};

/// Fewer features than this and a target cannot be told from others.
pub(crate) const MIN_TARGET_FEATURES: usize = 30;
/// Of those that were seen to move with the stage so many are enough: none of them is noise or dust.
pub(crate) const MIN_MOVED_FEATURES: usize = 15;

/// A saved view: its features and what made it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// The objective it was taken with.
    pub objective: ObjectiveId,
    /// Its features, made with the target settings; those that a step aside showed to move with the stage, when one was made.
    pub features: Features,
    /// Its luminance, to tell places that look alike from each other. Targets saved earlier lack it.
    #[serde(default)]
    pub picture: Option<Picture>,
    /// Shifts under which it looks like itself, pixels; none of what is there only once.
    #[serde(default)]
    pub periods_px: Vec<[f64; 2]>,
    /// How many of its features were seen to move with the stage; `None` when it was saved without moving, so that a run must
    /// prove it.
    #[serde(default)]
    pub moved: Option<usize>,
    /// What of its image was seen to move with the stage, for features that are made again. Targets saved without moving lack it, and those
    /// saved earlier.
    #[serde(default)]
    pub mask: Option<Mask>,
    /// How surely it is come back to. Targets saved earlier lack it, and those saved without a look at it.
    #[serde(default)]
    pub quality: Option<TargetQuality>,
    /// How it was taken. Targets saved earlier lack it.
    #[serde(skip)]
    pub taken: Option<Arc<Taken>>,
}

/// The frame that a target was made of, and what is known of how it was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct Taken {
    /// As the camera gave it, in full depth.
    pub frame: Arc<Frame>,
    /// What lay on the camera then.
    pub flat_field: Option<Arc<FlatField>>,
    /// Size of a pixel on the specimen, um: as calibrated, else as engraved.
    pub um_per_px: f64,
    /// The objective's calibration then.
    pub calibration: Option<Calibration>,
    /// Where the stage said it was.
    pub stage: StagePose,
    /// Which side the stage moves.
    pub kinematics: Kinematics,
}

impl Taken {
    /// The grey image, without the shadows on the camera, as features are made of it.
    ///
    /// # Errors
    /// [`ServoError::Features`] when it has no pixels.
    pub fn gray(&self) -> Result<GrayImage, ServoError> {
        crate::vision::gray_of(&self.frame, self.flat_field.as_deref())
    }
}

impl Target {
    /// Grabs the present view as a target without moving anything: nobody knows yet what of it belongs to the specimen.
    ///
    /// # Errors
    /// Instrument and detector errors; [`ServoError::CannotGoOn`] when no objective is active.
    pub fn save(
        scope: &Instrument,
        options: &VisionOptions,
        sink: &mut dyn Sink,
    ) -> Result<Self, ServoError> {
        Ok(Self::grab(scope, options, sink)?.0)
    }

    /// Its grey image: that of the frame, without the shadows on the camera, or the one in 8 bits.
    pub(crate) fn gray(&self) -> Result<GrayImage, ServoError> {
        if let Some(taken) = &self.taken {
            return taken.gray();
        }
        let picture = self.picture.as_ref().and_then(Picture::image);
        picture.ok_or_else(|| {
            ServoError::CannotGoOn(
                "the target has no image to make features of; save it again".into(),
            )
        })
    }

    pub(crate) fn grab(
        scope: &Instrument,
        options: &VisionOptions,
        sink: &mut dyn Sink,
    ) -> Result<(Self, GrayImage, Arc<Frame>), ServoError> {
        let objective = scope.gate().current_objective()?.ok_or_else(|| {
            ServoError::CannotGoOn("no objective is active; select one and try again".into())
        })?;
        let frame = grab(scope, sink, FrameRole::Target, &objective)?;
        let image = gray(scope, &frame)?;
        let target = Self {
            objective,
            features: options.of_target(&image)?,
            picture: Some(Picture::of(&image)),
            periods_px: periods(&image),
            moved: None,
            mask: None,
            quality: None,
            taken: None,
        };
        Ok((target, image, frame))
    }
}

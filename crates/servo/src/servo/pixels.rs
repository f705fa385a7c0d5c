//! What the pixels of a view say, besides its features: a better transform, and near the goal evidence for it.

use crate::{FixedPlaces, Law, Measurement, ServoTask};
use scopeservo_features::{GrayImage, Mask};
use scopeservo_geometry::Vec2;
use scopeservo_registration::Estimate;
use scopeservo_registration::pixels::{
    Abstained, Evidence, Pictures, Refined, Sharpness, refine, sharpness, weigh,
};

/// A view and its target, and what of them is not known to be something else than the specimen.
pub(super) struct Pixels<'a> {
    view: &'a GrayImage,
    target: GrayImage,
    of_view: Option<Mask>,
    of_target: Option<Mask>,
}

impl<'a> Pixels<'a> {
    /// `None` away from the target's own objective, and where the target has no image.
    pub(super) fn of(
        view: &'a GrayImage,
        task: &ServoTask<'_>,
        fixed: &FixedPlaces,
    ) -> Option<Self> {
        let target = task.is_arrival().then(|| task.target.gray().ok())??;
        let of_view = fixed.free(view);
        // What was not seen to move when the target was saved may be fixed to the camera.
        let of_target = match (task.target.mask.as_ref(), fixed.free(&target)) {
            (Some(moved), Some(free)) => {
                let (width, height) = (target.width(), target.height());
                let both = |p: Vec2| moved.holds(p) && free.holds(p);
                Some(Mask::of_cells(width, height, free.cell(), both))
            }
            (moved, free) => moved.cloned().or(free),
        };
        Some(Self {
            view,
            target,
            of_view,
            of_target,
        })
    }

    fn pictures(&self) -> Pictures<'_> {
        Pictures {
            view: self.view,
            target: &self.target,
            of_view: self.of_view.as_ref(),
            of_target: self.of_target.as_ref(),
        }
    }

    /// The features' transform made better, where it can be. The paper's law has the paper's measurement.
    pub(super) fn refined(
        &self,
        task: &ServoTask<'_>,
        measured: &Measurement,
    ) -> Option<Result<Refined, Abstained>> {
        (task.options.law == Law::Direct).then(|| refine(&self.pictures(), &measured.estimate))
    }

    /// How sharp the view is beside the target.
    pub(super) fn sharpness(&self, estimate: &Estimate) -> Option<Sharpness> {
        sharpness(&self.pictures(), &estimate.target_from_view)
    }

    /// Whether the pixels are evidence for a transform, those alone on which none of the features lies where there are enough.
    pub(super) fn evidence(&self, estimate: &Estimate, measured: &Measurement) -> Evidence {
        let pairs = measured.registration.pairs.iter();
        let fitted: Vec<Vec2> = pairs.map(|p| [p[0], p[1]].map(f64::from)).collect();
        weigh(&self.pictures(), &estimate.target_from_view, &fitted)
    }
}

//! Two images on one grid: that of the coarser, at its resolution.

use super::Pictures;
use super::surface::Surface;
use scopeservo_features::{GrayImage, Mask};
use scopeservo_geometry::{Affine2, Vec2};

/// Variance of what a pixel's area and the B-spline do to an image, of a pixel's square: 1/12 and 1/3.
const PIXEL_VARIANCE: f64 = 5.0 / 12.0;

/// The coarser image is fixed, the finer one is looked up where the transform takes its pixels.
pub(super) struct Matched<'a> {
    pub(super) fixed: Surface<'a>,
    pub(super) looked: Surface<'a>,
    of_fixed: Option<&'a Mask>,
    of_looked: Option<&'a Mask>,
    pub(super) view_is_fixed: bool,
}

/// How much softer both are made, standard deviations in pixels of the coarser image.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Softer {
    pub(super) fixed_px: f64,
    pub(super) looked_px: f64,
}

impl<'a> Matched<'a> {
    /// For a transform near this one. `None` for one that is singular.
    pub(super) fn new(
        pictures: &Pictures<'a>,
        target_from_view: &Affine2,
        softer: Softer,
    ) -> Option<Self> {
        let scale = target_from_view.linear.det().abs().sqrt();
        if !(scale.is_finite() && scale > 0.0) {
            return None;
        }
        let view_is_fixed = scale >= 1.0;
        let view = (pictures.view, pictures.of_view);
        let target = (pictures.target, pictures.of_target);
        let ((coarse, of_fixed), (fine, of_looked), ratio): (
            (&'a GrayImage, _),
            (&'a GrayImage, _),
            _,
        ) = match view_is_fixed {
            true => (view, target, scale),
            false => (target, view, 1.0 / scale),
        };
        let pixel = (ratio * ratio - 1.0).max(0.0) * PIXEL_VARIANCE;
        let looked_px = (pixel + (softer.looked_px * ratio).powi(2)).sqrt();
        Some(Self {
            fixed: Surface::blurred(coarse, softer.fixed_px),
            looked: Surface::blurred(fine, looked_px),
            of_fixed,
            of_looked,
            view_is_fixed,
        })
    }

    /// The finer image's pixel from the coarser one's.
    pub(super) fn looked_from_fixed(&self, target_from_view: &Affine2) -> Option<Affine2> {
        match self.view_is_fixed {
            true => Some(*target_from_view),
            false => target_from_view.inverse(),
        }
    }

    /// The same the other way round.
    pub(super) fn target_from_view(&self, looked_from_fixed: &Affine2) -> Option<Affine2> {
        self.looked_from_fixed(looked_from_fixed)
    }

    /// Whether anything is left out by masks.
    pub(super) fn is_masked(&self) -> bool {
        self.of_fixed.is_some() || self.of_looked.is_some()
    }

    /// Whether a pixel of the coarser image counts that lies at `q` in the finer one.
    pub(super) fn counts(&self, p: Vec2, q: Vec2) -> bool {
        self.of_fixed.is_none_or(|mask| mask.holds(p))
            && self.of_looked.is_none_or(|mask| mask.holds(q))
    }

    /// A place of the coarser image in the view, where it lies at `q` in the finer one.
    pub(super) fn in_view(&self, p: Vec2, q: Vec2) -> Vec2 {
        if self.view_is_fixed { p } else { q }
    }
}

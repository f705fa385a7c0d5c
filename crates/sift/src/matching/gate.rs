//! Which pairs of keypoints may be the same thing at all.

use std::f32::consts::{PI, TAU};

use crate::Keypoint;

/// Which pairs of keypoints may be the same thing at all: nearest, second nearest and mutual test see no other pair. The default
/// admits every pair. Bounds are exclusive, and what is not a number is not admitted.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Gate {
    /// Least and most `train.sigma / query.sigma`.
    pub sigma_ratio: Option<(f32, f32)>,
    /// Expected `train.angle - query.angle` and how far it may be off, both in radians; whole turns do not count.
    pub turn_rad: Option<(f32, f32)>,
    /// Bright features with bright ones only, dark with dark: right unless one image is the negative of the other.
    pub same_polarity: bool,
}

impl Gate {
    /// Whether it lets this pair through.
    #[must_use]
    pub fn admits(&self, query: &Keypoint, train: &Keypoint) -> bool {
        self.window(query).admits(self.place(train))
    }

    /// Whether it has no bounds on sigma and angle.
    pub(super) fn is_unbounded(&self) -> bool {
        self.sigma_ratio.is_none() && self.turn_rad.is_none()
    }

    /// The features that are compared among themselves, each as a test for its members.
    pub(super) fn groups(&self) -> &'static [fn(&Keypoint) -> bool] {
        match self.same_polarity {
            true => &[|k| k.bright, |k| !k.bright],
            false => &[|_| true],
        }
    }

    pub(super) fn place(&self, train: &Keypoint) -> Place {
        Place {
            sigma: self.sigma_ratio.map_or(0.0, |_| train.sigma),
            angle: self.turn_rad.map_or(0.0, |_| wrap(train.angle)),
            bright: self.same_polarity && train.bright,
        }
    }

    pub(super) fn window(&self, query: &Keypoint) -> Window {
        let (above, below) = self
            .sigma_ratio
            .map_or((f32::NEG_INFINITY, f32::INFINITY), |(least, most)| {
                (least * query.sigma, most * query.sigma)
            });
        let (angle, off) = self.turn_rad.map_or((0.0, f32::INFINITY), |(turn, off)| {
            (wrap(query.angle + turn), off)
        });
        Window {
            above,
            below,
            angle,
            off,
            bright: self.same_polarity && query.bright,
        }
    }
}

/// What a gate looks at in a train keypoint; 0 or false where it does not look.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub(super) sigma: f32,
    /// In [-pi, pi].
    pub(super) angle: f32,
    pub(super) bright: bool,
}

/// The places that a query keypoint admits.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    /// Sigma lies above this
    pub(super) above: f32,
    /// and below this,
    pub(super) below: f32,
    /// and the angle, in [-pi, pi],
    pub(super) angle: f32,
    /// is less than this off;
    pub(super) off: f32,
    /// and it is as bright as this.
    pub(super) bright: bool,
}

impl Window {
    #[inline(always)]
    pub(super) fn admits(&self, place: Place) -> bool {
        let off = (place.angle - self.angle).abs();
        place.sigma > self.above
            && place.sigma < self.below
            && off.min(TAU - off) < self.off
            && place.bright == self.bright
    }
}

/// An angle in [-pi, pi].
pub(super) fn wrap(angle: f32) -> f32 {
    if (-PI..=PI).contains(&angle) {
        return angle;
    }
    let a = angle.rem_euclid(TAU);
    if a > PI { a - TAU } else { a }
}

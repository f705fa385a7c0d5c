//! Keypoints as places: where something is, how large, and whether it is brighter than what is around.

use scopeservo_features::{Features, Keypoint};
use scopeservo_geometry::Vec2;

/// Fewer agreeing places than these are never an answer.
pub(super) const LEAST_PLACES: usize = 4;
/// What is smaller than this in the view is not surely seen there, sigma in pixels: where scale spaces begin.
const LEAST_SIGMA_PX: f64 = 1.35;
/// A keypoint nearer to a stronger one than this share of their sizes is the same thing.
const SAME: f64 = 0.7;
/// The target's strongest places are enough.
const MOST_OF_TARGET: usize = 120;

/// Something at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    pub(super) at: Vec2,
    /// Of the keypoint, pixels of its image.
    pub(super) sigma: f64,
    pub(super) bright: bool,
    /// Of the strongest keypoint.
    pub(super) index: usize,
}

/// The places of an image, the strongest first.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Places {
    pub(super) all: Vec<Place>,
    pub(super) size: [usize; 2],
}

impl Places {
    pub(super) fn of_view(view: &Features) -> Self {
        Self::of(view, 0.0, usize::MAX)
    }

    /// Those that a view of so many target pixels each can show.
    pub(super) fn of_target(target: &Features, ratio: f64) -> Self {
        Self::of(target, LEAST_SIGMA_PX * ratio, MOST_OF_TARGET)
    }

    fn of(features: &Features, least_sigma: f64, most: usize) -> Self {
        let seen = |k: &Keypoint| f64::from(k.sigma) >= least_sigma;
        let mut order: Vec<usize> = (0..features.len())
            .filter(|&i| seen(&features.keypoints[i]))
            .collect();
        let response = |i: usize| features.keypoints[i].response;
        order.sort_by(|&a, &b| response(b).total_cmp(&response(a)).then(a.cmp(&b)));
        let mut all: Vec<Place> = Vec::new();
        for index in order {
            let k = &features.keypoints[index];
            let place = Place {
                at: [k.x, k.y].map(f64::from),
                sigma: f64::from(k.sigma),
                bright: k.bright,
                index,
            };
            if all.iter().all(|kept| !kept.is_same(&place)) {
                all.push(place);
            }
            if all.len() == most {
                break;
            }
        }
        Self {
            all,
            size: [features.width, features.height],
        }
    }
}

impl Place {
    /// Keypoints of one thing: other orientations, and what lies within it as large.
    fn is_same(&self, other: &Self) -> bool {
        let apart = distance_sq(self.at, other.at).sqrt();
        let ratio = self.sigma / other.sigma;
        self.bright == other.bright
            && (1.0 / 1.6..1.6).contains(&ratio)
            && apart < SAME * self.sigma.max(other.sigma)
    }
}

/// Of two places, squared: many pairs are asked.
pub(super) fn distance_sq(a: Vec2, b: Vec2) -> f64 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}

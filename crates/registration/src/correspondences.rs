//! Features of a view and of a target that are each other's likely image: all that a registration works on, whichever engine found them.

use crate::significance::occupied_area;
use crate::{NotFound, Options, Prior, Shapes};
use scopeservo_features::{FeatureEngine, Features, Keypoint, MatchOptions};
use scopeservo_geometry::{Correspondence, Vec2};

/// Fewer features or matches than this can never pass the significance test.
pub(crate) const MIN_MATCHES: usize = 5;
/// The target's features fill cells of this side, pixels.
const AREA_CELL_PX: f64 = 20.0;

/// Places of a view and of a target that look alike, one after the other.
#[derive(Debug, Clone, PartialEq)]
pub struct Correspondences {
    /// Columns and rows of the view.
    pub view_size: [usize; 2],
    /// Part of the target that has features at all, square pixels.
    pub target_area: f64,
    /// Which feature of the view and which of the target.
    pub indices: Vec<[usize; 2]>,
    /// Where they are, with the standard deviation in target pixels, up to a common factor.
    pub pairs: Vec<Correspondence>,
    /// How they lie.
    pub shapes: Vec<Shapes>,
}

impl Correspondences {
    /// Matches view features to target features among admissible pairs (nearest, ratio and mutual test).
    ///
    /// The sigma of each grows with the scale of the keypoints and the distance of their descriptors, and falls with the weaker response.
    ///
    /// # Errors
    /// [`NotFound::TooFewFeatures`], [`NotFound::NotComparable`].
    pub fn of(
        engine: &dyn FeatureEngine,
        view: &Features,
        target: &Features,
        prior: &Prior,
        options: &Options,
    ) -> Result<Self, NotFound> {
        if view.len() < MIN_MATCHES || target.len() < MIN_MATCHES {
            return Err(NotFound::TooFewFeatures {
                view: view.len(),
                target: target.len(),
                needed: MIN_MATCHES,
            });
        }
        let match_options = MatchOptions {
            ratio: options.ratio,
            mutual: true,
        };
        let matches = engine.matches(view, target, &match_options, &prior.gate());
        let mut matches = matches.map_err(|e| NotFound::NotComparable {
            reason: e.to_string(),
        })?;
        matches.retain(|m| prior.has_moved(&view.keypoints[m.query], &target.keypoints[m.train]));
        let ratio = prior.scale.map(|s| s.ratio);
        let mut all = Self {
            view_size: [view.width, view.height],
            target_area: occupied_area(target.keypoints.iter().map(point), AREA_CELL_PX),
            indices: Vec::with_capacity(matches.len()),
            pairs: Vec::with_capacity(matches.len()),
            shapes: Vec::with_capacity(matches.len()),
        };
        for m in matches {
            let (v, t) = (&view.keypoints[m.query], &target.keypoints[m.train]);
            let shapes = [v.sigma, t.sigma, v.angle, t.angle].map(f64::from);
            let [sv, st, ..] = shapes;
            all.indices.push([m.query, m.train]);
            all.pairs.push(Correspondence {
                p_in_a: point(v),
                p_in_b: point(t),
                sigma: noise(
                    (st * st + (sv * ratio.unwrap_or(st / sv)).powi(2)).sqrt(),
                    v.response.min(t.response),
                    m.distance_sq,
                ),
            });
            all.shapes.push(shapes);
        }
        Ok(all)
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.pairs.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Those that count.
    #[must_use]
    pub fn those(&self, counts: impl Fn(&[usize; 2], &Correspondence) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.len())
            .filter(|&i| counts(&self.indices[i], &self.pairs[i]))
            .collect();
        Self {
            view_size: self.view_size,
            target_area: self.target_area,
            indices: kept.iter().map(|&i| self.indices[i]).collect(),
            pairs: kept.iter().map(|&i| self.pairs[i]).collect(),
            shapes: kept.iter().map(|&i| self.shapes[i]).collect(),
        }
    }
}

/// Where a keypoint is.
pub(crate) fn point(k: &Keypoint) -> Vec2 {
    [f64::from(k.x), f64::from(k.y)]
}

/// How far a match lies from where it belongs, up to a common factor: with the scale of both keypoints (in target pixels), the
/// weaker response and the squared distance of the descriptors.
///
/// The exponents are rounded from a fit to the distances of matches on known warps of slides (docs/sift-accuracy.md). That a large
/// keypoint is placed less well is the smaller part of it; what is faint, or has changed its looks, is the larger.
fn noise(scale: f64, response: f32, distance_sq: u32) -> f64 {
    let response = f64::from(response).max(f64::MIN_POSITIVE);
    (scale * f64::from(distance_sq + 1)).sqrt().sqrt() / response.cbrt().powi(2)
}

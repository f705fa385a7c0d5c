//! What is fixed to the camera: dust, a reticle, burnt-in text. It stays where it is on the sensor while the view moves for sure.

use crate::proof::LEAST_PX;
use scopeservo_features::Keypoint;
use scopeservo_geometry::Correspondence;
use serde::{Deserialize, Serialize};

/// A place that stayed in so many pairs of views is fixed to the camera.
const STAYED: u32 = 2;

/// Places on the sensor, px, with in how many pairs of views something stayed there.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct FixedOnSensor(Vec<([f32; 2], u32)>);

impl FixedOnSensor {
    /// The known places near one, by index, with how far they are, px.
    fn near(&self, [x, y]: [f32; 2]) -> impl Iterator<Item = (usize, f32)> {
        let off = move |p: &[f32; 2]| f32::hypot(p[0] - x, p[1] - y);
        let all = self.0.iter().map(move |(p, _)| off(p)).enumerate();
        all.filter(|(_, off_px)| f64::from(*off_px) <= LEAST_PX)
    }

    /// Something stayed in a pair of views that moved for sure, at each of these places.
    pub(super) fn stayed<'a>(&mut self, places: impl Iterator<Item = &'a Correspondence>) {
        let mut here: Vec<usize> = Vec::new();
        for c in places {
            let p = c.p_in_b.map(|v| v as f32);
            let nearest = self.near(p).min_by(|a, b| a.1.total_cmp(&b.1));
            here.push(nearest.map_or(self.0.len(), |(k, _)| k));
            if nearest.is_none() {
                self.0.push((p, 0));
            }
        }
        here.sort_unstable();
        here.dedup();
        for k in here {
            self.0[k].1 += 1;
        }
    }

    /// Whether what is at a place is known to be fixed to the camera.
    pub(super) fn holds(&self, place: [f32; 2]) -> bool {
        self.near(place).any(|(k, _)| self.0[k].1 >= STAYED)
    }

    /// The same of a feature.
    pub(super) fn has(&self, keypoint: &Keypoint) -> bool {
        self.holds([keypoint.x, keypoint.y])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64) -> Correspondence {
        Correspondence {
            p_in_a: [x, 5.0],
            p_in_b: [x + 0.1, 5.0],
            sigma: 1.0,
        }
    }

    #[test]
    fn a_place_is_fixed_once_it_has_stayed_in_two_pairs() {
        let mut fixed = FixedOnSensor::default();
        fixed.stayed([at(10.0), at(10.2)].iter());
        assert!(!fixed.holds([10.0, 5.0]));
        fixed.stayed([at(10.1), at(90.0)].iter());
        assert!(fixed.holds([10.0, 5.0]) && !fixed.holds([90.0, 5.0]));
    }

    #[test]
    fn a_place_that_was_seen_once_does_not_hide_a_fixed_one_beside_it() {
        let mut fixed = FixedOnSensor::default();
        fixed.stayed([at(10.0)].iter());
        fixed.stayed([at(14.0)].iter());
        fixed.stayed([at(13.0)].iter());
        // Near both: the nearer one stayed twice.
        assert!(fixed.holds([12.5, 5.0]));
        assert!(!fixed.holds([9.0, 5.0]));
    }
}

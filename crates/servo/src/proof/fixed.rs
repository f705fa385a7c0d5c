//! What is fixed to the camera: dust on its window, a reticle, burnt-in text, its pattern of noise. It stays where it is on the sensor while
//! the stage moves the specimen, and two frames between which the stage moved tell one from the other.

use crate::VisionOptions;
use crate::vision::same_objective;
use scopeservo_features::{Features, GrayImage, Keypoint, Mask};
use scopeservo_geometry::{Affine2, Correspondence, Vec2};
use scopeservo_registration::Prior;
use scopeservo_registration::likeness::{Likeness, Plane, likeness};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// What moves nearer than this cannot be told from what stays, pixels.
pub(crate) const LEAST_PX: f64 = 3.0;

/// Whether both images of a place lie at one place of the sensor.
pub(crate) fn stays(c: &Correspondence) -> bool {
    f64::hypot(c.p_in_a[0] - c.p_in_b[0], c.p_in_a[1] - c.p_in_b[1]) <= LEAST_PX
}
/// A place is taken for moved or fixed when its patch correlates at least so much with where that puts it,
const ALIKE: f64 = 0.6;
/// and by this much less with where the other does.
const APART: f64 = 0.3;
/// Half side of the patches of a grid over the image, and their distance, pixels.
const GRID_RADIUS: usize = 8;
const GRID_STEP: usize = 8;
/// Blur before comparing, pixels.
const BLUR_PX: f64 = 1.0;
/// The least and the greatest half side of a keypoint's patch, pixels, and its size in sigmas.
const RADIUS: [f64; 2] = [6.0, 24.0];
const RADIUS_SIGMAS: f64 = 4.0;

/// Whether a place moved with the specimen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Place {
    Moved,
    Stayed,
    Neither,
}

/// Two frames of one objective between which the specimen was seen to move.
pub(crate) struct Parallax {
    first: Plane,
    second: Plane,
    /// Pixel of the second frame from pixel of the first, for the specimen.
    pub(crate) second_from_first: Affine2,
}

impl Parallax {
    /// `None` when nothing is seen to move by [`LEAST_PX`] or more.
    pub(crate) fn of(
        (first, first_features): (&GrayImage, &Features),
        (second, second_features): (&GrayImage, &Features),
        vision: &VisionOptions,
    ) -> Option<Self> {
        let prior = Prior {
            moved_px: Some(LEAST_PX),
            ..same_objective(0.05)
        };
        let seen = vision.register(first_features, second_features, &prior);
        let second_from_first = seen.found()?.target_from_view;
        let parallax = Self {
            first: Plane::new(first, BLUR_PX),
            second: Plane::new(second, BLUR_PX),
            second_from_first,
        };
        (parallax.motion_px(first.width(), first.height()) >= LEAST_PX).then_some(parallax)
    }

    /// How far the image's centre moved.
    pub(crate) fn motion_px(&self, width: usize, height: usize) -> f64 {
        let c = crate::vision::centre_px(width, height);
        let q = self.second_from_first.apply(c);
        f64::hypot(q[0] - c[0], q[1] - c[1])
    }

    /// Judges the patch around a pixel of the first frame.
    fn judge(&self, centre: [usize; 2], radius: usize) -> Place {
        let see = |t: &Affine2| likeness(&self.first, &self.second, t, centre, radius);
        let (moved, stayed) = (see(&self.second_from_first), see(&Affine2::IDENTITY));
        // Where the motion leads out of the second frame nobody knows.
        let (
            Some(Likeness {
                correlation: moved, ..
            }),
            Some(Likeness {
                correlation: stayed,
                ..
            }),
        ) = (moved, stayed)
        else {
            return Place::Neither;
        };
        if moved >= ALIKE && stayed <= moved - APART {
            Place::Moved
        } else if stayed >= ALIKE && moved <= stayed - APART {
            Place::Stayed
        } else {
            Place::Neither
        }
    }

    /// Judges a keypoint of the first frame.
    pub(crate) fn of_keypoint(&self, k: &Keypoint) -> Place {
        let radius = (RADIUS_SIGMAS * f64::from(k.sigma)).clamp(RADIUS[0], RADIUS[1]);
        self.judge(
            [k.x, k.y].map(|v| v.round().max(0.0) as usize),
            radius as usize,
        )
    }

    /// What of the first frame, of this size, was seen to move, in cells: those whose middle moved, and those that hold a place that did.
    pub(crate) fn moving(&self, features: &Features, moved: &[Keypoint]) -> Mask {
        let (width, height) = (features.width, features.height);
        let cell_of = |p: Vec2| p.map(|v| ((v + 0.5).max(0.0) as usize) / GRID_STEP);
        let held: BTreeSet<[usize; 2]> = moved
            .iter()
            .map(|k| cell_of([k.x, k.y].map(f64::from)))
            .collect();
        Mask::of_cells(width, height, GRID_STEP, |p| {
            let middle = p.map(|v| v.round() as usize);
            held.contains(&cell_of(p)) || self.judge(middle, GRID_RADIUS) == Place::Moved
        })
    }

    /// All places that stayed, of a grid over the image and of its features.
    pub(crate) fn fixed(&self, features: &Features) -> FixedPlaces {
        let mut places = Vec::new();
        let along =
            |side: usize| (GRID_RADIUS..side.saturating_sub(GRID_RADIUS)).step_by(GRID_STEP);
        for y in along(features.height) {
            for x in along(features.width) {
                if self.judge([x, y], GRID_RADIUS) == Place::Stayed {
                    places.push([x as f32, y as f32, GRID_RADIUS as f32]);
                }
            }
        }
        let stayed = features
            .keypoints
            .iter()
            .filter(|k| self.of_keypoint(k) == Place::Stayed);
        places.extend(stayed.map(|k| extent([k.x, k.y], k.sigma)));
        FixedPlaces {
            width: features.width,
            height: features.height,
            places,
        }
    }
}

/// Places on the sensor where something is that does not belong to the specimen: x, y and radius, pixels.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct FixedPlaces {
    width: usize,
    height: usize,
    #[serde(with = "crate::compact::numbers")]
    places: Vec<[f32; 3]>,
}

/// Side of the cells in which they are left out, pixels: the middle of one lies on the smallest.
const FREE_CELL: usize = 4;

fn reaches(&[x, y, r]: &[f32; 3], p: Vec2) -> bool {
    let d = [p[0] - f64::from(x), p[1] - f64::from(y)];
    d[0] * d[0] + d[1] * d[1] < f64::from(r * r)
}

/// A keypoint's place: what lies so near to it is part of the same thing.
fn extent([x, y]: [f32; 2], sigma: f32) -> [f32; 3] {
    [x, y, (2.0 * sigma).max(4.0)]
}

impl FixedPlaces {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Columns and rows of the camera.
    pub(crate) fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Adds those of another look with the same camera.
    pub(crate) fn add(&mut self, other: FixedPlaces) {
        (self.width, self.height) = (other.width, other.height);
        self.places.extend(other.places);
    }

    /// Adds keypoints of an image that turned out not to move with the specimen: their places and sizes.
    pub(crate) fn add_keypoints(
        &mut self,
        [width, height]: [usize; 2],
        keypoints: impl Iterator<Item = (Vec2, f64)>,
    ) {
        (self.width, self.height) = (width, height);
        let places = keypoints.map(|(p, sigma)| extent([p[0] as f32, p[1] as f32], sigma as f32));
        self.places.extend(places);
    }

    /// What of an image lies on none of them, in cells; `None` where there are none, or the image is of another size, which is another camera's.
    pub(crate) fn free(&self, image: &GrayImage) -> Option<Mask> {
        let size = [image.width(), image.height()];
        if self.is_empty() || self.size() != size {
            return None;
        }
        let cells = size.map(|side| side.div_ceil(FREE_CELL));
        let middle = |cell: usize| (cell * FREE_CELL) as f64 + (FREE_CELL as f64 - 1.0) / 2.0;
        let mut free = vec![u8::MAX; cells[0] * cells[1]];
        for &[x, y, r] in &self.places {
            let [columns, rows] = [(x, cells[0]), (y, cells[1])].map(|(at, count)| {
                let end = |v: f32| (v.max(0.0) as usize / FREE_CELL).min(count);
                end(at - r)..(end(at + r) + 1).min(count)
            });
            for row in rows {
                for column in columns.clone() {
                    if reaches(&[x, y, r], [column, row].map(middle)) {
                        free[row * cells[0] + column] = 0;
                    }
                }
            }
        }
        Mask::from_cells(size[0], size[1], FREE_CELL, &free)
    }

    /// Whether a place of the image is one of them.
    pub(crate) fn holds(&self, p: Vec2) -> bool {
        self.places.iter().any(|place| reaches(place, p))
    }

    /// The features that lie on none of them. An image of another size is one of another camera, and keeps all.
    pub(crate) fn without<'a>(&self, features: &'a Features) -> std::borrow::Cow<'a, Features> {
        if self.is_empty() || [self.width, self.height] != [features.width, features.height] {
            return std::borrow::Cow::Borrowed(features);
        }
        let at = |k: &Keypoint| [f64::from(k.x), f64::from(k.y)];
        let free: Vec<usize> = (0..features.len())
            .filter(|&i| !self.holds(at(&features.keypoints[i])))
            .collect();
        std::borrow::Cow::Owned(features.subset(&free))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_fixed_place_is_left_out_wherever_it_lies_and_in_images_of_its_own_size_alone() {
        let image = GrayImage::from_fn(64, 48, |_, _| 0.5).unwrap();
        for k in 0..64 {
            let at = [
                20.0 + 0.25 * f64::from(k % 8),
                17.0 + 0.25 * f64::from(k / 8),
            ];
            let mut fixed = FixedPlaces::default();
            fixed.add_keypoints([64, 48], std::iter::once((at, 1.6)));
            let free = fixed.free(&image).unwrap();
            assert!(!free.holds(at), "{at:?}");
            // As each cell's middle says.
            let asked = Mask::of_cells(64, 48, FREE_CELL, |p| !fixed.holds(p));
            assert_eq!(free, asked, "{at:?}");
            let other = GrayImage::from_fn(48, 64, |_, _| 0.5).unwrap();
            assert_eq!(fixed.free(&other), None);
        }
        // Beyond the image's edges nothing is, and at them it is.
        let mut fixed = FixedPlaces::default();
        let ends = [[0.0, 0.0], [63.0, 47.0], [63.0, 0.0]];
        fixed.add_keypoints([64, 48], ends.into_iter().map(|p| (p, 3.0)));
        let asked = Mask::of_cells(64, 48, FREE_CELL, |p| !fixed.holds(p));
        assert_eq!(fixed.free(&image), Some(asked));
    }
}

//! The middle and the corners of an image.

use scopeservo_geometry::Vec2;

/// The middle of an image of this size, pixels.
pub(crate) fn centre(size: [usize; 2]) -> Vec2 {
    size.map(|side| (side as f64 - 1.0) / 2.0)
}

/// The centres of its corner pixels.
pub(crate) fn corners(size: [usize; 2]) -> [Vec2; 4] {
    let [w, h] = size.map(|side| side as f64 - 1.0);
    [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]]
}

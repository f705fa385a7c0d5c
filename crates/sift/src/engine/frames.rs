//! Between a keypoint in the frame of the image and an extremum in that of its octave.

use crate::Keypoint;
use crate::detect::Extremum;

/// From the frame of the image to that of the octave: the place of a keypoint.
pub(super) fn extremum(k: &Keypoint) -> Extremum {
    let pixel = (k.octave as f32).exp2();
    Extremum {
        octave: k.octave,
        layer: k.layer as usize,
        x: k.x / pixel,
        y: k.y / pixel,
        sigma: k.sigma / pixel,
        response: k.response,
        bright: k.bright,
        sample: (0, 0),
        moved: false,
    }
}

/// From the frame of the octave to that of the image.
pub(super) fn keypoint(e: &Extremum, angle: f32) -> Keypoint {
    let pixel = (e.octave as f32).exp2();
    Keypoint {
        x: e.x * pixel,
        y: e.y * pixel,
        sigma: e.sigma * pixel,
        angle,
        response: e.response,
        bright: e.bright,
        octave: e.octave,
        layer: e.layer as u32,
    }
}

//! Calibration in two steps, the paper's section IV-A: eight translations for the 2x2 map (13)-(15), then rotations for the rotation
//! centre (17)-(18). Works over a general 2x2 map; kx, ky, phi are a reading of it.
//!
//! What is fixed to the camera (dust, a reticle, burnt-in text) stays while a translation moves the view, and counts in none of them. A
//! rotation may leave the view's centre where it is; there what stayed in the translations is left out.

mod estimate;
mod observe;
mod plan;
mod procedure;

#[cfg(test)]
pub(crate) use plan::DIRECTIONS;
pub(crate) use procedure::TwoStep;

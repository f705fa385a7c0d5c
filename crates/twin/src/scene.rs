//! What is rendered, and what comes out.

use crate::config::ObjectiveConfig;
use crate::slide::Effects;
use crate::specimen::Specimen;

/// What stays the same during one exposure.
pub(crate) struct Scene<'a> {
    pub(crate) specimen: &'a dyn Specimen,
    pub(crate) effects: &'a Effects,
    pub(crate) optics: &'a ObjectiveConfig,
    pub(crate) width: usize,
    pub(crate) height: usize,
}

/// Three planes (red, green, blue), 1 is white.
pub(crate) type Planes = [Vec<f32>; 3];

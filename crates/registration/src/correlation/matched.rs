//! View and target at one scale.

use super::plane::Plane;

/// View and target at one scale.
pub(super) struct Matched<'a> {
    pub(super) view: &'a Plane,
    pub(super) target: &'a Plane,
    pub(super) view_size: [usize; 2],
    pub(super) target_size: [usize; 2],
    /// Target pixels per view pixel.
    pub(super) ratio: f64,
}

impl Matched<'_> {
    /// Samples of the target for one of the view.
    pub(super) fn target_pitch(&self) -> f64 {
        self.ratio * self.view.every as f64 / self.target.every as f64
    }

    /// The target's sides in samples of the view.
    pub(super) fn target_samples(&self) -> [f64; 2] {
        let pitch = self.target_pitch();
        [self.target.width, self.target.height].map(|n| n as f64 / pitch)
    }
}

//! One sample, as a level sees it.

/// One sample is sharper than another for sure beyond so many standard deviations of their difference.
const SURE_SIGMAS: f64 = 6.0;

/// A sample on one level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    pub(crate) z_um: f64,
    /// The measure over the light, the noise's share taken off.
    pub(crate) value: f64,
    pub(crate) sigma: f64,
}

impl Point {
    /// Whether it is sharper for sure, and by a factor of `contrast`.
    pub(crate) fn above(&self, other: &Self, contrast: f64) -> bool {
        let sigma = f64::hypot(self.sigma, other.sigma);
        let base = other.value.max(0.0);
        self.value - other.value > SURE_SIGMAS * sigma && self.value > contrast * base
    }
}

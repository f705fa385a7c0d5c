//! A camera that sets its exposure by itself.

use crate::camera_config::{AutoExposureConfig, CameraConfig};
use scopeservo_scope::Samples;

/// By how much it exposes longer than it was told, and how that changes with what it sees.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Adapted {
    factor: f64,
    /// What it would have to be for the last frame to be as bright as it wants.
    wants: f64,
    since: f64,
    settle_s: f64,
}

impl Adapted {
    /// It has looked at what was there before.
    pub(crate) fn new(now: f64) -> Self {
        Self {
            factor: 1.0,
            wants: 1.0,
            since: now,
            settle_s: 1.0,
        }
    }

    /// The factor at a moment.
    pub(crate) fn factor(&self, now: f64) -> f64 {
        let left = (-(now - self.since).max(0.0) / self.settle_s).exp();
        self.factor.powf(left) * self.wants.powf(1.0 - left)
    }

    /// A frame that began to be exposed at `now`.
    pub(crate) fn see(&mut self, camera: &CameraConfig, samples: &Samples, now: f64) {
        let Some(AutoExposureConfig {
            mean_level,
            settle_s,
            most,
        }) = camera.auto_exposure
        else {
            return;
        };
        let full = f64::from((1u32 << camera.bit_depth) - 1);
        let (sum, count): (f64, usize) = match samples {
            Samples::U8(v) => (v.iter().map(|&v| f64::from(v)).sum(), v.len()),
            Samples::U16(v) => (v.iter().map(|&v| f64::from(v)).sum(), v.len()),
        };
        let mean = sum / (count.max(1) as f64 * full);
        let factor = self.factor(now);
        // One frame of a black image tells no more than that it is far too dark.
        let wants = factor * mean_level / mean.max(0.1 * mean_level);
        *self = Self {
            factor,
            wants: wants.clamp(1.0 / most, most),
            since: now,
            settle_s,
        };
    }
}

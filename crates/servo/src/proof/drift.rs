//! Whether a view moves by itself.

use scopeservo_geometry::Vec2;
use serde::{Deserialize, Serialize};

/// Whether a target that rests was seen from one place at several moments to drift.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Drift {
    /// Speeds that were too high, um/s, one after the other.
    seen: Vec<Vec2>,
}

/// Speeds that agree: their sum is at least this share of the sum of their lengths.
const ONE_WAY: f64 = 0.85;

impl Drift {
    /// Takes how far the view went by itself in `seconds`, known to `sigma_um`; tells the speed when it drifts for sure.
    pub(crate) fn take(
        &mut self,
        way_um: Vec2,
        seconds: f64,
        sigma_um: f64,
        tolerance_um: f64,
    ) -> Option<f64> {
        let way = f64::hypot(way_um[0], way_um[1]);
        // More than three sigmas, and half the tolerance in a second.
        if seconds <= 0.0 || way <= 3.0 * sigma_um || way <= 0.5 * tolerance_um * seconds {
            self.seen.clear();
            return None;
        }
        self.seen.push(way_um.map(|w| w / seconds));
        let lengths: f64 = self.seen.iter().map(|v| f64::hypot(v[0], v[1])).sum();
        let sum = [0, 1].map(|k| self.seen.iter().map(|v| v[k]).sum::<f64>());
        let one_way = f64::hypot(sum[0], sum[1]) >= ONE_WAY * lengths;
        let speed = lengths / self.seen.len() as f64;
        // A stage that creeps after a move, or shakes, is looked at once or twice more.
        let needed = if speed > tolerance_um { 2 } else { 3 };
        (one_way && self.seen.len() >= needed).then_some(speed)
    }

    /// Whether the last look saw it drift.
    pub(crate) fn suspected(&self) -> bool {
        !self.seen.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drift_is_sure_when_it_goes_one_way_again_and_again() {
        let mut drift = Drift::default();
        assert_eq!(drift.take([2.5, 0.0], 0.5, 0.02, 0.8), None);
        assert!(drift.suspected());
        let speed = drift.take([2.4, 0.2], 0.5, 0.02, 0.8).unwrap();
        assert!((speed - 4.9).abs() < 0.05, "{speed}");
        // Slower than the tolerance in a second: three looks.
        let mut slow = Drift::default();
        assert_eq!(slow.take([0.3, 0.0], 0.5, 0.02, 0.8), None);
        assert_eq!(slow.take([0.3, 0.0], 0.5, 0.02, 0.8), None);
        assert!(slow.take([0.3, 0.0], 0.5, 0.02, 0.8).is_some());
    }

    #[test]
    fn shaking_and_what_is_within_noise_or_tolerance_is_no_drift() {
        let mut shaking = Drift::default();
        for k in 0..20 {
            let way = if k % 2 == 0 { 0.5 } else { -0.5 };
            assert_eq!(shaking.take([way, 0.0], 0.5, 0.02, 0.8), None);
        }
        let mut noisy = Drift::default();
        for _ in 0..20 {
            assert_eq!(noisy.take([0.5, 0.0], 0.5, 0.2, 0.8), None);
            assert_eq!(noisy.take([0.15, 0.0], 0.5, 0.01, 0.8), None);
            assert!(!noisy.suspected());
        }
    }
}

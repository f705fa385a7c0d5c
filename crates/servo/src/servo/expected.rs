//! What is expected of the next frame.

use crate::ServoTask;
use scopeservo_geometry::Affine2;
use scopeservo_registration::{Prior, RotationPrior, ScalePrior};
use serde::{Deserialize, Serialize};

/// How far the view may have turned since the last frame that was understood, radians: by lost frames in a row since. After more, any
/// angle is expected.
const TURNED_RAD: [f64; 2] = [0.1, 0.4];
/// How far the scale may be off what the calibrations say, in the same way. One that is off by more than the first is told.
const SCALED: [f64; 2] = [0.04, 0.2];

/// The angle of the last frame, or that which the move since then brings, and how many were lost since.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Expected {
    angle_rad: Option<f64>,
    lost_in_a_row: usize,
    /// The scale that was seen over that of the calibrations, where they disagree.
    #[serde(default)]
    scaled: Option<f64>,
}

impl Expected {
    /// What is known before matching: the scale from both calibrations, the angle from the last frame.
    pub(crate) fn prior(&self, task: &ServoTask<'_>) -> Prior {
        Prior {
            scale: SCALED.get(self.lost_in_a_row).map(|tolerance| ScalePrior {
                ratio: self.scaled.unwrap_or(1.0) * scale_of(task),
                tolerance: *tolerance,
            }),
            rotation: self.rotation(),
            ..Prior::default()
        }
    }

    /// The scale of a transform over that of the calibrations, where it is not what was expected.
    pub(crate) fn surprises(
        &self,
        target_from_view: &Affine2,
        task: &ServoTask<'_>,
    ) -> Option<f64> {
        let factor = target_from_view.linear.det().abs().sqrt() / scale_of(task);
        let off = factor / self.scaled.unwrap_or(1.0) - 1.0;
        // What was found within the first tolerance lies there, to within what the measurement adds.
        (off.abs() > 1.25 * SCALED[0]).then_some(factor)
    }

    /// From now on the scale is so many times that of the calibrations.
    pub(crate) fn scaled(&mut self, factor: f64) {
        self.scaled = Some(factor);
    }

    fn rotation(&self) -> Option<RotationPrior> {
        Some(RotationPrior {
            angle_rad: self.angle_rad?,
            tolerance_rad: *TURNED_RAD.get(self.lost_in_a_row)?,
        })
    }

    /// Takes the angle of a frame; tells whether it was found only because lost frames had widened what was expected.
    pub(crate) fn found(&mut self, angle_rad: Option<f64>) -> bool {
        let turn = |(was, is): (f64, f64)| (is - was).sin().atan2((is - was).cos()).abs();
        let turned = self.lost_in_a_row > 0
            && (self.angle_rad.zip(angle_rad)).is_some_and(|both| turn(both) > TURNED_RAD[0]);
        (self.angle_rad, self.lost_in_a_row) = (angle_rad, 0);
        turned
    }

    /// The view is about to be moved, and then has this angle.
    pub(crate) fn moving(&mut self, angle_rad: Option<f64>) {
        (self.angle_rad, self.lost_in_a_row) = (angle_rad, 0);
    }

    /// Takes a lost frame; tells how many there were in a row.
    pub(crate) fn lost(&mut self) -> usize {
        self.lost_in_a_row += 1;
        self.lost_in_a_row
    }

    /// Any angle is expected again.
    pub(crate) fn forget_angle(&mut self) {
        self.angle_rad = None;
    }
}

impl ServoTask<'_> {
    /// What is known before any frame: the scale.
    pub(crate) fn before_any_frame(&self) -> Prior {
        Expected::default().prior(self)
    }
}

/// Pixels of the target to one of the view.
fn scale_of(task: &ServoTask<'_>) -> f64 {
    task.view_calibration.um_per_px() / task.target_calibration.um_per_px()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_frames_in_a_row_widen_the_angle_that_is_expected() {
        let mut expected = Expected::default();
        let tolerance = |e: &Expected| e.rotation().map(|r| r.tolerance_rad);
        assert_eq!(tolerance(&expected), None);
        assert!(!expected.found(Some(3.1)));
        assert_eq!(tolerance(&expected), Some(0.1));
        assert_eq!((expected.lost(), tolerance(&expected)), (1, Some(0.4)));
        assert_eq!((expected.lost(), tolerance(&expected)), (2, None));
        // The angle wraps: 3.1 and -3.1 are near each other.
        assert!(!expected.found(Some(-3.1)));
        assert_eq!(tolerance(&expected), Some(0.1));
        expected.lost();
        assert!(expected.found(Some(-2.8)));
        // After a move it is where the move brings it, however far that is.
        expected.moving(Some(0.1));
        assert_eq!(expected.rotation().map(|r| r.angle_rad), Some(0.1));
    }
}

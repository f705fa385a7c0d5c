//! What is expected of the next frame.

use crate::ServoTask;
use scopeservo_registration::{Prior, RotationPrior, ScalePrior};
use serde::{Deserialize, Serialize};

/// How far the view may have turned since the last frame that was understood, radians.
const TURNED_RAD: f64 = 0.1;

/// The angle of the last frame, and how many were lost since.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Expected {
    angle_rad: Option<f64>,
    lost_in_a_row: usize,
}

impl Expected {
    /// What is known before matching: the scale from both calibrations, the angle from the last frame.
    pub(crate) fn prior(&self, task: &ServoTask<'_>) -> Prior {
        Prior {
            scale: Some(ScalePrior {
                ratio: task.view_calibration.um_per_px() / task.target_calibration.um_per_px(),
                tolerance: 0.04,
            }),
            rotation: self.rotation(),
            ..Prior::default()
        }
    }

    fn rotation(&self) -> Option<RotationPrior> {
        Some(RotationPrior {
            angle_rad: self.angle_rad?,
            tolerance_rad: TURNED_RAD,
        })
    }

    /// Takes the angle of a frame.
    pub(crate) fn found(&mut self, angle_rad: Option<f64>) {
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

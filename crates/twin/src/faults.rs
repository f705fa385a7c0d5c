//! What can break in stage and camera.

use scopeservo_scope::Axis;
use serde::{Deserialize, Serialize};

/// A fault of the stage or of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum StageFault {
    /// The motor slips: the axis is off by this much from now on and does not know (m or rad).
    LostSteps {
        /// Which axis.
        axis: Axis,
        /// By how much, m or rad.
        si: f64,
    },
    /// The axis stays where it is and reports that it moves.
    StuckAxis {
        /// Which axis.
        axis: Axis,
        /// Stuck, or free again.
        stuck: bool,
    },
    /// Play in the drive, from the next move on (m or rad).
    Backlash {
        /// Which axis.
        axis: Axis,
        /// Difference between arriving from below and from above, m or rad.
        si: f64,
    },
    /// x, y and z creep at this rate from now on, in place of the present drift.
    Drift {
        /// Rate along x, y, z, um/s.
        um_per_s: [f64; 3],
    },
    /// The next frames are lost; the sequence numbers show the gap.
    DropFrames(
        /// How many.
        u32,
    ),
    /// The next frames arrive late. Their time stamps tell the truth.
    LateFrames {
        /// How many.
        count: u32,
        /// How late, s.
        delay_s: f64,
    },
    /// The lower half of the next frame is one frame period older than its upper half.
    TornFrame,
    /// The plug is pulled: stage, nosepiece and camera are lost, and what moves stops. Or it is put back.
    Unplugged(
        /// Pulled, or put back.
        bool,
    ),
}

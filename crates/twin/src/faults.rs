//! What can break in stage and camera.

use scopeservo_scope::Axis;
use serde::{Deserialize, Serialize};

/// A hair between objective and sensor, which drifts through the image: neither with the specimen nor fixed to the camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriftingHair {
    /// Where its middle is at first, px.
    pub at_px: [f64; 2],
    /// How it drifts, px/s.
    pub px_per_s: [f64; 2],
    /// Half its thickness, px.
    pub radius_px: f64,
    /// Its length over its thickness.
    pub stretch: f64,
    /// How its length lies, deg from the rows.
    pub angle_deg: f64,
    /// Light that it takes in its middle, 0..1.
    pub attenuation: f64,
}

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
    /// From the next move on x and y go by this map of the way that they are told and say, and the rotation by its factor.
    Goes {
        /// Row by row: the identity where nothing is wrong.
        xy: [[f64; 2]; 2],
        /// 1 where nothing is wrong.
        rz: f64,
    },
    /// An obstacle: the axis goes no farther either way, and says where it stands (m or rad).
    Wall {
        /// Which axis.
        axis: Axis,
        /// Where the obstacles are; `None` when they are gone.
        between: Option<[f64; 2]>,
    },
    /// Every move of one axis takes another along by so much, which the stage says (m or rad).
    TakesAlong {
        /// The one that is moved.
        axis: Axis,
        /// The one that goes along.
        along: Axis,
        /// By how much; 0 when it is mended.
        si: f64,
    },
    /// What the stage says of an axis is off by this much (m or rad).
    Misreports {
        /// Which axis.
        axis: Axis,
        /// By how much; 0 when it is mended.
        si: f64,
    },
    /// Commands to stop are taken and not obeyed, or obeyed again.
    IgnoresStop(
        /// Whether they are ignored.
        bool,
    ),
    /// x, y and z creep at this rate from now on, in place of the present drift.
    Drift {
        /// Rate along x, y, z, um/s.
        um_per_s: [f64; 3],
    },
    /// The ground shakes from now on: amplitude along x and y, at rest as well, um.
    Vibration {
        /// How strong.
        um: f64,
    },
    /// A hair drifts past the camera's window, or none does any more.
    Hair(
        /// What it is like; `None` when it is gone.
        Option<DriftingHair>,
    ),
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
    /// The image that was shown last is shown again and again, with new time stamps, or no more.
    FrozenCamera(
        /// Whether it is.
        bool,
    ),
    /// Images are shown so many grabs late, with new time stamps.
    StaleFrames(
        /// How many, up to 12; 0 when it is mended.
        usize,
    ),
    /// The camera gives no image any more, or does again.
    SilentCamera(
        /// Whether it is silent.
        bool,
    ),
    /// The camera is turned in its mount, about the image's middle, deg.
    CameraTurned(
        /// By how much from where it was at first.
        f64,
    ),
    /// So many pixels by as many become one.
    Binned(
        /// How many; 1 for all pixels.
        usize,
    ),
    /// In the beam is another objective than the nosepiece says, whatever it is told.
    InBeam(
        /// Its number in the nosepiece; `None` when it is mended.
        Option<usize>,
    ),
    /// The plug is pulled: stage, nosepiece and camera are lost, and what moves stops. Or it is put back.
    Unplugged(
        /// Pulled, or put back.
        bool,
    ),
}

//! What a pattern slide says.

use crate::Calibration;
use scopeservo_registration::Term;
use scopeservo_scope::ObjectiveId;
use serde::{Deserialize, Serialize};

/// A number and its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Known {
    /// The number.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// The paper's three, where it has the handedness for it ([`Calibration::reading`]).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GridReading {
    /// Pixels per metre along image x.
    pub kx_px_per_m: Known,
    /// Pixels per metre along image y.
    pub ky_px_per_m: Known,
    /// Angle between camera and stage, degrees.
    pub phi_deg: Known,
}

/// How far the stage goes, by the pitch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StageSeen {
    /// How much farther x goes than it says, relative: 0.005 is 0.5 % too far.
    pub x: Known,
    /// The same of y.
    pub y: Known,
    /// The angle from x to y less a right one (opened towards a left-handed one as well), degrees.
    pub square_deg: Known,
    /// How much farther the rotation turns than it says, relative.
    pub rotation: Option<Known>,
    /// How far arrivals were seen to scatter, per coordinate, um.
    pub scatter_um: f64,
    /// The longest moves that were seen, along x and y, um.
    pub reach_um: [f64; 2],
}

/// What a grid says of the optics and of the stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GridReport {
    /// The map of the optics, by the pitch: metres are true ones, and not the stage's. Its axes are those of the stage.
    pub calibration: Calibration,
    /// The pitch that was told, um.
    pub pitch_um: f64,
    /// Size of a pixel along image x and y, um.
    pub um_per_px: [Known; 2],
    /// Direction of image x in the stage's axes, degrees from x towards y.
    pub image_x_deg: Known,
    /// The angle between image x and y on the specimen less a right one, degrees.
    pub skew_deg: Known,
    /// Whether no values of the paper's three describe the map: the image is mirrored against the stage.
    pub mirrored: bool,
    /// kx, ky and phi, where it is not.
    pub reading: Option<GridReading>,
    /// Radial distortion: how far the corner is moved out, relative.
    pub distortion: Term,
    /// How much smaller the scale is at the corner than in the middle, along image x and y, relative: a tilted field.
    pub keystone: [Term; 2],
    /// Where the image's centre lies from the axis of rotation, um.
    pub rotation_centre_um: Option<[Known; 2]>,
    /// The stage.
    pub stage: StageSeen,
    /// Cells of the grid used in the first view, and those that were left out.
    pub nodes: usize,
    /// Covered, missing, or elsewhere than all others.
    pub left_out: usize,
    /// Standard deviation of a cell's place, per coordinate, px.
    pub sigma_px: f64,
    /// Views in which the grid was followed, the first included.
    pub views: usize,
}

impl GridReport {
    /// The objective.
    pub fn objective(&self) -> &ObjectiveId {
        &self.calibration.objective
    }
}

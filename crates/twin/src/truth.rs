//! What only the simulator knows.

use crate::affine::Affine;
use crate::optics::{View, principal_point};
use crate::stage_config::StageConfig;
use scopeservo_scope::{ObjectiveId, StagePose};
use serde::{Deserialize, Serialize};

/// Where the microscope really looked. For judging results; never for finding them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// The frame that this belongs to; `None` for a moment without a frame.
    pub sequence: Option<u64>,
    /// The active objective, or the next one while the nosepiece turns.
    pub objective: String,
    /// The stage's true pose, not the reported one.
    pub stage: StagePose,
    /// Specimen coordinates (um) of a pixel (x, y): row i gives `m[i][0] x + m[i][1] y + m[i][2]`. Integer pixel
    /// coordinates are pixel centres.
    pub specimen_from_pixel: [[f64; 3]; 2],
    /// The specimen point under the middle of the image, um.
    pub centre_um: [f64; 2],
    /// Direction of the image's rightward axis on the specimen, degrees from +x towards +y, in (-180, 180].
    pub angle_deg: f64,
    /// Size of a pixel on the specimen: the square root of its area, um.
    pub um_per_px: f64,
    /// Defocus in the middle of the image, um. Positive: objective and specimen are too close.
    pub defocus_um: f64,
    /// Change of the defocus from a pixel to the next one on the right and below, um: specimen and stage tilted against each other. Logs of
    /// earlier versions do not tell.
    #[serde(default)]
    pub defocus_slope_um_per_px: [f64; 2],
}

impl Truth {
    /// Specimen coordinates (um) of a pixel.
    pub fn specimen(&self, pixel: [f64; 2]) -> [f64; 2] {
        Affine(self.specimen_from_pixel).apply(pixel)
    }

    pub(crate) fn new(
        view: &View,
        sequence: Option<u64>,
        objective: &ObjectiveId,
        stage: &StageConfig,
        size: [usize; 2],
    ) -> Self {
        let m = view.specimen_from_pixel.0;
        let mut pose = StagePose::default();
        for axis in &stage.axes {
            pose = pose.with_si(axis.axis, view.stage[crate::stage::index(axis.axis)]);
        }
        Self {
            sequence,
            objective: objective.0.clone(),
            stage: pose,
            specimen_from_pixel: m,
            centre_um: view
                .specimen_from_pixel
                .apply(principal_point(size[0], size[1])),
            angle_deg: m[1][0].atan2(m[0][0]).to_degrees(),
            um_per_px: view.um_per_px(),
            defocus_um: view.defocus_um,
            defocus_slope_um_per_px: view.slope_um,
        }
    }
}

/// The true calibration of one objective, in the paper's letters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrueCalibration {
    /// Horizontal scale, px per metre; of the other sign when the image is mirrored.
    pub kx: f64,
    /// Vertical scale, px per metre.
    pub ky: f64,
    /// Rotation phi of the camera, degrees.
    pub phi_deg: f64,
    /// Place eta of the camera in the end-effector frame, mm, with the objective's own parcentric offset.
    pub eta_mm: [f64; 2],
}

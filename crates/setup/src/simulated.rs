//! The simulated microscope, as a file or a command line describes it.

use crate::SetupError;
use scopeservo_scope::{Clock, Immersion};
use scopeservo_twin::{
    CameraConfig, Config as Make, FileSpecimen, MadeSpecimen, Specimen, StageConfig, Tissue, Twin,
    TwinError,
};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// No slide is larger, um.
const FARTHEST_UM: f64 = 1e5;
/// No slide lies at a steeper angle.
const STEEPEST_MRAD: f64 = 50.0;

/// The simulated microscope.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwinConfig {
    /// Of everything that is drawn.
    #[serde(default = "one")]
    pub seed: u64,
    /// A slide image; procedural tissue without.
    pub specimen: Option<PathBuf>,
    /// A specimen made up as described: tissue, single cells, a lattice, a piece that is there twice, blank glass.
    pub made: Option<MadeSpecimen>,
    /// Size of a pixel of the slide image, where it does not state it.
    pub um_per_px: Option<f64>,
    /// What lies under the view's centre at the start, um on the specimen.
    #[serde(default)]
    pub centre_um: [f64; 2],
    /// How far the specimen is turned.
    #[serde(default)]
    pub turned_deg: f64,
    /// How the slide is tilted, um of height per mm along x and y; as slides usually lie without.
    pub tilt_mrad: Option<[f64; 2]>,
    /// Which stage it has.
    #[serde(default)]
    pub stage: TwinStage,
    /// Which objectives it has; all three without.
    pub objectives: Option<Vec<String>>,
    /// Whether the camera mirrors.
    #[serde(default)]
    pub mirrored: bool,
    /// Radial distortion of objectives by their names: how far the corner of the image is moved out, relative (0.002 is 0.2 %). None without.
    #[serde(default)]
    pub distortion: BTreeMap<String, f64>,
    /// What objectives work in, by their names; air without.
    #[serde(default)]
    pub immersion: BTreeMap<String, Immersion>,
    /// Its camera, with its noise, its dust and what it writes into the image; the usual one without.
    #[serde(default)]
    pub camera: CameraConfig,
    /// Whether motion takes as long as it would; otherwise a minute passes in a second.
    #[serde(default)]
    pub real_time: bool,
}

/// The stages of the simulated microscope.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TwinStage {
    /// Six axes; it carries the microscope.
    #[default]
    Hexapod,
    /// x, y, focus and a turning plate on top; they carry the specimen.
    XyzTheta,
    /// x, y and focus.
    Xyz,
    /// x and y: somebody focuses by hand.
    Xy,
}

fn one() -> u64 {
    1
}

impl Default for TwinConfig {
    fn default() -> Self {
        Self {
            seed: one(),
            specimen: None,
            made: None,
            um_per_px: None,
            centre_um: [0.0; 2],
            turned_deg: 0.0,
            tilt_mrad: None,
            stage: TwinStage::default(),
            objectives: None,
            mirrored: false,
            distortion: BTreeMap::new(),
            immersion: BTreeMap::new(),
            camera: CameraConfig::default(),
            real_time: false,
        }
    }
}

impl TwinConfig {
    /// Builds it on a clock. `resolve` finds the slide image.
    ///
    /// # Errors
    /// [`SetupError::Twin`] with the setting that makes no sense, [`SetupError::Specimen`] for a slide image that does not read.
    pub fn build(
        &self,
        resolve: impl Fn(&Path) -> PathBuf,
        clock: Arc<dyn Clock>,
    ) -> Result<Twin, SetupError> {
        let specimen: Arc<dyn Specimen> = match (&self.specimen, &self.made) {
            (Some(_), Some(_)) => {
                return Err(bad("give the twin a specimen or made, not both".into()));
            }
            (Some(path), None) => Arc::new(FileSpecimen::open(&resolve(path), self.um_per_px)?),
            (None, Some(made)) => made.make()?,
            (None, None) => Arc::new(Tissue::new(self.seed)),
        };
        let mut make = Make::realistic().with_stage(match self.stage {
            TwinStage::Hexapod => StageConfig::hexapod(),
            TwinStage::XyzTheta => StageConfig::xyz_theta(),
            TwinStage::Xyz => StageConfig::xyz(),
            TwinStage::Xy => StageConfig::xy(),
        });
        make.mount.mirrored = self.mirrored;
        make.camera = self.camera.clone();
        if let Some(tilt) = self.tilt_mrad {
            if !tilt.iter().all(|v| v.abs() <= STEEPEST_MRAD) {
                let what = format!("tilt_mrad must be from -{STEEPEST_MRAD} to {STEEPEST_MRAD}");
                return Err(bad(what));
            }
            make.slide.tilt_mrad = tilt;
        }
        let known: Vec<String> = make.optics.iter().map(|o| o.id.0.clone()).collect();
        let named = self.objectives.iter().flatten();
        if let Some(id) = named
            .chain(self.distortion.keys())
            .chain(self.immersion.keys())
            .find(|id| !known.contains(id))
        {
            let known = known.join(", ");
            return Err(bad(format!(
                "the twin has no objective {id}; it has {known}"
            )));
        }
        for optics in &mut make.optics {
            let (id, distortion) = (&optics.id.0, &self.distortion);
            optics.distortion = distortion.get(id).copied().unwrap_or_default();
            optics.immersion = self.immersion.get(id).copied().unwrap_or_default();
        }
        if let Some(wanted) = &self.objectives {
            make.optics.retain(|o| wanted.contains(&o.id.0));
        }
        let within = |value: f64, most: f64| value.abs() <= most;
        if !self.centre_um.iter().all(|&v| within(v, FARTHEST_UM)) {
            return Err(bad(format!(
                "centre_um must be within {FARTHEST_UM} um: no slide is larger"
            )));
        }
        if !within(self.turned_deg, 360.0) {
            return Err(bad("turned_deg must be from -360 to 360".into()));
        }
        let twin = Twin::new(make, specimen, self.seed, clock)?;
        twin.centre_specimen(self.centre_um, self.turned_deg);
        Ok(twin)
    }
}

fn bad(what: String) -> SetupError {
    TwinError::BadConfig { what }.into()
}

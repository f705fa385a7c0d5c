//! The file. Every key has its unit in its name; unknown keys are errors.

use crate::SetupError;
use crate::simulated::TwinConfig;
use crate::spelled::line_of;
use scopeservo_drivers::factory::Described;
use scopeservo_scope::{Immersion, Workspace};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A whole description of an instrument.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// For people.
    pub name: String,
    /// The drivers, by names of the user's.
    pub drivers: BTreeMap<String, DriverConfig>,
    /// Which driver speaks for which device.
    pub devices: DevicesConfig,
    /// Objectives: of a nosepiece by hand, or the one there is. A driver's nosepiece brings its own.
    #[serde(default, rename = "objective")]
    pub objectives: Vec<ObjectiveConfig>,
    /// Narrower than the stage's travel.
    #[serde(default)]
    pub limits: AxesConfig<[f64; 2]>,
    /// The same for single objectives.
    #[serde(default)]
    pub limits_for: BTreeMap<String, AxesConfig<[f64; 2]>>,
    /// The longest single moves.
    #[serde(default)]
    pub largest_step: AxesConfig<f64>,
    /// How the axes share their travel.
    #[serde(default)]
    pub workspace: Workspace,
    /// Where objectives must stay away.
    #[serde(default, rename = "zone")]
    pub zones: Vec<ZoneConfig>,
    /// When the nosepiece may turn.
    pub objective_change: Option<ChangeConfig>,
    /// Settings of the camera.
    #[serde(default)]
    pub camera: CameraConfig,
    /// Settings of the light.
    #[serde(default)]
    pub light: LightConfig,
    /// How targets are saved.
    #[serde(default)]
    pub target: TargetConfig,
    /// What is asked of an arrival.
    #[serde(default)]
    pub arrival: ArrivalConfig,
    /// How the focus is looked for.
    #[serde(default)]
    pub focus: FocusConfig,
    /// Where calibrations and targets are kept, from the folder of this file on.
    #[serde(default = "data_folder")]
    pub data_folder: PathBuf,
    /// What is kept for how long.
    #[serde(default)]
    pub library: LibraryConfig,
    /// The file itself.
    #[serde(skip)]
    pub path: PathBuf,
    /// What it says, for the lines of what cannot be.
    #[serde(skip)]
    pub(crate) text: String,
}

fn data_folder() -> PathBuf {
    "scopeservo-data".into()
}

/// What is kept for how long.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LibraryConfig {
    /// So much the frames and reports of runs take, 10^9 bytes; those of the oldest go first.
    pub frames_gb: f64,
}

impl Default for LibraryConfig {
    fn default() -> Self {
        Self { frames_gb: 20.0 }
    }
}

/// How a driver is found: exactly one of the keys, but that a secret belongs to `tcp`.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriverConfig {
    /// A program and its arguments, to be started. One with a `/` in its name is looked for from the folder of this file on.
    pub program: Option<Vec<String>>,
    /// Address and port of one that runs.
    pub tcp: Option<String>,
    /// A file with the secret for it.
    pub secret_file: Option<PathBuf>,
    /// The simulated microscope.
    pub twin: Option<TwinConfig>,
    /// Any other, by its factory.
    #[serde(skip)]
    pub(crate) own: Vec<Arc<dyn Described>>,
}

/// The name of a driver.
pub type DeviceName = String;

/// Which driver speaks for which device.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DevicesConfig {
    /// The stage.
    pub stage: DeviceName,
    /// The camera.
    pub camera: DeviceName,
    /// The nosepiece: a driver's name, `by-hand` (the program asks and waits) or `none` (there is one objective).
    pub nosepiece: DeviceName,
    /// The light, if it is to be set.
    pub light: Option<DeviceName>,
}

/// An objective.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectiveConfig {
    /// Its name.
    pub id: String,
    /// Total magnification; orders the objectives.
    pub magnification: f64,
    /// Numerical aperture.
    pub numerical_aperture: f64,
    /// Nominal size of a camera pixel on the specimen.
    pub um_per_px: f64,
    /// What it works in; air when left out.
    #[serde(default)]
    pub immersion: Immersion,
}

/// One value per axis.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxesConfig<T> {
    /// Along x.
    pub x_um: Option<T>,
    /// Along y.
    pub y_um: Option<T>,
    /// Focus.
    pub z_um: Option<T>,
    /// About x.
    pub rx_deg: Option<T>,
    /// About y.
    pub ry_deg: Option<T>,
    /// About z.
    pub rz_deg: Option<T>,
}

/// A part of the x-y plane in which objectives must stay farther away.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ZoneConfig {
    /// What is there.
    pub name: String,
    /// From where to where.
    pub x_um: [f64; 2],
    /// From where to where.
    pub y_um: [f64; 2],
    /// The height nearest to the specimen that is allowed there.
    pub closest_z_um: f64,
    /// Which objectives; all when left out.
    #[serde(default)]
    pub objectives: Vec<String>,
}

/// When the nosepiece may turn: exactly one of `retract_z_um` and `anywhere`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChangeConfig {
    /// Only from this height on, away from the specimen.
    pub retract_z_um: Option<f64>,
    /// How far from the expected focus an objective stops whose focus was never found.
    pub margin_um: Option<f64>,
    /// At any height.
    pub anywhere: Option<bool>,
}

/// Settings of the camera.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Set when the instrument is opened.
    pub exposure_ms: Option<f64>,
}

/// Settings of the light.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightConfig {
    /// 0 to 1, set when the instrument is opened.
    pub level: Option<f64>,
}

/// How targets are saved.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TargetConfig {
    /// Nothing moves for it: no step aside shows what is fixed to the camera, and each run must prove it.
    #[serde(default)]
    pub still: bool,
}

/// What is asked of an arrival: it is claimed only within this for sure.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArrivalConfig {
    /// Distance of the view's middle from the target's. 0.8 pixels, or as near as the stage can, when left out.
    pub within_um: Option<f64>,
    /// Angle, also of what a stage cannot turn. 0.01 deg when left out; of a stage that cannot turn, while the middle half of the target is in view.
    pub within_deg: Option<f64>,
}

/// How the focus is looked for.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FocusConfig {
    /// The coarse scan is one slow motion, where that is expected to save time and the stage's speed can be chosen.
    #[serde(default)]
    pub sweep: bool,
}

impl Config {
    /// A path in the file, from the folder of the file on.
    pub fn resolve(&self, path: &Path) -> PathBuf {
        self.path.parent().unwrap_or(Path::new("")).join(path)
    }

    /// What the description says at `keys` and cannot be: the sentence begins with the file and the line.
    pub(crate) fn senseless(&self, keys: &[&str], what: impl Into<String>) -> SetupError {
        SetupError::Invalid {
            path: self.path.clone(),
            line: line_of(&self.text, keys),
            what: what.into(),
        }
    }
}

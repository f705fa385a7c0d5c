//! The file. Every key has its unit in its name; unknown keys are errors.

use crate::SetupError;
use crate::check::{check, guess};
use crate::simulated::TwinConfig;
use crate::spelled::{ESCAPES, is_escape, line_of, spelled};
use crate::tables::{self, Unreadable};
use crate::template::schema_with;
use scopeservo_drivers::factory::{Described, FACTORIES, Factory};
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
    /// Where calibrations and targets are kept, from the folder of this file on.
    #[serde(default = "data_folder")]
    pub data_folder: PathBuf,
    /// The file itself.
    #[serde(skip)]
    pub path: PathBuf,
    /// What it says, for the lines of what cannot be.
    #[serde(skip)]
    text: String,
}

fn data_folder() -> PathBuf {
    "scopeservo-data".into()
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

impl Config {
    /// Reads a file.
    ///
    /// # Errors
    /// [`SetupError::Read`], [`SetupError::Parse`] with line and column, [`SetupError::Invalid`].
    pub fn read(path: &Path) -> Result<Self, SetupError> {
        let read = scopeservo_files::read_text(path, scopeservo_files::MAX_CONFIG_BYTES);
        let text = read.map_err(|source| SetupError::Read {
            path: path.into(),
            source,
        })?;
        Self::parse(&text, path)
    }

    /// Understands a text as if it were that file.
    ///
    /// # Errors
    /// As [`Config::read`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, SetupError> {
        Self::parse_with(text, path, FACTORIES)
    }

    /// The same with other drivers than ours.
    ///
    /// # Errors
    /// As [`Config::read`].
    pub fn parse_with(text: &str, path: &Path, known: &[Factory]) -> Result<Self, SetupError> {
        let unreadable = |error: Unreadable| {
            let at = error.span.clone().map_or(0, |s| s.start).min(text.len());
            let before = text.as_bytes()[..at].iter();
            let line = before.clone().filter(|&&b| b == b'\n').count() + 1;
            let column = before.rev().take_while(|&&b| b != b'\n').count() + 1;
            let hint = match is_escape(text, at) {
                true => ESCAPES,
                false => "",
            };
            SetupError::Parse {
                path: path.into(),
                line,
                column,
                what: format!("{}{hint}", with_guess(&error.message)),
            }
        };
        let (mut config, found): (Self, _) = tables::read(text, known).map_err(unreadable)?;
        spelled(text, &schema_with(known)).map_err(unreadable)?;
        for (name, own) in found {
            if let Some(driver) = config.drivers.get_mut(&name) {
                driver.own = own;
            }
        }
        config.path = path.into();
        config.text = text.into();
        check(&config, known)?;
        Ok(config)
    }

    /// What is read otherwise than it was written, in any text: lists with more values than are read, and paths with escapes.
    ///
    /// # Errors
    /// The sentence that [`Config::parse`] would say.
    #[doc(hidden)]
    pub fn is_spelled_as_meant(text: &str) -> Result<(), String> {
        spelled(text, &schema_with(FACTORIES)).map_err(|error| error.message)
    }

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

/// `unknown field ..., expected one of ...` with the nearest of them.
fn with_guess(message: &str) -> String {
    let message = message.trim_end();
    let mut quoted = message.split('`').skip(1).step_by(2);
    match (message.starts_with("unknown "), quoted.next()) {
        (true, Some(wrong)) => {
            let known: Vec<&str> = quoted.collect();
            let what = message.split('`').next().unwrap_or("unknown key").trim();
            let what = what.replace("field", "key").replace("variant", "value");
            match guess(wrong, known.iter().copied()) {
                Some(right) => format!("{what} '{wrong}'; did you mean '{right}'?"),
                None => format!("{what} '{wrong}'; there are {}", known.join(", ")),
            }
        }
        _ => message.replace('\n', " "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{TEMPLATE, TWIN_TEMPLATE};

    fn parse(text: &str) -> Result<Config, SetupError> {
        Config::parse(text, Path::new("lab/scopeservo.toml"))
    }

    fn said(text: &str) -> String {
        parse(text).expect_err(text).to_string()
    }

    #[test]
    fn the_templates_are_valid() {
        let config = parse(TEMPLATE).unwrap();
        assert_eq!(config.devices.stage, "main");
        assert_eq!(
            config.resolve(&config.data_folder),
            Path::new("lab/scopeservo-data")
        );
        parse(TWIN_TEMPLATE).unwrap();
    }

    #[test]
    fn an_objective_works_in_air_unless_it_says_otherwise() {
        let objectives = "[[objective]]\nid = \"10x\"\nmagnification = 100\nnumerical_aperture = 0.25\num_per_px = 1.1\n\
             [[objective]]\nid = \"100x\"\nmagnification = 1000\nnumerical_aperture = 1.25\num_per_px = 0.1\nimmersion = \"oil\"\n";
        let by_hand = TWIN_TEMPLATE.replace("nosepiece = \"twin\"", "nosepiece = \"by-hand\"");
        let config = parse(&format!("{by_hand}\n{objectives}")).unwrap();
        let media: Vec<Immersion> = config.objectives.iter().map(|o| o.immersion).collect();
        assert_eq!(media, [Immersion::Air, Immersion::Oil]);
        let odd = format!("{by_hand}\n{}", objectives.replace("\"oil\"", "\"oill\""));
        let line = odd.lines().position(|l| l.contains("oill")).unwrap() + 1;
        let said = said(&odd);
        assert!(
            said.starts_with(&format!("lab/scopeservo.toml:{line}:"))
                && said.contains("did you mean 'oil'?"),
            "{said}"
        );
    }

    #[test]
    fn mistakes_are_named_with_their_place_and_a_guess() {
        let wrong = |from: &str, to: &str| said(&TWIN_TEMPLATE.replace(from, to));
        let key = wrong("retract_z_um", "retract_z");
        assert!(
            key.contains("unknown key 'retract_z'; did you mean 'retract_z_um'?"),
            "{key}"
        );
        let line = TWIN_TEMPLATE[..TWIN_TEMPLATE.find("retract_z_um").unwrap()]
            .lines()
            .count()
            + 1;
        assert!(
            key.starts_with(&format!("lab/scopeservo.toml:{line}:1: ")),
            "{key}"
        );
        let unit = wrong("x_um = ", "x_mm = ");
        assert!(unit.contains("did you mean 'x_um'?"), "{unit}");
        let odd = wrong("[limits]", "[quux]");
        assert!(
            odd.contains("unknown key 'quux'; there are name, drivers"),
            "{odd}"
        );
        let missing = wrong("camera = \"twin\"", "");
        assert!(missing.contains("missing field `camera`"), "{missing}");
        let kind = wrong("x_um = [", "x_um = [\"far\", ");
        assert!(kind.contains("invalid type"), "{kind}");
        let broken = wrong("[limits]", "[limits");
        assert!(broken.starts_with("lab/scopeservo.toml:"), "{broken}");
        let driver = wrong("camera = \"twin\"", "camera = \"twim\"");
        assert!(
            driver.contains("devices.camera is 'twim'") && driver.contains("did you mean 'twin'?"),
            "{driver}"
        );
        let both = wrong("retract_z_um", "anywhere = true\nretract_z_um");
        assert!(both.contains("exactly one of"), "{both}");
        let asked = said(&format!("{TWIN_TEMPLATE}\n[arrival]\nwithin_deg = 0\n"));
        assert!(
            asked.contains("arrival.within_deg is 0: it must be above 0"),
            "{asked}"
        );
        let margin = wrong("margin_um = 0", "");
        assert!(
            margin.contains("margin_um belongs to retract_z_um"),
            "{margin}"
        );
        let kinds = wrong(
            "[drivers.twin.twin]",
            "[drivers.twin]\ntcp = \"localhost:1\"\n[drivers.twin.twin]",
        );
        assert!(
            kinds.contains("exactly one of program, tcp, twin"),
            "{kinds}"
        );
        let none = wrong("nosepiece = \"twin\"", "nosepiece = \"none\"");
        assert!(none.contains("exactly one objective"), "{none}");
        assert!(said("").contains("missing field `name`"));
    }
}

//! How a driver is found in a description of an instrument: each maker has a [`Factory`], and [`FACTORIES`] lists them. Whoever opens an
//! instrument asks the list and knows no maker.

use crate::camera::http::Login;
use crate::link::{Tcp, Transport};
use crate::{camera, gcode, gcs2, sangaboard};
use scopeservo_scope::{Camera, Clock, Devices, Nosepiece, ScopeError, Stage};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// The drivers of this crate.
pub const FACTORIES: &[Factory] = &[
    gcs2::FACTORY,
    gcode::FACTORY,
    sangaboard::FACTORY,
    camera::MJPEG,
    camera::SNAPSHOT,
    camera::FOLDER,
    camera::V4L,
];

/// What a maker adds to a description of an instrument.
#[derive(Debug, Clone, Copy)]
pub struct Factory {
    /// The key of its table: `[drivers.NAME.KIND]`.
    pub kind: &'static str,
    /// A JSON schema of that table, for editors.
    pub schema: &'static str,
    /// Reads that table.
    pub read: fn(Table<'_>) -> Result<Arc<dyn Described>, toml::de::Error>,
}

/// The table of a driver in a description.
pub struct Table<'a>(toml::de::ValueDeserializer<'a>);

impl<'a> Table<'a> {
    /// Of a value in a description.
    pub fn new(value: toml::de::ValueDeserializer<'a>) -> Self {
        Self(value)
    }

    /// What the table describes.
    ///
    /// # Errors
    /// What cannot be read, with its place in the text.
    pub fn read<T: Described + DeserializeOwned + 'static>(
        self,
    ) -> Result<Arc<dyn Described>, toml::de::Error> {
        T::deserialize(self.0).map(|it| Arc::new(it) as Arc<dyn Described>)
    }
}

/// A driver as a description has it: nothing is connected yet.
pub trait Described: fmt::Debug + Send + Sync {
    /// What is wrong with it, though each value by itself can be read.
    ///
    /// # Errors
    /// What, in words for people.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }

    /// Where the device is, if it can move something, so that no other program may drive it meanwhile.
    fn place(&self) -> Option<Place<'_>> {
        None
    }

    /// Finds the device. Nothing moves.
    ///
    /// # Errors
    /// [`ConnectError`].
    fn connect(&self, around: &Around<'_>) -> Result<Connected, ConnectError>;
}

/// Where a device is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place<'a> {
    /// Address and port.
    Tcp(&'a str),
    /// A serial port.
    Serial(&'a str),
}

/// What a driver needs to be connected, besides what is said of itself.
pub struct Around<'a> {
    /// A path in the description as one of this machine.
    pub resolve: &'a dyn Fn(&Path) -> PathBuf,
    /// The clock of the instrument.
    pub clock: &'a Arc<dyn Clock>,
}

/// A driver that was found.
pub struct Connected {
    /// The name it gives itself.
    pub name: String,
    /// The devices that it speaks for.
    pub devices: Devices,
}

impl Connected {
    /// A controller with a stage, a nosepiece, or both.
    pub fn stage<T: Stage + 'static>(
        stage: Arc<T>,
        nosepiece: Option<Box<dyn Nosepiece>>,
        around: &Around<'_>,
    ) -> Self {
        // A board may drive a nosepiece and nothing else.
        let is_stage = !stage.info().axes.is_empty();
        Self {
            name: stage.info().name.clone(),
            devices: Devices {
                stage: is_stage.then(|| Box::new(stage) as Box<dyn Stage>),
                nosepiece,
                ..Devices::none(around.clock.clone())
            },
        }
    }

    /// A camera.
    pub fn camera(camera: impl Camera + 'static, around: &Around<'_>) -> Self {
        Self {
            name: camera.info().name.clone(),
            devices: Devices {
                camera: Some(Box::new(camera)),
                ..Devices::none(around.clock.clone())
            },
        }
    }
}

/// Why a driver is not there.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ConnectError {
    /// A device refused or failed.
    #[error(transparent)]
    Scope(#[from] ScopeError),
    /// What the description says leads nowhere.
    #[error("{0}")]
    Description(String),
    /// A file that nobody else should read cannot be used.
    #[error("the secret in {path} cannot be used: {what}")]
    Secret {
        /// The file.
        path: PathBuf,
        /// Why.
        what: String,
    },
}

/// A file that nobody else should read, and where it is.
///
/// # Errors
/// [`ConnectError::Secret`].
pub fn read_secret(
    resolve: &dyn Fn(&Path) -> PathBuf,
    file: &Path,
) -> Result<(PathBuf, Vec<u8>), ConnectError> {
    let path = resolve(file);
    match std::fs::read(&path) {
        Ok(bytes) => Ok((path, bytes)),
        Err(error) => Err(ConnectError::Secret {
            path,
            what: error.to_string(),
        }),
    }
}

/// How long a connection may take to be made.
const CONNECT: Duration = Duration::from_secs(5);

/// A device on a line: where it is, exactly one of `tcp` and `serial`, and how it is set up.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wired<T> {
    /// Address and port.
    pub tcp: Option<String>,
    /// A serial port.
    pub serial: Option<String>,
    /// Its speed, bits per second.
    #[serde(default = "baud")]
    pub baud: u32,
    /// How the device is set up.
    pub settings: T,
}

fn baud() -> u32 {
    115_200
}

impl<T> Wired<T> {
    pub(crate) fn has_one_place(&self) -> Result<(), String> {
        match self.tcp.is_some() != self.serial.is_some() {
            true => Ok(()),
            false => Err("it must say where the device is: exactly one of tcp and serial".into()),
        }
    }

    pub(crate) fn at(&self) -> Option<Place<'_>> {
        let tcp = self.tcp.as_deref().map(Place::Tcp);
        tcp.or(self.serial.as_deref().map(Place::Serial))
    }

    pub(crate) fn open(&self) -> Result<Box<dyn Transport>, ConnectError> {
        match self.at() {
            Some(Place::Tcp(address)) => match Tcp::connect(address, CONNECT) {
                Ok(tcp) => Ok(Box::new(tcp)),
                Err(error) => Err(ConnectError::Description(format!(
                    "no device answers at {address}: {error}"
                ))),
            },
            Some(Place::Serial(port)) => serial(port, self.baud),
            None => Err(ConnectError::Description(
                "a driver has neither tcp nor serial".into(),
            )),
        }
    }
}

#[cfg(feature = "serial")]
fn serial(port: &str, baud: u32) -> Result<Box<dyn Transport>, ConnectError> {
    match crate::link::Serial::open(port, baud) {
        Ok(serial) => Ok(Box::new(serial)),
        Err(error) => Err(ConnectError::Description(format!(
            "the port {port} cannot be opened: {error}"
        ))),
    }
}

#[cfg(not(feature = "serial"))]
fn serial(port: &str, _: u32) -> Result<Box<dyn Transport>, ConnectError> {
    Err(ConnectError::Description(format!(
        "the port {port} needs a build with serial ports: cargo build --release --features serial"
    )))
}

/// A camera on the web, and who may see its pictures.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OnTheWeb<T> {
    /// Where it wants to know who asks.
    pub user: Option<String>,
    /// A file with the password.
    pub password_file: Option<PathBuf>,
    /// How the camera is set up.
    pub settings: T,
}

impl<T> OnTheWeb<T> {
    pub(crate) fn has_whole_login(&self) -> Result<(), String> {
        match self.user.is_some() == self.password_file.is_some() {
            true => Ok(()),
            false => Err("user and password_file belong together".into()),
        }
    }

    pub(crate) fn login(&self, around: &Around<'_>) -> Result<Option<Login>, ConnectError> {
        let (Some(user), Some(file)) = (&self.user, &self.password_file) else {
            return Ok(None);
        };
        let (path, bytes) = read_secret(around.resolve, file)?;
        let password = String::from_utf8(bytes).map_err(|_| ConnectError::Secret {
            path,
            what: "it is not text".into(),
        })?;
        Ok(Some(Login {
            user: user.clone(),
            // Editors end a file with a line end.
            password: password.trim_end_matches(['\r', '\n']).to_string(),
        }))
    }
}

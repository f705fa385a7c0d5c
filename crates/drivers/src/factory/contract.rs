//! What a maker adds to a description of an instrument, and what is made of it.

use scopeservo_scope::{Camera, Clock, Devices, Nosepiece, ScopeError, Stage};
use serde::de::DeserializeOwned;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use thiserror::Error;

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

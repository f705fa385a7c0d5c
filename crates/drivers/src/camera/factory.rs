//! How the cameras are found in a description of an instrument.

use crate::camera::{
    FolderCamera, FolderSettings, MjpegSettings, SnapshotCamera, SnapshotSettings, V4lSettings,
    mjpeg_camera,
};
use crate::factory::{Around, ConnectError, Connected, Described, Factory, OnTheWeb};

/// `[drivers.NAME.mjpeg]`
pub const MJPEG: Factory = Factory {
    kind: "mjpeg",
    schema: include_str!("mjpeg.schema.json"),
    read: |table| table.read::<OnTheWeb<MjpegSettings>>(),
};

/// `[drivers.NAME.snapshot]`
pub const SNAPSHOT: Factory = Factory {
    kind: "snapshot",
    schema: include_str!("snapshot.schema.json"),
    read: |table| table.read::<OnTheWeb<SnapshotSettings>>(),
};

/// `[drivers.NAME.folder]`
pub const FOLDER: Factory = Factory {
    kind: "folder",
    schema: include_str!("folder.schema.json"),
    read: |table| table.read::<FolderSettings>(),
};

/// `[drivers.NAME.v4l]`
pub const V4L: Factory = Factory {
    kind: "v4l",
    schema: include_str!("v4l.schema.json"),
    read: |table| table.read::<V4lSettings>(),
};

impl Described for OnTheWeb<MjpegSettings> {
    fn check(&self) -> Result<(), String> {
        self.has_whole_login()
    }

    fn connect(&self, around: &Around<'_>) -> Result<Connected, ConnectError> {
        let login = self.login(around)?;
        let camera = mjpeg_camera(&self.settings, login, around.clock.clone())?;
        Ok(Connected::camera(camera, around))
    }
}

impl Described for OnTheWeb<SnapshotSettings> {
    fn check(&self) -> Result<(), String> {
        self.has_whole_login()
    }

    fn connect(&self, around: &Around<'_>) -> Result<Connected, ConnectError> {
        let login = self.login(around)?;
        let camera = SnapshotCamera::connect(&self.settings, login, around.clock.clone())?;
        Ok(Connected::camera(camera, around))
    }
}

impl Described for FolderSettings {
    fn connect(&self, around: &Around<'_>) -> Result<Connected, ConnectError> {
        let path = (around.resolve)(&self.path);
        let camera = FolderCamera::open(self, path, around.clock.clone())?;
        Ok(Connected::camera(camera, around))
    }
}

impl Described for V4lSettings {
    #[cfg(all(feature = "v4l", target_os = "linux"))]
    fn connect(&self, around: &Around<'_>) -> Result<Connected, ConnectError> {
        let camera = crate::camera::v4l_camera(self, around.clock.clone())?;
        Ok(Connected::camera(camera, around))
    }

    #[cfg(not(all(feature = "v4l", target_os = "linux")))]
    fn connect(&self, _: &Around<'_>) -> Result<Connected, ConnectError> {
        Err(ConnectError::Description(format!(
            "the video device {} needs a build for Linux with video devices: cargo build --release --features v4l",
            self.device.display()
        )))
    }
}

//! Our own drivers, found and put in line with the others.

use crate::SetupError;
use crate::config::{Config, DriverConfig, OwnConfig, WebConfig};
use crate::open::{Found, read_secret};
use scopeservo_drivers::camera::http::Login;
use scopeservo_drivers::camera::{FolderCamera, SnapshotCamera, V4lSettings, mjpeg_camera};
use scopeservo_drivers::gcode::GcodeStage;
use scopeservo_drivers::gcs2::Gcs2Stage;
use scopeservo_drivers::link::{Tcp, Transport};
use scopeservo_drivers::sangaboard::SangaStage;
use scopeservo_drivers::turret::Turret;
use scopeservo_scope::{Camera, Clock, Devices, Nosepiece, Stage};
use std::sync::Arc;
use std::time::Duration;

const CONNECT: Duration = Duration::from_secs(5);

/// The driver of ours that is described, if one is.
pub(crate) fn find(
    config: &Config,
    driver: &DriverConfig,
    clock: &Arc<dyn Clock>,
) -> Result<Option<Found>, SetupError> {
    if let Some(own) = &driver.gcs2 {
        let stage = Gcs2Stage::connect(transport(config, own)?, &own.settings)?;
        let stage = Arc::new(stage);
        let nosepiece = stage.nosepiece();
        return Ok(Some(found(stage, nosepiece, clock)));
    }
    if let Some(own) = &driver.gcode {
        let stage = GcodeStage::connect(transport(config, own)?, &own.settings)?;
        let stage = Arc::new(stage);
        let nosepiece = stage.nosepiece();
        return Ok(Some(found(stage, nosepiece, clock)));
    }
    if let Some(own) = &driver.sangaboard {
        let stage = SangaStage::connect(transport(config, own)?, &own.settings)?;
        return Ok(Some(found(Arc::new(stage), None, clock)));
    }
    let clock = clock.clone();
    let on = clock.clone();
    let camera: Box<dyn Camera> = if let Some(web) = &driver.mjpeg {
        Box::new(mjpeg_camera(&web.settings, login(config, web)?, on)?)
    } else if let Some(web) = &driver.snapshot {
        let login = login(config, web)?;
        Box::new(SnapshotCamera::connect(&web.settings, login, on)?)
    } else if let Some(folder) = &driver.folder {
        let path = config.resolve(&folder.path);
        Box::new(FolderCamera::open(folder, path, on)?)
    } else if let Some(device) = &driver.v4l {
        video(config, device, on)?
    } else {
        return Ok(None);
    };
    Ok(Some(Found {
        name: camera.info().name.clone(),
        devices: Devices {
            camera: Some(camera),
            ..Devices::none(clock)
        },
        twin: None,
    }))
}

fn login<T>(config: &Config, web: &WebConfig<T>) -> Result<Option<Login>, SetupError> {
    let (Some(user), Some(file)) = (&web.user, &web.password_file) else {
        return Ok(None);
    };
    let (path, bytes) = read_secret(config, file)?;
    let password = String::from_utf8(bytes).map_err(|_| SetupError::Secret {
        path,
        what: "it is not text".into(),
    })?;
    Ok(Some(Login {
        user: user.clone(),
        // Editors end a file with a line end.
        password: password.trim_end_matches(['\r', '\n']).to_string(),
    }))
}

#[cfg(all(feature = "v4l", target_os = "linux"))]
fn video(
    _: &Config,
    device: &V4lSettings,
    clock: Arc<dyn Clock>,
) -> Result<Box<dyn Camera>, SetupError> {
    let camera = scopeservo_drivers::camera::v4l_camera(device, clock)?;
    Ok(Box::new(camera))
}

#[cfg(not(all(feature = "v4l", target_os = "linux")))]
fn video(
    config: &Config,
    device: &V4lSettings,
    _: Arc<dyn Clock>,
) -> Result<Box<dyn Camera>, SetupError> {
    Err(config.senseless(format!(
        "the video device {} needs a build for Linux with video devices: cargo build --release --features v4l",
        device.device.display()
    )))
}

fn transport<T>(config: &Config, own: &OwnConfig<T>) -> Result<Box<dyn Transport>, SetupError> {
    match (&own.tcp, &own.serial) {
        (Some(address), _) => {
            let tcp = Tcp::connect(address, CONNECT)
                .map_err(|e| config.senseless(format!("no device answers at {address}: {e}")))?;
            Ok(Box::new(tcp))
        }
        (None, Some(port)) => serial(config, port, own.baud),
        (None, None) => Err(config.senseless("a driver has neither tcp nor serial")),
    }
}

#[cfg(feature = "serial")]
fn serial(config: &Config, port: &str, baud: u32) -> Result<Box<dyn Transport>, SetupError> {
    let open = scopeservo_drivers::link::Serial::open(port, baud);
    let serial =
        open.map_err(|e| config.senseless(format!("the port {port} cannot be opened: {e}")))?;
    Ok(Box::new(serial))
}

#[cfg(not(feature = "serial"))]
fn serial(config: &Config, port: &str, _: u32) -> Result<Box<dyn Transport>, SetupError> {
    Err(config.senseless(format!(
        "the port {port} needs a build with serial ports: cargo build --release --features serial"
    )))
}

fn found<T: Stage + 'static>(
    stage: Arc<T>,
    nosepiece: Option<Turret>,
    clock: &Arc<dyn Clock>,
) -> Found {
    // A board may drive a nosepiece and nothing else.
    let is_stage = !stage.info().axes.is_empty();
    Found {
        name: stage.info().name.clone(),
        devices: Devices {
            stage: is_stage.then(|| Box::new(stage.clone()) as Box<dyn Stage>),
            nosepiece: nosepiece.map(|n| Box::new(n) as Box<dyn Nosepiece>),
            ..Devices::none(clock.clone())
        },
        twin: None,
    }
}

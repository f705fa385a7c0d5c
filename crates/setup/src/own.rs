//! Our own drivers, found and put in line with the others.

use crate::SetupError;
use crate::config::{Config, DriverConfig, OwnConfig};
use crate::open::{Found, Homing};
use scopeservo_drivers::gcode::GcodeStage;
use scopeservo_drivers::gcs2::Gcs2Stage;
use scopeservo_drivers::link::{Tcp, Transport};
use scopeservo_drivers::sangaboard::SangaStage;
use scopeservo_protocol::Devices;
use scopeservo_scope::{Motion, ScopeError, Stage, StageInfo, StagePose};
use std::sync::Arc;
use std::time::Duration;

const CONNECT: Duration = Duration::from_secs(5);

/// The driver of ours that is described, if one is.
pub(crate) fn find(config: &Config, driver: &DriverConfig) -> Result<Option<Found>, SetupError> {
    if let Some(own) = &driver.gcs2 {
        let stage = Gcs2Stage::connect(transport(config, own)?, &own.settings)?;
        return Ok(Some(found(stage, true)));
    }
    if let Some(own) = &driver.gcode {
        let stage = GcodeStage::connect(transport(config, own)?, &own.settings)?;
        return Ok(Some(found(stage, own.settings.needs_homing)));
    }
    if let Some(own) = &driver.sangaboard {
        let stage = SangaStage::connect(transport(config, own)?, &own.settings)?;
        return Ok(Some(found(stage, false)));
    }
    Ok(None)
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

fn found<T: Stage + Homing + 'static>(stage: T, homes: bool) -> Found {
    let kept = Kept(Arc::new(stage));
    Found {
        name: kept.info().name.clone(),
        devices: Devices {
            stage: Some(Box::new(Kept(kept.0.clone()))),
            camera: None,
            nosepiece: None,
            light: None,
        },
        homing: match homes {
            true => Some(Box::new(kept)),
            false => None,
        },
        twin: None,
    }
}

/// A stage that is kept for homing as well.
struct Kept<T>(Arc<T>);

impl<T: Stage> Stage for Kept<T> {
    fn info(&self) -> &StageInfo {
        self.0.info()
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        self.0.position()
    }
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.0.start_move(to)
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        self.0.poll()
    }
    fn stop(&self) -> Result<(), ScopeError> {
        self.0.stop()
    }
}

impl<T: Homing> Homing for Kept<T> {
    fn is_homed(&self) -> Result<bool, ScopeError> {
        self.0.is_homed()
    }
    fn start_homing(&self) -> Result<(), ScopeError> {
        self.0.start_homing()
    }
}

impl Homing for Gcs2Stage {
    fn is_homed(&self) -> Result<bool, ScopeError> {
        Gcs2Stage::is_homed(self)
    }
    fn start_homing(&self) -> Result<(), ScopeError> {
        self.home()
    }
}

impl Homing for GcodeStage {
    fn is_homed(&self) -> Result<bool, ScopeError> {
        GcodeStage::is_homed(self)
    }
    fn start_homing(&self) -> Result<(), ScopeError> {
        self.home()
    }
}

/// A Sangaboard has no end switches: its zero is where it was switched on, and this is never asked.
impl Homing for SangaStage {
    fn is_homed(&self) -> Result<bool, ScopeError> {
        Ok(true)
    }
    fn start_homing(&self) -> Result<(), ScopeError> {
        Err(ScopeError::Refused {
            device: "stage",
            detail: "this board has no reference to find".into(),
        })
    }
}

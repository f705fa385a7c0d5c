//! `scopeservo twin serve`: the simulated microscope for other programs.

use crate::args::TwinServeArgs;
use crate::driver_check::read_secret;
use crate::error::CliError;
use crate::patient_clock::PatientClock;
use scopeservo_protocol::{Offer, bind, listen, serve};
use scopeservo_scope::{Camera, CameraInfo, Clock, Devices, Frame, ScopeError, SystemClock};
use scopeservo_setup::{Config, TwinConfig};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// The camera of a microscope whose tissue grows while its devices are offered already: only a frame waits for that.
struct Growing {
    camera: Box<dyn Camera>,
    grows: Mutex<Option<JoinHandle<()>>>,
}

impl Growing {
    fn of(camera: Box<dyn Camera>, grow: impl FnOnce() + Send + 'static) -> Box<dyn Camera> {
        let grows = Mutex::new(Some(std::thread::spawn(grow)));
        Box::new(Self { camera, grows })
    }
}

impl Camera for Growing {
    fn info(&self) -> &CameraInfo {
        self.camera.info()
    }
    fn exposure(&self) -> Result<Duration, ScopeError> {
        self.camera.exposure()
    }
    fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError> {
        self.camera.set_exposure(exposure)
    }
    fn grab(&self) -> Result<Frame, ScopeError> {
        let mut grows = self.grows.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(grows) = grows.take() {
            // What went wrong there the frame comes upon by itself.
            let _ = grows.join();
        }
        drop(grows);
        self.camera.grab()
    }
}

pub(crate) fn run(args: &TwinServeArgs) -> Result<bool, CliError> {
    let clock: Arc<dyn Clock> = match args.idle_s {
        Some(idle) => Arc::new(PatientClock::new(args.speed, idle)),
        None => Arc::new(SystemClock::faster(args.speed)),
    };
    let twin = match &args.described_in {
        Some(path) => {
            let config = Config::read(path)?;
            let described = config.drivers.values().find_map(|d| d.twin.as_ref());
            let described = described.ok_or_else(|| {
                CliError::Usage(format!(
                    "{} describes no simulated microscope: give it a [drivers.NAME.twin]",
                    path.display()
                ))
            })?;
            described.build(|path| config.resolve(path), clock)?
        }
        None => {
            let told = TwinConfig {
                seed: args.seed,
                specimen: args.specimen.clone(),
                um_per_px: args.um_per_px,
                centre_um: args.centre_um,
                turned_deg: args.turned_deg,
                ..TwinConfig::default()
            };
            told.build(Path::to_path_buf, clock)?
        }
    };
    let looking = twin.clone();
    let devices = twin.devices();
    let offer = Offer {
        name: "simulated microscope".into(),
        devices: Devices {
            camera: devices
                .camera
                .map(|camera| Growing::of(camera, move || drop(looking.look()))),
            ..devices
        },
    };
    let Some(address) = &args.listen else {
        return serve(
            &offer,
            None,
            &mut std::io::stdin().lock(),
            std::io::stdout(),
        )
        .map(|()| true)
        .map_err(|e| CliError::Usage(format!("what came in is no request: {e}")));
    };
    let secret = args.secret_file.as_deref().map(read_secret).transpose()?;
    let failed = |e: std::io::Error| CliError::Usage(format!("cannot listen on {address}: {e}"));
    let listener = bind(address, secret.as_ref()).map_err(failed)?;
    let at = listener.local_addr().map_err(failed)?;
    tell!("scopeservo: the simulated microscope listens on {at}; Ctrl-C ends it");
    let told = |what: &str| tell!("scopeservo: {what}");
    listen(&listener, &offer, secret.as_ref(), &told).map_err(failed)?;
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_scope::VirtualClock;
    use scopeservo_twin::specimen::Blank;
    use scopeservo_twin::{Config, Twin};
    use std::sync::mpsc::channel;

    #[test]
    fn only_a_frame_waits_until_the_tissue_has_grown() {
        let (grow, told_to_grow) = channel();
        let (tell, told) = channel();
        let clock = Arc::new(VirtualClock::new());
        let twin = Twin::new(Config::realistic(), Arc::new(Blank), 1, clock).unwrap();
        let tell_grown = tell.clone();
        let camera = Growing::of(twin.camera(), move || {
            told_to_grow.recv().unwrap();
            tell_grown.send("grown").unwrap();
        });
        // It does not grow before all else was answered.
        let exposure = camera.exposure().unwrap();
        assert_eq!(camera.set_exposure(exposure), Ok(exposure));
        assert_eq!(camera.info().width, twin.config().camera.width);
        let grabbing = std::thread::spawn(move || {
            let frame = camera.grab().unwrap();
            tell.send("frame").unwrap();
            frame.sequence
        });
        grow.send(()).unwrap();
        assert_eq!(grabbing.join().unwrap(), 0);
        assert_eq!(told.iter().collect::<Vec<_>>(), ["grown", "frame"]);
    }
}

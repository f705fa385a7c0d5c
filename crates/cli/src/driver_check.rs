//! `scopeservo driver check`: the conformance suite against any driver.

use crate::answer::Answer;
use crate::args::DriverCheckArgs;
use crate::asking;
use crate::doctor::{Finding, Findings};
use crate::error::CliError;
use crate::open_instrument::stop_on_interrupt;
use scopeservo_protocol::{Driver, Secret};
use scopeservo_scope::{
    CancelToken, ChangeRule, Clock, Devices, Instrument, Light, Rules, ScopeError, SystemClock,
    conformance,
};
use scopeservo_setup::{Held, SetupError};
use scopeservo_station::jobs::look_by_small_moves;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How quickly a stop must be answered.
const STOP_WITHIN: Duration = Duration::from_millis(200);

pub(crate) fn run(args: &DriverCheckArgs, answer: &Answer) -> Result<bool, CliError> {
    let secret = args.secret_file.as_deref().map(read_secret).transpose()?;
    let cancel = CancelToken::new();
    let stop = stop_on_interrupt(&cancel, answer);
    let _held = Held::driver(&args.command, args.tcp.as_deref())?;
    let driver = open(args, secret.as_ref())?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let devices = driver.devices(&clock).map_err(SetupError::from)?;
    let mut findings = Findings::new(answer);
    findings.add(Finding {
        name: "it says hello".into(),
        ok: true,
        said: format!("{}; {}", driver.hello().name, listed(&devices)),
    });
    let stage = devices.stage.is_some();
    let camera = devices.camera.is_some();
    let nosepiece = devices.nosepiece.is_some();
    let scope = instrument(devices, args.retract_z_um, &cancel)?;
    stop.hold(&scope);

    if stage && camera {
        // The smallest steps first.
        let (seen, goes_on) = look_by_small_moves(&scope);
        seen.iter().for_each(|found| findings.add(found.into()));
        scope.check_cancel()?;
        if !goes_on {
            return findings.conclude("driver check");
        }
    }
    let mut checks = Vec::new();
    if stage {
        checks.extend(conformance::check_stage(&scope));
    }
    if camera {
        checks.extend(conformance::check_camera(&scope));
    }
    if stage && camera {
        checks.extend(conformance::check_together(&scope));
    }
    if nosepiece && (args.retract_z_um.is_some() || !stage) {
        checks.extend(conformance::check_nosepiece(&scope));
    }
    for check in checks {
        findings.add(check.into());
    }
    if stage || nosepiece {
        findings.add(stop_is_quick(&scope, camera));
    }
    if let Some(light) = scope.light() {
        findings.add(light_is_set(light));
    }
    if nosepiece && stage && args.retract_z_um.is_none() {
        say!(
            answer,
            "    objectives were not changed: name a safe height with --retract-z-um"
        );
    }
    scope.check_cancel()?;
    if stage {
        let pull = || {
            driver.cut();
            // A program is waited for: the next one needs its device.
            drop(driver);
        };
        let put_back = || -> Result<Arc<Instrument>, CliError> {
            let driver = open(args, secret.as_ref())?;
            let devices = driver.devices(&clock).map_err(SetupError::from)?;
            let scope = instrument(devices, args.retract_z_um, &cancel)?;
            stop.hold(&scope);
            Ok(scope)
        };
        let (checks, opened) =
            conformance::check_replug(scope, pull, || put_back().map_err(|e| e.to_string()));
        for check in checks {
            findings.add(check.into());
        }
        if let Some(scope) = opened {
            scope.check_cancel()?;
        }
    }
    findings.conclude("driver check")
}

fn open(args: &DriverCheckArgs, secret: Option<&Secret>) -> Result<Driver, CliError> {
    let driver = match (&args.tcp, args.command.split_first()) {
        (Some(address), _) => Driver::connect(address, secret),
        (None, Some((program, arguments))) => Driver::spawn(program, arguments),
        (None, None) => {
            return Err(CliError::Usage(
                "name the driver's program after --, like `scopeservo driver check -- python3 my_driver.py`, or --tcp ADDRESS".into(),
            ));
        }
    };
    Ok(driver.map_err(SetupError::from)?)
}

/// The devices of a driver behind a gate.
fn instrument(
    devices: Devices,
    retract_z_um: Option<f64>,
    cancel: &CancelToken,
) -> Result<Arc<Instrument>, CliError> {
    let rules = Rules::travel_only(match retract_z_um {
        Some(um) => ChangeRule::Retracted {
            z: um * 1e-6,
            margin: 0.0,
        },
        None => ChangeRule::Anywhere,
    });
    let scope = Instrument::new(devices, rules, cancel.clone())?;
    let asking = asking::about_immersion(None);
    Ok(Arc::new(scope.asking_before_immersion(asking)))
}

pub(crate) fn read_secret(path: &Path) -> Result<Secret, CliError> {
    let bad = |what: String| CliError::Read {
        path: path.into(),
        what,
    };
    let bytes = scopeservo_files::read(path, scopeservo_files::MAX_CONFIG_BYTES)
        .map_err(|e| bad(e.to_string()))?;
    Secret::new(&bytes)
        .ok_or_else(|| bad(format!("a secret has {} bytes or more", Secret::MIN_BYTES)))
}

fn listed(devices: &Devices) -> String {
    let mut all = Vec::new();
    if let Some(stage) = &devices.stage {
        let axes: Vec<String> = stage
            .info()
            .axes
            .iter()
            .map(|a| a.axis.to_string())
            .collect();
        all.push(format!("stage {} ({})", stage.info().name, axes.join(", ")));
    }
    if let Some(camera) = &devices.camera {
        let info = camera.info();
        all.push(format!(
            "camera {} ({} x {} px)",
            info.name, info.width, info.height
        ));
    }
    if let Some(nosepiece) = &devices.nosepiece {
        let ids: Vec<&str> = nosepiece
            .objectives()
            .iter()
            .map(|o| o.id.0.as_str())
            .collect();
        all.push(format!("nosepiece ({})", ids.join(", ")));
    }
    if devices.light.is_some() {
        all.push("light".into());
    }
    all.join(", ")
}

/// Ten stops, five of them while a frame is exposed, each answered in time.
fn stop_is_quick(scope: &Instrument, camera: bool) -> Finding {
    let mut worst = Duration::ZERO;
    let stops = || -> Result<(), ScopeError> {
        for k in 0..10 {
            std::thread::scope(|s| {
                let grabbing = (camera && k % 2 == 1).then(|| s.spawn(|| scope.grab()));
                // Long enough for the frame to have begun.
                std::thread::sleep(Duration::from_millis(5));
                let start = Instant::now();
                scope.gate().stop()?;
                worst = worst.max(start.elapsed());
                match grabbing.map(std::thread::ScopedJoinHandle::join) {
                    Some(Ok(frame)) => frame.map(drop),
                    Some(Err(_)) | None => Ok(()),
                }
            })?;
        }
        Ok(())
    };
    let outcome = { stops }();
    let ms = worst.as_secs_f64() * 1e3;
    let (ok, said) = match outcome {
        Err(error) => (false, error.to_string()),
        Ok(()) => (
            // Stage and nosepiece are each told.
            worst <= 2 * STOP_WITHIN,
            format!("the slowest of ten took {ms:.1} ms, both devices together"),
        ),
    };
    Finding {
        name: "stop is answered at once, also while a frame is exposed".into(),
        ok,
        said,
    }
}

fn light_is_set(light: &dyn Light) -> Finding {
    let outcome = (|| {
        let before = light.level()?;
        let set = light.set_level(if before > 0.5 { 0.25 } else { 0.75 })?;
        let read = light.level()?;
        light.set_level(before)?;
        Ok::<_, ScopeError>((set, read))
    })();
    let (ok, said) = match outcome {
        Ok((set, read)) if (set - read).abs() < 1e-9 => (true, String::new()),
        Ok((set, read)) => (false, format!("it was set to {set} and reads {read}")),
        Err(error) => (false, error.to_string()),
    };
    Finding {
        name: "the light keeps the level it was given".into(),
        ok,
        said,
    }
}

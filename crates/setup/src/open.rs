//! From the file to the instrument.

use crate::SetupError;
use crate::by_hand::{Ask, ByHand};
use crate::check::all_apart;
use crate::config::{Config, DriverConfig};
use crate::held::Held;
use crate::rules::rules;
use crate::simulated::TwinConfig;
use scopeservo_drivers::factory::{Around, ConnectError, Connected, read_secret};
use scopeservo_protocol::{Driver, Secret};
use scopeservo_scope::{
    AskImmersion, CancelToken, Clock, Devices, Instrument, Nosepiece, Objective, ScopeError,
    SystemClock, VirtualClock,
};
use scopeservo_twin::{Twin, TwinError};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// What the user agreed to.
#[derive(Clone)]
pub struct Consent {
    /// Homing, which may move anything anywhere.
    pub home: bool,
    /// How somebody is asked to turn a nosepiece.
    pub ask: Ask,
    /// How somebody is asked before an objective comes that works in another medium.
    pub ask_immersion: AskImmersion,
}

/// An instrument, ready.
pub struct Opened {
    /// What procedures need.
    pub instrument: Instrument,
    /// The simulated microscope, where it is one.
    pub twin: Option<Twin>,
    /// Each driver with the name it gives itself.
    pub drivers: Vec<(String, String)>,
}

/// [`connect`] and [`home_if_needed`] in one.
///
/// # Errors
/// Those of both.
pub fn open(config: &Config, consent: &Consent, cancel: CancelToken) -> Result<Opened, SetupError> {
    let opened = connect(config, consent, cancel)?;
    home_if_needed(&opened.instrument, consent)?;
    Ok(opened)
}

/// Lets the stage find its reference where it does not know where it is and the user agreed to that.
///
/// # Errors
/// [`ScopeError::NotHomed`] when it is needed and was not agreed to; those of [`Instrument::home`].
pub fn home_if_needed(scope: &Instrument, consent: &Consent) -> Result<(), SetupError> {
    match (scope.gate().is_homed()?, consent.home) {
        (true, _) => Ok(()),
        (false, true) => Ok(scope.home().map(drop)?),
        (false, false) => Err(ScopeError::NotHomed { device: "stage" }.into()),
    }
}

/// Takes the instrument for this program alone, finds the drivers, puts the devices together behind their gate, and sets exposure and light.
/// Nothing moves. `cancel` ends what is done with the instrument.
///
/// # Errors
/// [`SetupError`].
pub fn connect(
    config: &Config,
    consent: &Consent,
    cancel: CancelToken,
) -> Result<Opened, SetupError> {
    let held = Held::take(config)?;
    let hurried = |d: &DriverConfig| d.twin.as_ref().is_some_and(|t| !t.real_time);
    // Somebody who turns a nosepiece does so in real time.
    let by_hand = config.devices.nosepiece == "by-hand";
    let clock: Arc<dyn Clock> = match config.drivers.values().all(hurried) && !by_hand {
        true => Arc::new(VirtualClock::new()),
        false => Arc::new(SystemClock::new()),
    };
    let mut all: BTreeMap<&str, Found> = BTreeMap::new();
    for (name, driver) in &config.drivers {
        let found = find(config, (name, driver), &clock).map_err(|error| match error {
            // It names the driver already.
            error @ (SetupError::Driver(_) | SetupError::Invalid { .. }) => error,
            error => SetupError::In {
                driver: name.clone(),
                source: Box::new(error),
            },
        })?;
        all.insert(name, found);
    }
    let lacks = |driver: &str, device: &str| {
        config.senseless(
            &["devices", device],
            format!("devices.{device} is '{driver}', which has no {device}"),
        )
    };
    let devices = &config.devices;
    let stage = devices_of(&mut all, &devices.stage).and_then(|d| d.stage.take());
    let stage = stage.ok_or_else(|| lacks(&devices.stage, "stage"))?;
    let camera = devices_of(&mut all, &devices.camera).and_then(|d| d.camera.take());
    let camera = camera.ok_or_else(|| lacks(&devices.camera, "camera"))?;
    let nosepiece: Box<dyn Nosepiece> = match devices.nosepiece.as_str() {
        "by-hand" | "none" => {
            let described = config.objectives.iter().map(Objective::from).collect();
            Box::new(ByHand::new(described, consent.ask.clone()))
        }
        driver => devices_of(&mut all, driver)
            .and_then(|d| d.nosepiece.take())
            .ok_or_else(|| {
                config.senseless(
                    &["devices", "nosepiece"],
                    format!(
                        "devices.nosepiece is '{driver}', which has none: say \"none\" or \"by-hand\" and describe the objectives as \
                         [[objective]]"
                    ),
                )
            })?,
    };
    let light = match &devices.light {
        None => None,
        Some(driver) => Some(
            devices_of(&mut all, driver)
                .and_then(|d| d.light.take())
                .ok_or_else(|| lacks(driver, "light"))?,
        ),
    };
    let carried = nosepiece.objectives();
    all_apart(config, carried)?;
    let rules = rules(config, stage.info(), carried)?;
    // What is wrong with the rules is said before anything moves.
    let devices = Devices {
        stage: Some(stage),
        camera: Some(camera),
        nosepiece: Some(nosepiece),
        light,
        clock,
    };
    let scope = Instrument::new(devices, rules, cancel)?
        .keeping(held)
        .asking_before_immersion(consent.ask_immersion.clone());
    set(config, &scope)?;
    let drivers = all
        .iter()
        .map(|(n, f)| ((*n).to_owned(), f.name.clone()))
        .collect();
    let twin = all.into_values().find_map(|found| found.twin);
    Ok(Opened {
        instrument: scope,
        twin,
        drivers,
    })
}

fn devices_of<'a>(all: &'a mut BTreeMap<&str, Found>, driver: &str) -> Option<&'a mut Devices> {
    all.get_mut(driver).map(|found| &mut found.devices)
}

/// A driver that was found.
pub(crate) struct Found {
    pub(crate) name: String,
    pub(crate) devices: Devices,
    pub(crate) twin: Option<Twin>,
}

fn find(
    config: &Config,
    (name, driver): (&str, &DriverConfig),
    clock: &Arc<dyn Clock>,
) -> Result<Found, SetupError> {
    if let Some(twin) = &driver.twin {
        return simulated(config, (name, twin), clock);
    }
    if let Some(own) = driver.own.first() {
        let around = Around {
            resolve: &|path| config.resolve(path),
            clock,
        };
        let Connected { name, devices } = own.connect(&around).map_err(of(config, name))?;
        return Ok(Found {
            name,
            devices,
            twin: None,
        });
    }
    let driver = match (&driver.program, &driver.tcp) {
        (Some(program), _) => {
            // The check saw that it is not empty.
            let (first, arguments) = program.split_first().map_or(("", &[][..]), |(f, a)| (f, a));
            let first = match first.contains('/') {
                true => config
                    .resolve(first.as_ref())
                    .to_string_lossy()
                    .into_owned(),
                false => first.to_owned(),
            };
            Driver::spawn(&first, arguments)?
        }
        (None, Some(address)) => {
            let secret = match &driver.secret_file {
                Some(file) => Some(secret(config, name, file)?),
                None => None,
            };
            Driver::connect(address, secret.as_ref())?
        }
        (None, None) => {
            let what = format!("drivers.{name} has neither program nor tcp");
            return Err(config.senseless(&["drivers", name], what));
        }
    };
    Ok(Found {
        name: driver.hello().name.clone(),
        devices: driver.devices(clock)?,
        twin: None,
    })
}

/// What a driver says, of this description.
fn of(config: &Config, name: &str) -> impl Fn(ConnectError) -> SetupError {
    let keys = ["drivers", name];
    move |error| match error {
        ConnectError::Description(what) => {
            config.senseless(&keys, format!("drivers.{name}: {what}"))
        }
        ConnectError::Secret { path, what } => SetupError::Secret { path, what },
        ConnectError::Scope(error) => error.into(),
        other => config.senseless(&keys, format!("drivers.{name}: {other}")),
    }
}

fn secret(config: &Config, name: &str, file: &Path) -> Result<Secret, SetupError> {
    let read = read_secret(&|path| config.resolve(path), file);
    let (path, bytes) = read.map_err(of(config, name))?;
    Secret::new(&bytes).ok_or_else(|| SetupError::Secret {
        path,
        what: format!("it must have {} bytes or more", Secret::MIN_BYTES),
    })
}

fn simulated(
    config: &Config,
    (name, settings): (&str, &TwinConfig),
    clock: &Arc<dyn Clock>,
) -> Result<Found, SetupError> {
    let twin = settings
        .build(|path| config.resolve(path), clock.clone())
        .map_err(|error| match error {
            SetupError::Twin(TwinError::BadConfig { what }) => config.senseless(
                &["drivers", name, "twin"],
                format!("drivers.{name}.twin: {what}"),
            ),
            other => other,
        })?;
    Ok(Found {
        name: "simulated microscope".into(),
        devices: twin.devices(),
        twin: Some(twin),
    })
}

fn set(config: &Config, scope: &Instrument) -> Result<(), SetupError> {
    if let Some(ms) = config.camera.exposure_ms {
        let exposure = Duration::try_from_secs_f64(ms * 1e-3).map_err(|_| {
            let what = format!("camera.exposure_ms is {ms}: it must be a time");
            config.senseless(&["camera", "exposure_ms"], what)
        })?;
        scope.camera().set_exposure(exposure)?;
    }
    // The check saw that there is a light, where it is to be set.
    if let (Some(level), Some(light)) = (config.light.level, scope.light()) {
        light.set_level(level)?;
    }
    Ok(())
}

//! Whether a description that can be read can be one of an instrument: what is found without asking any device.

use crate::SetupError;
use crate::config::{AxesConfig, Config, ObjectiveConfig};
use scopeservo_drivers::factory::Factory;
use scopeservo_scope::{Objective, ObjectiveId};

/// The first thing that cannot be, with its line.
pub(crate) fn check(config: &Config, known: &[Factory]) -> Result<(), SetupError> {
    drivers(config, known)?;
    devices(config)?;
    objectives(config)?;
    ranges(config)?;
    settings(config)?;
    change(config)
}

fn drivers(config: &Config, known: &[Factory]) -> Result<(), SetupError> {
    for (name, driver) in &config.drivers {
        let here = |what: String| config.senseless(&["drivers", name], what);
        for own in &driver.own {
            let checked = own.check();
            checked.map_err(|what| here(format!("drivers.{name}: {what}")))?;
        }
        let kinds = [
            ("program", driver.program.is_some()),
            ("tcp", driver.tcp.is_some()),
            ("twin", driver.twin.is_some()),
        ];
        let of_ours = kinds.iter().filter(|(_, is)| *is).count();
        if of_ours + driver.own.len() != 1 {
            let all = kinds.iter().map(|(kind, _)| *kind);
            let all: Vec<&str> = all.chain(known.iter().map(|f| f.kind)).collect();
            return Err(here(format!(
                "drivers.{name} must have exactly one of {}",
                all.join(", ")
            )));
        }
        if driver.program.as_ref().is_some_and(Vec::is_empty) {
            return Err(here(format!("drivers.{name}.program is empty")));
        }
        if driver.secret_file.is_some() && driver.tcp.is_none() {
            return Err(here(format!("drivers.{name}: a secret is for tcp only")));
        }
    }
    Ok(())
}

fn devices(config: &Config) -> Result<(), SetupError> {
    let devices = &config.devices;
    let mut named = vec![("stage", &devices.stage), ("camera", &devices.camera)];
    if !["by-hand", "none"].contains(&devices.nosepiece.as_str()) {
        named.push(("nosepiece", &devices.nosepiece));
    }
    named.extend(devices.light.iter().map(|l| ("light", l)));
    for (device, driver) in named {
        if !config.drivers.contains_key(driver) {
            let known = config.drivers.keys().map(String::as_str);
            let hint =
                guess(driver, known).map_or(String::new(), |g| format!("; did you mean '{g}'?"));
            return Err(config.senseless(
                &["devices", device],
                format!("devices.{device} is '{driver}', and there is no drivers.{driver}{hint}"),
            ));
        }
    }
    Ok(())
}

fn objectives(config: &Config) -> Result<(), SetupError> {
    let (said, count) = (config.devices.nosepiece.as_str(), config.objectives.len());
    let nosepiece = |what: &str| Err(config.senseless(&["devices", "nosepiece"], what));
    match (said, count) {
        ("by-hand", 0) => nosepiece("a nosepiece by hand needs its objectives: [[objective]]")?,
        ("none", n) if n != 1 => nosepiece(
            "without a nosepiece there is exactly one objective: describe it as [[objective]]",
        )?,
        ("by-hand" | "none", _) | (_, 0) => {}
        _ => {
            nosepiece("the driver's nosepiece brings its own objectives: leave out [[objective]]")?
        }
    }
    let described: Vec<Objective> = config.objectives.iter().map(Objective::from).collect();
    for (k, objective) in described.iter().enumerate() {
        let fault = objective.check().map_err(|e| e.to_string());
        let fault = fault.and_then(|()| told_apart(&described[..k], objective));
        let item = k.to_string();
        fault.map_err(|what| config.senseless(&["objective", &item], what))?;
    }
    Ok(())
}

impl From<&ObjectiveConfig> for Objective {
    fn from(said: &ObjectiveConfig) -> Self {
        Self {
            id: ObjectiveId(said.id.clone()),
            magnification: said.magnification,
            numerical_aperture: said.numerical_aperture,
            nominal_um_per_px: said.um_per_px,
            immersion: said.immersion,
        }
    }
}

/// Whether the objectives that a driver's nosepiece says it carries are told apart.
pub(crate) fn all_apart(config: &Config, carried: &[Objective]) -> Result<(), SetupError> {
    for (k, objective) in carried.iter().enumerate() {
        let fault = objective.check().map_err(|e| e.to_string());
        let fault = fault.and_then(|()| told_apart(&carried[..k], objective));
        fault.map_err(|what| {
            let driver = &config.devices.nosepiece;
            config.senseless(&["drivers", driver], format!("drivers.{driver}: {what}"))
        })?;
    }
    Ok(())
}

/// Whether an objective is another one than those `before` it: by its name, as files are called after it, and by what is engraved.
fn told_apart(before: &[Objective], objective: &Objective) -> Result<(), String> {
    let id = &objective.id.0;
    if id.trim().is_empty() || before.iter().any(|o| o.id == objective.id) {
        return Err(format!("the objective '{id}' needs a name of its own"));
    }
    // Where file systems are blind to case, their calibrations would be one another's.
    if let Some(other) = before
        .iter()
        .find(|o| o.id.0.to_lowercase() == id.to_lowercase())
    {
        return Err(format!(
            "the objectives '{}' and '{id}' differ by capital letters only, which some systems do not tell apart: give one another name",
            other.id
        ));
    }
    let alike = |a: f64, b: f64| (a / b - 1.0).abs() < 1e-3;
    let same = |o: &&Objective| {
        alike(o.magnification, objective.magnification)
            && alike(o.numerical_aperture, objective.numerical_aperture)
            && o.immersion == objective.immersion
    };
    match before.iter().find(same) {
        Some(other) => Err(format!(
            "the objectives '{}' and '{id}' have the same magnification, aperture and medium, and cannot be told apart: correct what is \
             engraved on one of them, or leave one out",
            other.id
        )),
        None => Ok(()),
    }
}

/// Whether two numbers are in order; an axis may be held at one place.
fn rises([from, to]: [f64; 2]) -> bool {
    from.is_finite() && to.is_finite() && from <= to
}

fn ranges(config: &Config) -> Result<(), SetupError> {
    let limits = |table: &[&str], axes: &AxesConfig<[f64; 2]>| {
        axes.each().try_for_each(|(key, _, [from, to])| {
            let keys = [table, &[key]].concat();
            match rises([from, to]) {
                true => Ok(()),
                false => Err(config.senseless(
                    &keys,
                    format!(
                        "{} is [{from}, {to}]: it must be two numbers, the smaller first",
                        keys.join(".")
                    ),
                )),
            }
        })
    };
    limits(&["limits"], &config.limits)?;
    for (id, axes) in &config.limits_for {
        limits(&["limits_for", id], axes)?;
    }
    for (key, _, step) in config.largest_step.each() {
        if !(step.is_finite() && step > 0.0) {
            let what = format!("largest_step.{key} is {step}: it must be above 0");
            return Err(config.senseless(&["largest_step", key], what));
        }
    }
    for (k, zone) in config.zones.iter().enumerate() {
        let item = k.to_string();
        for (key, range) in [("x_um", zone.x_um), ("y_um", zone.y_um)] {
            if !rises(range) {
                let what = format!(
                    "{key} of the zone '{}' is [{}, {}]: it must be two numbers, the smaller first",
                    zone.name, range[0], range[1]
                );
                return Err(config.senseless(&["zone", &item, key], what));
            }
        }
        if !zone.closest_z_um.is_finite() {
            let what = format!("closest_z_um of the zone '{}' must be a number", zone.name);
            return Err(config.senseless(&["zone", &item, "closest_z_um"], what));
        }
    }
    Ok(())
}

fn settings(config: &Config) -> Result<(), SetupError> {
    if config.name.trim().is_empty() {
        return Err(config.senseless(&["name"], "name is empty: give the instrument one"));
    }
    let above = |table: &str, key: &str, value: Option<f64>| match value {
        Some(value) if !(value > 0.0 && value.is_finite()) => Err(config.senseless(
            &[table, key],
            format!("{table}.{key} is {value}: it must be above 0"),
        )),
        _ => Ok(()),
    };
    above("arrival", "within_um", config.arrival.within_um)?;
    above("arrival", "within_deg", config.arrival.within_deg)?;
    above("camera", "exposure_ms", config.camera.exposure_ms)?;
    let frames_gb = config.library.frames_gb;
    if !(frames_gb >= 0.0 && frames_gb.is_finite()) {
        return Err(config.senseless(
            &["library", "frames_gb"],
            format!("library.frames_gb is {frames_gb}: it must be 0 or more"),
        ));
    }
    match config.light.level {
        Some(level) if !(0.0..=1.0).contains(&level) => Err(config.senseless(
            &["light", "level"],
            format!("light.level is {level}: it must be from 0 to 1"),
        )),
        Some(_) if config.devices.light.is_none() => Err(config.senseless(
            &["light", "level"],
            "light.level is set, but devices.light names no driver",
        )),
        _ => Ok(()),
    }
}

fn change(config: &Config) -> Result<(), SetupError> {
    let Some(change) = &config.objective_change else {
        return Ok(());
    };
    let wrong = |what: &str| Err(config.senseless(&["objective_change"], what));
    if change.retract_z_um.is_some() != change.margin_um.is_some() {
        return wrong(
            "objective_change: margin_um belongs to retract_z_um: how far from the expected focus an objective stops whose focus was never \
             found, such as 50",
        );
    }
    if change.retract_z_um.is_some() == (change.anywhere == Some(true)) {
        return wrong(
            "objective_change must have exactly one of retract_z_um = ... and anywhere = true",
        );
    }
    if change
        .margin_um
        .is_some_and(|m| !(m >= 0.0 && m.is_finite()))
    {
        return Err(config.senseless(
            &["objective_change", "margin_um"],
            "objective_change.margin_um must be 0 or above",
        ));
    }
    if change.retract_z_um.is_some_and(|z| !z.is_finite()) {
        return Err(config.senseless(
            &["objective_change", "retract_z_um"],
            "objective_change.retract_z_um must be a number",
        ));
    }
    Ok(())
}

/// The word most like another, if any is.
pub(crate) fn guess<'a>(wrong: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    known
        .map(|word| (strsim::jaro_winkler(wrong, word), word))
        .filter(|(like, _)| *like > 0.8)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, word)| word)
}

//! From the file's rules to those of the gate.

use crate::SetupError;
use crate::config::{AxesConfig, ChangeConfig, Config};
use scopeservo_scope::{
    Axis, AxisRange, ChangeRule, LargestStep, Limits, Objective, ObjectiveId, Rules, ScopeError,
    StageInfo, Zone,
};

impl<T: Copy> AxesConfig<T> {
    /// What is said of axes, each with its key in the file.
    pub(crate) fn each(&self) -> impl Iterator<Item = (&'static str, Axis, T)> {
        [
            ("x_um", Axis::X, self.x_um),
            ("y_um", Axis::Y, self.y_um),
            ("z_um", Axis::Z, self.z_um),
            ("rx_deg", Axis::Rx, self.rx_deg),
            ("ry_deg", Axis::Ry, self.ry_deg),
            ("rz_deg", Axis::Rz, self.rz_deg),
        ]
        .into_iter()
        .filter_map(|(key, axis, value)| Some((key, axis, value?)))
    }
}

fn range(axis: Axis, [min, max]: [f64; 2]) -> AxisRange {
    AxisRange {
        axis,
        min: axis.from_display(min),
        max: axis.from_display(max),
    }
}

fn um(value: f64) -> f64 {
    Axis::X.from_display(value)
}

/// Rules that grow, one of the file's after the other: the first that makes no sense with those before it is named with its place.
struct Growing<'a> {
    config: &'a Config,
    stage: &'a StageInfo,
    objectives: &'a [Objective],
    rules: Rules,
}

impl Growing<'_> {
    fn add(&mut self, keys: &[&str], change: impl FnOnce(&mut Rules)) -> Result<(), SetupError> {
        change(&mut self.rules);
        let checked = self.rules.check(self.stage, self.objectives);
        checked.map_err(|error| {
            let what = match error {
                ScopeError::BadSetting { what } => what,
                other => other.to_string(),
            };
            let key = keys.join(".");
            self.config.senseless(keys, format!("{key}: {what}"))
        })
    }
}

/// The rules for a stage and its objectives.
///
/// # Errors
/// [`SetupError::Invalid`] with the place of the first rule that makes no sense for them; [`SetupError::Scope`] for a stage that says what cannot
/// be.
pub(crate) fn rules(
    config: &Config,
    stage: &StageInfo,
    objectives: &[Objective],
) -> Result<Rules, SetupError> {
    let mut growing = Growing {
        config,
        stage,
        objectives,
        rules: Rules::travel_only(ChangeRule::Anywhere),
    };
    growing.rules.check(stage, objectives)?;
    growing.rules.workspace = config.workspace;
    for (key, axis, ends) in config.limits.each() {
        growing.add(&["limits", key], |rules| {
            rules.limits.ranges.push(range(axis, ends));
        })?;
    }
    let change = change(config, stage, objectives)?;
    growing.add(&["objective_change"], |rules| rules.change = change)?;
    for (id, axes) in &config.limits_for {
        growing.add(&["limits_for", id], |rules| {
            let ranges = axes.each().map(|(_, axis, ends)| range(axis, ends));
            let limits = Limits {
                ranges: ranges.collect(),
            };
            rules
                .objective_limits
                .insert(ObjectiveId(id.clone()), limits);
        })?;
    }
    for (key, axis, step) in config.largest_step.each() {
        growing.add(&["largest_step", key], |rules| {
            let step = axis.from_display(step);
            rules.largest_steps.push(LargestStep { axis, step });
        })?;
    }
    for (k, zone) in config.zones.iter().enumerate() {
        growing.add(&["zone", &k.to_string()], |rules| {
            rules.zones.push(Zone {
                name: zone.name.clone(),
                x: zone.x_um.map(um),
                y: zone.y_um.map(um),
                closest_z: um(zone.closest_z_um),
                objectives: zone.objectives.iter().cloned().map(ObjectiveId).collect(),
            });
        })?;
    }
    Ok(growing.rules)
}

/// When the nosepiece may turn.
fn change(
    config: &Config,
    stage: &StageInfo,
    objectives: &[Objective],
) -> Result<ChangeRule, SetupError> {
    match &config.objective_change {
        Some(ChangeConfig {
            retract_z_um: Some(z),
            margin_um,
            ..
        }) => Ok(ChangeRule::Retracted {
            z: um(*z),
            // The check saw that it is there.
            margin: um(margin_um.unwrap_or(f64::NAN)),
        }),
        Some(_) => Ok(ChangeRule::Anywhere),
        // Nothing turns, or nothing can be retracted.
        None if objectives.len() < 2 || stage.axis(Axis::Z).is_none() => Ok(ChangeRule::Anywhere),
        None => Err(config.senseless(
            &["objective_change"],
            "there are several objectives: [objective_change] must say from which retract_z_um on the nosepiece may turn, or \
             anywhere = true",
        )),
    }
}

//! From the file's rules to those of the gate.

use crate::SetupError;
use crate::config::{AxesConfig, Config};
use scopeservo_scope::{
    Axis, AxisRange, ChangeRule, LargestStep, Limits, ObjectiveId, Rules, StageInfo, Zone,
};

impl<T: Copy> AxesConfig<T> {
    fn each(&self) -> impl Iterator<Item = (Axis, T)> {
        [
            (Axis::X, self.x_um),
            (Axis::Y, self.y_um),
            (Axis::Z, self.z_um),
            (Axis::Rx, self.rx_deg),
            (Axis::Ry, self.ry_deg),
            (Axis::Rz, self.rz_deg),
        ]
        .into_iter()
        .filter_map(|(axis, value)| Some((axis, value?)))
    }
}

fn limits(axes: &AxesConfig<[f64; 2]>) -> Limits {
    Limits {
        ranges: axes
            .each()
            .map(|(axis, [min, max])| AxisRange {
                axis,
                min: axis.from_display(min),
                max: axis.from_display(max),
            })
            .collect(),
    }
}

fn um(value: f64) -> f64 {
    Axis::X.from_display(value)
}

/// The rules for a stage and its objectives.
pub(crate) fn rules(
    config: &Config,
    stage: &StageInfo,
    objectives: usize,
) -> Result<Rules, SetupError> {
    let change = match &config.objective_change {
        Some(change) => match change.retract_z_um {
            Some(z) => ChangeRule::Retracted {
                z: um(z),
                // The check saw that it is there.
                margin: um(change.margin_um.unwrap_or(f64::NAN)),
            },
            None => ChangeRule::Anywhere,
        },
        // Nothing turns, or nothing can be retracted.
        None if objectives < 2 || stage.axis(Axis::Z).is_none() => ChangeRule::Anywhere,
        None => {
            return Err(config.senseless(
                "there are several objectives: [objective_change] must say from which retract_z_um on the nosepiece may turn, or \
                 anywhere = true",
            ));
        }
    };
    Ok(Rules {
        limits: limits(&config.limits),
        objective_limits: config
            .limits_for
            .iter()
            .map(|(id, axes)| (ObjectiveId(id.clone()), limits(axes)))
            .collect(),
        largest_steps: config
            .largest_step
            .each()
            .map(|(axis, step)| LargestStep {
                axis,
                step: axis.from_display(step),
            })
            .collect(),
        workspace: config.workspace,
        zones: config
            .zones
            .iter()
            .map(|zone| Zone {
                name: zone.name.clone(),
                x: zone.x_um.map(um),
                y: zone.y_um.map(um),
                closest_z: um(zone.closest_z_um),
                objectives: zone.objectives.iter().cloned().map(ObjectiveId).collect(),
            })
            .collect(),
        change,
    })
}

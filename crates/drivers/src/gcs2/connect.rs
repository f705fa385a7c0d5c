//! Taking a controller over.

use crate::gcs2::codec::{self, AxisName, Command};
use crate::gcs2::settings::{AxisPlan, Gcs2Nosepiece, Gcs2Settings};
use crate::gcs2::stage::{Doing, Gcs2Stage, Nosepiece};
use crate::gcs2::talk::{ask, ask_if_known, error_number, read, values};
use crate::gcs2::unit::Unit;
use crate::link::Transport;
use crate::session::{Exchange, Session, StopBytes, bad_setting, device};
use scopeservo_scope::{Angle, AxisInfo, ScopeError, StageInfo, visible};
use std::sync::Mutex;

impl Gcs2Stage {
    /// Takes a controller over: reads who it is, that it has the axes of the settings, and their travel. Nothing moves.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] for settings that make no sense or name an axis that the controller lacks;
    /// [`ScopeError::Timeout`] or [`ScopeError::Device`] when it does not answer, or not as a GCS 2 controller.
    pub fn connect(
        transport: Box<dyn Transport>,
        settings: &Gcs2Settings,
    ) -> Result<Self, ScopeError> {
        let mut plans = settings.plans()?;
        let names: Vec<AxisName> = plans.iter().map(|p| p.name.clone()).collect();
        let session = Session::new(
            transport,
            StopBytes {
                bytes: &[codec::STOP_ALL],
                answered: false,
            },
            codec::MAX_LINE_BYTES,
            settings.reply_timeout(),
        );
        let mut ex = session.exchange()?;
        let who = ask(&mut ex, &Command::Identify)?;
        let name = read(&ex, codec::one_line("*IDN?", &who))?
            .trim()
            .to_string();
        let lines = ask(&mut ex, &Command::Axes)?;
        let there = read(&ex, codec::decode_axes(&lines))?;
        let nosepiece = match &settings.nosepiece {
            Some(nosepiece) => {
                Some(AxisName::new(&nosepiece.name).map_err(|e| bad_setting(e.to_string()))?)
            }
            None => None,
        };
        check_there(names.iter().chain(&nosepiece), &there)?;
        // What was wrong before is not about us.
        error_number(&mut ex)?;
        let units_said = units(&mut ex, &names)?;
        for (plan, unit) in plans.iter_mut().zip(&units_said) {
            plan.unit = of_axis(&plan.name, plan.axis.is_rotation(), unit.clone())?;
        }
        let axes = travels(&mut ex, &plans, &names)?;
        let knows_reference = ask_if_known(&mut ex, &Command::Referenced(&names))?.is_some();
        let nosepiece = match (nosepiece, settings.nosepiece.clone()) {
            (Some(name), Some(settings)) => Some(turning(&mut ex, name, settings)?),
            _ => None,
        };
        drop(ex);
        Ok(Self {
            session,
            nosepiece,
            info: StageInfo {
                name,
                axes,
                kinematics: settings.kinematics,
                positive_z: settings.positive_z,
            },
            plans,
            names,
            units_said,
            coupled: settings.coupled,
            stop_timeout: settings.stop_timeout(),
            settle_timeout: settings.settle_timeout(),
            doing: Mutex::new(Doing::Nothing),
            velocity_owed: Mutex::new(None),
            homed: Mutex::new(false),
            knows_reference,
        })
    }
}

impl Gcs2Stage {
    /// Whether the controller still counts its axes in what it said when it was taken over: a place that is wrong by a thousand may lie within the travel.
    ///
    /// # Errors
    /// [`ScopeError::Device`] where somebody has changed that, and those of the link.
    pub(super) fn check_units(&self, ex: &mut Exchange<'_>) -> Result<(), ScopeError> {
        if self.units_said.iter().all(String::is_empty) {
            return Ok(());
        }
        let now = units(ex, &self.names)?;
        let changed = self.names.iter().zip(self.units_said.iter().zip(&now));
        let changed: Vec<String> = changed
            .filter(|(_, (then, now))| then != now)
            .map(|(name, (then, now))| {
                format!("{name} in {}, and then in {}", visible(now), visible(then))
            })
            .collect();
        match changed.is_empty() {
            true => Ok(()),
            false => Err(device(format!(
                "it counts otherwise than when it was connected (PUN?): {}. Nothing moved. Close what else drives it, and connect again",
                changed.join("; ")
            ))),
        }
    }
}

/// The controller has all axes of the settings.
fn check_there<'a>(
    mut asked: impl Iterator<Item = &'a AxisName>,
    there: &[AxisName],
) -> Result<(), ScopeError> {
    let Some(missing) = asked.find(|n| !there.contains(n)) else {
        return Ok(());
    };
    let there: Vec<_> = there.iter().map(AxisName::as_str).collect();
    Err(bad_setting(format!(
        "the controller has no axis {missing}; it has {}",
        there.join(", ")
    )))
}

/// What the controller counts axes in, in its words; nothing where it does not say it.
fn units(ex: &mut Exchange<'_>, names: &[AxisName]) -> Result<Vec<String>, ScopeError> {
    match ask_if_known(ex, &Command::Units(names))? {
        Some(lines) => read(ex, codec::decode_words("PUN?", names, &lines)),
        None => Ok(vec![String::new(); names.len()]),
    }
}

/// The unit of an axis that turns or shifts.
fn of_axis(name: &AxisName, turns: bool, said: String) -> Result<Unit, ScopeError> {
    let unit = match (said.as_str(), turns) {
        ("", true) => Unit::DEGREE,
        ("", false) => Unit::MILLIMETRE,
        (word, _) => Unit::read(word).ok_or_else(|| {
            bad_setting(format!(
                "the controller counts axis {name} in '{}' (PUN?), which is no unit that is known here: set it to MM or UM, or DEG",
                visible(word)
            ))
        })?,
    };
    if unit.turns() == turns {
        return Ok(unit);
    }
    let (is, stands) = match turns {
        true => ("shifts", "turns (rotary, or the nosepiece)"),
        false => ("turns", "shifts (linear)"),
    };
    Err(bad_setting(format!(
        "the controller counts axis {name} in {} (PUN?), so it {is}, and stands in the settings as one that {stands}",
        visible(&said)
    )))
}

/// The axes of the stage with the travel that the controller gives them.
fn travels(
    ex: &mut Exchange<'_>,
    plans: &[AxisPlan],
    names: &[AxisName],
) -> Result<Vec<AxisInfo>, ScopeError> {
    let low = values(ex, &Command::LowerEnds(names), names)?;
    let high = values(ex, &Command::UpperEnds(names), names)?;
    let mut axes = Vec::new();
    for ((plan, low), high) in plans.iter().zip(low).zip(high) {
        if low > high {
            return Err(device(format!(
                "axis {} has a travel from {low} to {high}",
                plan.name
            )));
        }
        axes.push(AxisInfo {
            axis: plan.axis,
            min: plan.si(low),
            max: plan.si(high),
            repeatability: plan.repeatability_si,
            arrival_tolerance: Some(plan.tolerance_si),
        });
    }
    Ok(axes)
}

/// A nosepiece whose places all lie within the travel of its axis.
fn turning(
    ex: &mut Exchange<'_>,
    name: AxisName,
    settings: Gcs2Nosepiece,
) -> Result<Nosepiece, ScopeError> {
    let names = [name.clone()];
    let low = values(ex, &Command::LowerEnds(&names), &names)?;
    let high = values(ex, &Command::UpperEnds(&names), &names)?;
    let [said] = <[String; 1]>::try_from(units(ex, &names)?).unwrap_or_default();
    let unit = of_axis(&name, true, said)?;
    let [low, high] = [low[0], high[0]].map(|end| Angle::from_rad(unit.si(end)).deg());
    // An end that is converted may be off by its last digit.
    let slack = 1e-9 * (high - low).abs();
    let within = |deg: f64| (low - slack..=high + slack).contains(&deg);
    match settings.objectives.iter().find(|o| !within(o.at_deg)) {
        Some(outside) => Err(bad_setting(format!(
            "{} stands at {} deg, and the axis {name} goes from {} to {} deg",
            outside.id, outside.at_deg, low, high
        ))),
        None => Ok(Nosepiece {
            name,
            settings,
            unit,
        }),
    }
}

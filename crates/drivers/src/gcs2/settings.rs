//! What the driver must be told about a stage, since the controller does not say it.

use crate::gcs2::codec::AxisName;
use crate::gcs2::unit::Unit;
use crate::session::bad_setting;
use crate::turret::{self, TurretPlace};
use scopeservo_scope::{Angle, Axis, Kinematics, Length, PositiveZ, ScopeError};
use serde::Deserialize;
use std::collections::HashSet;
use std::time::Duration;

/// An axis that shifts. The controller counts it in what it says (`PUN?`), or in millimetres.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinearAxis {
    /// Which of our axes it is: x, y or z.
    pub axis: Axis,
    /// The controller's name for it.
    pub name: String,
    /// Half-width of the interval in which repeated arrivals at one place end, from the stage's data sheet.
    pub repeatability_um: f64,
    /// A move counts as arrived when the controller reads a place this near to the goal.
    pub arrival_tolerance_um: f64,
}

/// An axis that turns. The controller counts it in what it says (`PUN?`), or in degrees.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RotaryAxis {
    /// Which of our axes it is: rx, ry or rz.
    pub axis: Axis,
    /// The controller's name for it.
    pub name: String,
    /// Half-width of the interval in which repeated arrivals at one place end, from the stage's data sheet.
    pub repeatability_deg: f64,
    /// A move counts as arrived when the controller reads an angle this near to the goal.
    pub arrival_tolerance_deg: f64,
}

/// A nosepiece on one more axis of the controller, which turns.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gcs2Nosepiece {
    /// The controller's name for the axis.
    pub name: String,
    /// An objective counts as active when the controller reads an angle this near to its place.
    pub arrival_tolerance_deg: f64,
    /// The objectives.
    pub objectives: Vec<TurretPlace>,
}

fn second() -> u64 {
    1000
}

fn two_seconds() -> u64 {
    2000
}

/// How a stage on a GCS 2 controller is set up.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gcs2Settings {
    /// Which side moves.
    pub kinematics: Kinematics,
    /// What positive z does, on this microscope.
    pub positive_z: PositiveZ,
    /// The axes that shift.
    #[serde(default)]
    pub linear: Vec<LinearAxis>,
    /// The axes that turn.
    #[serde(default)]
    pub rotary: Vec<RotaryAxis>,
    /// A nosepiece, which is none of the axes above.
    pub nosepiece: Option<Gcs2Nosepiece>,
    /// Whether the axes share one platform, so that what one can reach depends on the others: a hexapod. The controller
    /// is then asked before every move.
    pub coupled: bool,
    /// How long one answer may take.
    #[serde(default = "second")]
    pub reply_timeout_ms: u64,
    /// How long the axes may go on after a stop.
    #[serde(default = "second")]
    pub stop_timeout_ms: u64,
    /// How long the axes may take from standing still to being on target.
    #[serde(default = "two_seconds")]
    pub settle_timeout_ms: u64,
}

/// One axis, in what the controller counts and in SI units.
#[derive(Debug, Clone)]
pub(crate) struct AxisPlan {
    pub(crate) axis: Axis,
    pub(crate) name: AxisName,
    pub(crate) repeatability_si: f64,
    pub(crate) tolerance_si: f64,
    /// What the controller counts it in.
    pub(crate) unit: Unit,
}

impl AxisPlan {
    /// Metres or radians in what the controller counts in.
    pub(crate) fn wire(&self, si: f64) -> f64 {
        self.unit.of_si(si)
    }
    /// What the controller says in metres or radians.
    pub(crate) fn si(&self, wire: f64) -> f64 {
        self.unit.si(wire)
    }
}

impl Gcs2Settings {
    /// A hexapod: X, Y, Z, U, V, W are x, y, z and the rotations about them, with the figures given for all three.
    pub fn hexapod(
        kinematics: Kinematics,
        positive_z: PositiveZ,
        repeatability_um: f64,
        repeatability_deg: f64,
    ) -> Self {
        let linear = [(Axis::X, "X"), (Axis::Y, "Y"), (Axis::Z, "Z")];
        let rotary = [(Axis::Rx, "U"), (Axis::Ry, "V"), (Axis::Rz, "W")];
        Self {
            kinematics,
            positive_z,
            linear: linear
                .map(|(axis, name)| LinearAxis {
                    axis,
                    name: name.into(),
                    repeatability_um,
                    arrival_tolerance_um: 10.0 * repeatability_um,
                })
                .into(),
            rotary: rotary
                .map(|(axis, name)| RotaryAxis {
                    axis,
                    name: name.into(),
                    repeatability_deg,
                    arrival_tolerance_deg: 10.0 * repeatability_deg,
                })
                .into(),
            nosepiece: None,
            coupled: true,
            reply_timeout_ms: second(),
            stop_timeout_ms: second(),
            settle_timeout_ms: two_seconds(),
        }
    }

    /// The axes, checked.
    pub(crate) fn plans(&self) -> Result<Vec<AxisPlan>, ScopeError> {
        let linear = self.linear.iter().map(|a| {
            let um = |v| Length::from_um(v).m();
            let figures = [um(a.repeatability_um), um(a.arrival_tolerance_um)];
            (a.axis, &a.name, figures, false)
        });
        let rotary = self.rotary.iter().map(|a| {
            let deg = |v| Angle::from_deg(v).rad();
            let figures = [deg(a.repeatability_deg), deg(a.arrival_tolerance_deg)];
            (a.axis, &a.name, figures, true)
        });
        let mut plans = Vec::new();
        for (axis, name, [repeatability_si, tolerance_si], turns) in linear.chain(rotary) {
            if axis.is_rotation() != turns {
                return Err(bad_setting(format!(
                    "{axis} stands among the {} axes",
                    if turns { "rotary" } else { "linear" }
                )));
            }
            let finite = repeatability_si.is_finite() && tolerance_si.is_finite();
            if !finite || repeatability_si < 0.0 || tolerance_si <= 0.0 {
                return Err(bad_setting(format!(
                    "{axis}: the repeatability must not be negative and the arrival tolerance must be positive"
                )));
            }
            plans.push(AxisPlan {
                axis,
                name: AxisName::new(name).map_err(|e| bad_setting(e.to_string()))?,
                repeatability_si,
                tolerance_si,
                unit: match turns {
                    true => Unit::DEGREE,
                    false => Unit::MILLIMETRE,
                },
            });
        }
        if plans.is_empty() {
            return Err(bad_setting("the settings name no axis"));
        }
        let axes: HashSet<_> = plans.iter().map(|p| p.axis).collect();
        let names: HashSet<_> = plans.iter().map(|p| p.name.as_str()).collect();
        if axes.len() != plans.len() || names.len() != plans.len() {
            return Err(bad_setting(
                "an axis or a name stands in the settings twice",
            ));
        }
        if let Some(nosepiece) = &self.nosepiece {
            let name = AxisName::new(&nosepiece.name).map_err(|e| bad_setting(e.to_string()))?;
            if names.contains(name.as_str()) {
                return Err(bad_setting(format!(
                    "the axis {name} stands in the settings twice: for the stage and for the nosepiece"
                )));
            }
            turret::check(&nosepiece.objectives, nosepiece.arrival_tolerance_deg)?;
        }
        for (what, ms) in [
            ("reply_timeout_ms", self.reply_timeout_ms),
            ("stop_timeout_ms", self.stop_timeout_ms),
            ("settle_timeout_ms", self.settle_timeout_ms),
        ] {
            if !(10..=60_000).contains(&ms) {
                return Err(bad_setting(format!("{what} must be from 10 to 60000")));
            }
        }
        Ok(plans)
    }

    pub(crate) fn reply_timeout(&self) -> Duration {
        Duration::from_millis(self.reply_timeout_ms)
    }
    pub(crate) fn stop_timeout(&self) -> Duration {
        Duration::from_millis(self.stop_timeout_ms)
    }
    pub(crate) fn settle_timeout(&self) -> Duration {
        Duration::from_millis(self.settle_timeout_ms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const XY: &str = r#"{
        "kinematics": "specimen_xy_on_top", "positive_z": "apart", "coupled": false,
        "linear": [
            {"axis": "x", "name": "1", "repeatability_um": 0.2, "arrival_tolerance_um": 1},
            {"axis": "y", "name": "2", "repeatability_um": 0.2, "arrival_tolerance_um": 1}
        ]
    }"#;

    #[test]
    fn settings_of_an_xy_stage_are_read() {
        let settings: Gcs2Settings = serde_json::from_str(XY).unwrap();
        let plans = settings.plans().unwrap();
        assert_eq!(plans[1].name.as_str(), "2");
        assert!((plans[1].tolerance_si - 1e-6).abs() < 1e-18);
        assert_eq!(settings.reply_timeout_ms, 1000);
    }

    #[test]
    fn settings_that_make_no_sense_are_refused() {
        let typo = XY.replace("coupled", "cuopled");
        assert!(serde_json::from_str::<Gcs2Settings>(&typo).is_err());
        for (from, to) in [
            ("\"name\": \"2\"", "\"name\": \"1\""),
            ("\"axis\": \"y\"", "\"axis\": \"x\""),
            ("\"axis\": \"y\"", "\"axis\": \"rz\""),
            ("\"name\": \"2\"", "\"name\": \"2 3\""),
            ("\"arrival_tolerance_um\": 1", "\"arrival_tolerance_um\": 0"),
            ("\"repeatability_um\": 0.2", "\"repeatability_um\": -1"),
            (
                "\"coupled\": false",
                "\"coupled\": false, \"reply_timeout_ms\": 1",
            ),
        ] {
            let settings: Gcs2Settings = serde_json::from_str(&XY.replacen(from, to, 1)).unwrap();
            assert!(
                matches!(settings.plans(), Err(ScopeError::BadSetting { .. })),
                "{to}"
            );
        }
    }
}

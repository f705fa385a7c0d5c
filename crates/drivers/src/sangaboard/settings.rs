//! What the driver must be told about a stage, since the board counts only steps.

use crate::sangaboard::codec::MAX_STEPS;
use crate::session::bad_setting;
use scopeservo_scope::{Axis, AxisInfo, Kinematics, Length, PositiveZ, ScopeError};
use serde::Deserialize;

/// One motor of the board.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SangaAxis {
    /// How far the stage goes with one step. Negative for a motor that turns the other way round.
    pub um_per_step: f64,
    /// Lower end of travel, from the board's zero.
    pub min_um: f64,
    /// Upper end of travel, from the board's zero.
    pub max_um: f64,
    /// Half-width of the interval in which repeated arrivals at one place end.
    pub repeatability_um: f64,
    /// A move counts as arrived when the board counts a place this near to the goal: four times the repeatability without.
    #[serde(default)]
    pub arrival_tolerance_um: Option<f64>,
}

/// How a stage on a Sangaboard is set up. A motor that is not there has no entry.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SangaSettings {
    /// Which side moves.
    pub kinematics: Kinematics,
    /// What positive z does, on this microscope.
    pub positive_z: PositiveZ,
    /// The first motor.
    #[serde(default)]
    pub x: Option<SangaAxis>,
    /// The second motor.
    #[serde(default)]
    pub y: Option<SangaAxis>,
    /// The third motor.
    #[serde(default)]
    pub z: Option<SangaAxis>,
    /// How long the board may take to start: many do when a serial port is opened.
    #[serde(default = "two_seconds")]
    pub boot_ms: u64,
    /// How long one answer may take.
    #[serde(default = "second")]
    pub reply_timeout_ms: u64,
    /// How long the motors may go on after a stop.
    #[serde(default = "second")]
    pub stop_timeout_ms: u64,
}

fn second() -> u64 {
    1000
}
fn two_seconds() -> u64 {
    2000
}

impl SangaAxis {
    /// SI metres of a number of steps.
    pub(crate) fn si(&self, steps: i64) -> f64 {
        Length::from_um(steps as f64 * self.um_per_step).m()
    }
    /// The nearest number of steps to SI metres.
    pub(crate) fn steps(&self, si: f64) -> i64 {
        (Length::from_m(si).um() / self.um_per_step).round() as i64
    }

    fn info(&self, axis: Axis) -> Result<AxisInfo, ScopeError> {
        let numbers = [self.um_per_step, self.min_um, self.max_um];
        if numbers.iter().any(|v| !v.is_finite()) || self.um_per_step == 0.0 {
            return Err(bad_setting(format!("{axis}: um_per_step must not be zero")));
        }
        if self.min_um >= self.max_um {
            return Err(bad_setting(format!(
                "{axis}: min_um must be less than max_um"
            )));
        }
        let farthest = self.min_um.abs().max(self.max_um.abs()) / self.um_per_step.abs();
        if farthest >= MAX_STEPS as f64 {
            return Err(bad_setting(format!(
                "{axis}: the board cannot count {farthest} steps"
            )));
        }
        // No stepper comes nearer than half a step.
        let half = self.um_per_step.abs() / 2.0;
        if self.repeatability_um.is_nan() || self.repeatability_um < half {
            return Err(bad_setting(format!(
                "{axis}: repeatability_um must be at least half a step, {half} um"
            )));
        }
        let tolerance = self.arrival_tolerance_um;
        let info = AxisInfo {
            axis,
            min: Length::from_um(self.min_um).m(),
            max: Length::from_um(self.max_um).m(),
            repeatability: Length::from_um(self.repeatability_um).m(),
            arrival_tolerance: tolerance.map(|um| Length::from_um(um).m()),
        };
        info.check()?;
        Ok(info)
    }
}

impl SangaSettings {
    /// The motors in the board's order.
    pub(crate) fn motors(&self) -> [(Axis, Option<SangaAxis>); 3] {
        [
            (Axis::X, self.x.clone()),
            (Axis::Y, self.y.clone()),
            (Axis::Z, self.z.clone()),
        ]
    }

    /// The axes as the contract describes them, when everything makes sense.
    pub(crate) fn checked(&self) -> Result<Vec<AxisInfo>, ScopeError> {
        let motors = self.motors();
        let set = motors.iter().filter_map(|(a, m)| Some((a, m.as_ref()?)));
        let axes: Result<Vec<_>, _> = set.map(|(axis, motor)| motor.info(*axis)).collect();
        let axes = axes?;
        if axes.is_empty() {
            return Err(bad_setting("the settings name no axis"));
        }
        for (what, ms, least) in [
            ("boot_ms", self.boot_ms, 0),
            ("reply_timeout_ms", self.reply_timeout_ms, 10),
            ("stop_timeout_ms", self.stop_timeout_ms, 10),
        ] {
            if !(least..=60_000).contains(&ms) {
                return Err(bad_setting(format!("{what} must be from {least} to 60000")));
            }
        }
        Ok(axes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const Z: &str = r#"{
        "kinematics": "specimen_xy_on_top", "positive_z": "closer",
        "z": {"um_per_step": -0.05, "min_um": -1000, "max_um": 1000, "repeatability_um": 0.2}
    }"#;

    #[test]
    fn settings_of_a_focus_drive_are_read() {
        let settings: SangaSettings = serde_json::from_str(Z).unwrap();
        let axes = settings.checked().unwrap();
        assert_eq!(axes.len(), 1);
        assert_eq!(axes[0].axis, Axis::Z);
        let z = settings.z.unwrap();
        assert_eq!(z.steps(1e-6), -20);
        assert!((z.si(-20) - 1e-6).abs() < 1e-18);
    }

    #[test]
    fn settings_that_make_no_sense_are_refused() {
        let typo = Z.replace("um_per_step", "mm_per_step");
        assert!(serde_json::from_str::<SangaSettings>(&typo).is_err());
        for (from, to) in [
            ("\"um_per_step\": -0.05", "\"um_per_step\": 0"),
            ("\"um_per_step\": -0.05", "\"um_per_step\": 1e-9"),
            ("\"min_um\": -1000", "\"min_um\": 2000"),
            ("\"repeatability_um\": 0.2", "\"repeatability_um\": 0.02"),
            ("\"repeatability_um\": 0.2", "\"repeatability_um\": 51"),
            ("\"closer\",", "\"closer\", \"reply_timeout_ms\": 1,"),
        ] {
            let settings: SangaSettings = serde_json::from_str(&Z.replacen(from, to, 1)).unwrap();
            assert!(
                matches!(settings.checked(), Err(ScopeError::BadSetting { .. })),
                "{to}"
            );
        }
        let none = r#"{"kinematics": "specimen_xy_on_top", "positive_z": "closer"}"#;
        let settings: SangaSettings = serde_json::from_str(none).unwrap();
        assert!(settings.checked().is_err());
    }
}

//! What the driver must be told about a stage, since the board does not say it.

use crate::gcode::codec;
use crate::session::bad_setting;
use crate::turret::{self, Part, TurretPlace};
use scopeservo_scope::{Axis, AxisInfo, Kinematics, Length, PositiveZ, ScopeError};
use serde::Deserialize;
use std::collections::HashSet;

/// An axis that shifts.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GcodeAxis {
    /// Which of our axes it is: x, y or z.
    pub axis: Axis,
    /// The board's letter for it.
    pub letter: char,
    /// Lower end of travel, in the board's coordinates.
    pub min_um: f64,
    /// Upper end of travel, in the board's coordinates.
    pub max_um: f64,
    /// Steps for a millimetre, as the firmware counts them (M92).
    pub steps_per_mm: f64,
    /// Half-width of the interval in which repeated arrivals at one place end.
    pub repeatability_um: f64,
    /// A move counts as arrived when the board counts a place this near to the goal: four times the repeatability without.
    #[serde(default)]
    pub arrival_tolerance_um: Option<f64>,
}

/// A nosepiece on one of the board's steppers.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GcodeNosepiece {
    /// The board's letter for it. The position that the board reports (M114) must count its steps.
    pub letter: char,
    /// Steps for a degree, as the firmware counts them (M92).
    pub steps_per_deg: f64,
    /// Speed of every change.
    pub speed_deg_per_s: f64,
    /// Whether it has a switch that tells where it is; the first change then looks for it. `false`: it stood at 0 when the board
    /// was switched on, and an image must show that this is so.
    pub needs_homing: bool,
    /// An objective counts as active when the axis stands this near to its place.
    pub arrival_tolerance_deg: f64,
    /// The objectives.
    pub objectives: Vec<TurretPlace>,
}

/// How a stage on a G-code board is set up, or a nosepiece, or both.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GcodeSettings {
    /// Which side moves. Needed where there are axes.
    pub kinematics: Option<Kinematics>,
    /// What positive z does, on this microscope. Needed where there are axes.
    pub positive_z: Option<PositiveZ>,
    /// The axes of the stage.
    #[serde(default)]
    pub axes: Vec<GcodeAxis>,
    /// The nosepiece.
    pub nosepiece: Option<GcodeNosepiece>,
    /// Speed of every move of the stage.
    #[serde(default = "millimetre")]
    pub speed_um_per_s: f64,
    /// Whether positions mean nothing until the stage was homed. `false` for a stage without end switches, whose zero is
    /// where it stood when the board started.
    #[serde(default = "yes")]
    pub needs_homing: bool,
    /// Whether to drive a board that does not report EMERGENCY_PARSER. A stop then waits until the board reads its next
    /// line, which it may not do while it homes.
    #[serde(default)]
    pub allow_queued_stop: bool,
    /// Whether commands are sent with numbers and checksums, so that a damaged one is not obeyed.
    #[serde(default = "yes")]
    pub checksums: bool,
    /// How long the board may take to start: many do when a serial port is opened.
    #[serde(default = "three_seconds")]
    pub boot_ms: u64,
    /// How long one answer may take, or the next sign that the board is busy with it.
    #[serde(default = "three_seconds")]
    pub reply_timeout_ms: u64,
    /// How long the board may be busy with one command, homing aside.
    #[serde(default = "half_a_minute")]
    pub busy_timeout_ms: u64,
    /// How long homing may take.
    #[serde(default = "two_minutes")]
    pub homing_timeout_ms: u64,
    /// How long the steppers may go on after a stop.
    #[serde(default = "second")]
    pub stop_timeout_ms: u64,
    /// A move whose steppers have not moved for so long has ended.
    #[serde(default = "second")]
    pub stall_timeout_ms: u64,
}

fn yes() -> bool {
    true
}
fn millimetre() -> f64 {
    1000.0
}
fn second() -> u64 {
    1000
}
fn three_seconds() -> u64 {
    3000
}
fn half_a_minute() -> u64 {
    30_000
}
fn two_minutes() -> u64 {
    120_000
}

/// A stepper, in the board's units: millimetres for an axis of the stage, degrees for the nosepiece.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Motor {
    /// `None` for the nosepiece.
    pub(crate) axis: Option<Axis>,
    pub(crate) letter: char,
    pub(crate) steps_per_unit: f64,
}

impl Motor {
    /// The board's units of a number of steps.
    pub(crate) fn units(&self, steps: i64) -> f64 {
        steps as f64 / self.steps_per_unit
    }
    /// The nearest number of steps to a place in the board's units.
    pub(crate) fn steps(&self, units: f64) -> i64 {
        (units * self.steps_per_unit).round() as i64
    }
    /// What it moves.
    pub(crate) fn part(&self) -> Part {
        match self.axis {
            Some(_) => Part::Stage,
            None => Part::Nosepiece,
        }
    }
}

impl GcodeSettings {
    /// The steppers: those of the stage, then that of the nosepiece.
    pub(crate) fn motors(&self) -> Vec<Motor> {
        let axis = |a: &GcodeAxis| Motor {
            axis: Some(a.axis),
            letter: a.letter,
            steps_per_unit: a.steps_per_mm,
        };
        let nosepiece = |n: &GcodeNosepiece| Motor {
            axis: None,
            letter: n.letter,
            steps_per_unit: n.steps_per_deg,
        };
        let nosepiece = self.nosepiece.iter().map(nosepiece);
        self.axes.iter().map(axis).chain(nosepiece).collect()
    }

    /// The axes as the contract describes them, when everything makes sense.
    pub(crate) fn checked(&self) -> Result<Vec<AxisInfo>, ScopeError> {
        let motors = self.motors();
        if motors.is_empty() {
            return Err(bad_setting("the settings name no axis and no nosepiece"));
        }
        if !self.axes.is_empty() && (self.kinematics.is_none() || self.positive_z.is_none()) {
            return Err(bad_setting(
                "a stage needs kinematics (which side moves) and positive_z (what larger z does)",
            ));
        }
        let axes: HashSet<_> = motors.iter().map(|m| m.axis).collect();
        let letters: HashSet<_> = motors.iter().map(|m| m.letter).collect();
        if axes.len() != motors.len() || letters.len() != motors.len() {
            return Err(bad_setting(
                "an axis or a letter stands in the settings twice",
            ));
        }
        if let Some(nosepiece) = &self.nosepiece {
            check_nosepiece(nosepiece)?;
        }
        if !(self.speed_um_per_s.is_finite() && self.speed_um_per_s > 0.0) {
            return Err(bad_setting("speed_um_per_s must be positive"));
        }
        for (what, ms, least) in [
            ("boot_ms", self.boot_ms, 0),
            ("reply_timeout_ms", self.reply_timeout_ms, 10),
            ("busy_timeout_ms", self.busy_timeout_ms, 10),
            ("homing_timeout_ms", self.homing_timeout_ms, 10),
            ("stop_timeout_ms", self.stop_timeout_ms, 10),
            ("stall_timeout_ms", self.stall_timeout_ms, 10),
        ] {
            if !(least..=600_000).contains(&ms) {
                return Err(bad_setting(format!(
                    "{what} must be from {least} to 600000"
                )));
            }
        }
        self.axes.iter().map(info).collect()
    }
}

fn check_nosepiece(nosepiece: &GcodeNosepiece) -> Result<(), ScopeError> {
    codec::axis(nosepiece.letter).map_err(|e| bad_setting(format!("the nosepiece: {e}")))?;
    let positive = |v: f64| v.is_finite() && v > 0.0;
    if !positive(nosepiece.steps_per_deg) || !positive(nosepiece.speed_deg_per_s) {
        return Err(bad_setting(
            "the nosepiece: steps_per_deg and speed_deg_per_s must be above 0",
        ));
    }
    // No stepper comes nearer than half a step.
    if nosepiece.arrival_tolerance_deg < 0.5 / nosepiece.steps_per_deg {
        return Err(bad_setting(format!(
            "the nosepiece: arrival_tolerance_deg must be at least half a step, {} deg",
            0.5 / nosepiece.steps_per_deg
        )));
    }
    turret::check(&nosepiece.objectives, nosepiece.arrival_tolerance_deg)
}

fn info(axis: &GcodeAxis) -> Result<AxisInfo, ScopeError> {
    let name = axis.axis;
    if name.is_rotation() {
        return Err(bad_setting(format!(
            "{name}: only x, y and z are supported"
        )));
    }
    codec::axis(axis.letter).map_err(|e| bad_setting(format!("{name}: {e}")))?;
    let numbers = [axis.min_um, axis.max_um, axis.steps_per_mm];
    let finite = numbers.iter().all(|v| v.is_finite() && v.abs() < 1e9);
    if !finite || axis.min_um >= axis.max_um {
        return Err(bad_setting(format!(
            "{name}: min_um must be less than max_um"
        )));
    }
    if axis.steps_per_mm <= 0.0 {
        return Err(bad_setting(format!(
            "{name}: steps_per_mm must be positive"
        )));
    }
    // No stepper comes nearer than half a step.
    if axis.repeatability_um.is_nan() || axis.repeatability_um < 500.0 / axis.steps_per_mm {
        return Err(bad_setting(format!(
            "{name}: repeatability_um must be at least half a step, {} um",
            500.0 / axis.steps_per_mm
        )));
    }
    let info = AxisInfo {
        axis: name,
        min: Length::from_um(axis.min_um).m(),
        max: Length::from_um(axis.max_um).m(),
        repeatability: Length::from_um(axis.repeatability_um).m(),
        arrival_tolerance: axis.arrival_tolerance_um.map(|um| Length::from_um(um).m()),
    };
    info.check()?;
    Ok(info)
}

#[cfg(test)]
mod tests {
    use super::*;

    const XY: &str = r#"{
        "kinematics": "specimen_xy_on_top", "positive_z": "apart", "speed_um_per_s": 2000, "needs_homing": true,
        "axes": [
            {"axis": "x", "letter": "X", "min_um": 0, "max_um": 50000, "steps_per_mm": 400, "repeatability_um": 5},
            {"axis": "y", "letter": "Y", "min_um": -1, "max_um": 50000, "steps_per_mm": 400, "repeatability_um": 5}
        ]
    }"#;

    #[test]
    fn settings_of_an_xy_stage_are_read() {
        let settings: GcodeSettings = serde_json::from_str(XY).unwrap();
        let axes = settings.checked().unwrap();
        assert!((axes[0].max - 0.05).abs() < 1e-12);
        let x = &settings.motors()[0];
        assert_eq!(x.steps(1.0), 400);
        assert!((x.units(-400) + 1.0).abs() < 1e-12);
        assert!(settings.checksums && !settings.allow_queued_stop);
    }

    #[test]
    fn settings_that_make_no_sense_are_refused() {
        let typo = XY.replace("needs_homing", "need_homing");
        assert!(serde_json::from_str::<GcodeSettings>(&typo).is_err());
        for (from, to) in [
            ("\"letter\": \"Y\"", "\"letter\": \"X\""),
            ("\"letter\": \"Y\"", "\"letter\": \"F\""),
            ("\"axis\": \"y\"", "\"axis\": \"rz\""),
            ("\"min_um\": -1", "\"min_um\": 60000"),
            ("\"steps_per_mm\": 400", "\"steps_per_mm\": 0"),
            ("\"repeatability_um\": 5", "\"repeatability_um\": 1"),
            ("\"repeatability_um\": 5", "\"repeatability_um\": 51"),
            (
                "\"repeatability_um\": 5",
                "\"repeatability_um\": 5, \"arrival_tolerance_um\": 0",
            ),
            ("\"speed_um_per_s\": 2000", "\"speed_um_per_s\": -1"),
            (
                "\"needs_homing\": true",
                "\"needs_homing\": true, \"stop_timeout_ms\": 0",
            ),
            ("\"positive_z\": \"apart\",", ""),
        ] {
            let settings: GcodeSettings = serde_json::from_str(&XY.replacen(from, to, 1)).unwrap();
            assert!(
                matches!(settings.checked(), Err(ScopeError::BadSetting { .. })),
                "{to}"
            );
        }
    }

    #[test]
    fn a_nosepiece_stands_beside_a_stage_or_alone() {
        let alone = r#"{"nosepiece": {
            "letter": "A", "steps_per_deg": 10, "speed_deg_per_s": 90, "needs_homing": true, "arrival_tolerance_deg": 0.2,
            "objectives": [
                {"id": "10x", "magnification": 100, "numerical_aperture": 0.25, "um_per_px": 2.2, "at_deg": 0},
                {"id": "40x", "magnification": 400, "numerical_aperture": 0.65, "um_per_px": 0.5, "at_deg": 120}
            ]
        }}"#;
        let read = |text: &str| serde_json::from_str::<GcodeSettings>(text).unwrap();
        let settings = read(alone);
        assert_eq!(settings.checked(), Ok(Vec::new()));
        assert_eq!(settings.motors()[0].steps(120.0), 1200);
        let both = GcodeSettings {
            nosepiece: settings.nosepiece.clone(),
            ..read(XY)
        };
        assert_eq!(both.checked().unwrap().len(), 2);
        assert_eq!(both.motors().len(), 3);
        assert!(read("{}").checked().is_err());
        for (from, to) in [
            ("\"letter\": \"A\"", "\"letter\": \"F\""),
            ("\"steps_per_deg\": 10", "\"steps_per_deg\": 0"),
            ("\"steps_per_deg\": 10", "\"steps_per_deg\": 1"),
            ("\"speed_deg_per_s\": 90", "\"speed_deg_per_s\": -1"),
            ("\"at_deg\": 120", "\"at_deg\": 0.3"),
        ] {
            assert!(
                read(&alone.replacen(from, to, 1)).checked().is_err(),
                "{to}"
            );
        }
        let same = alone.replace("\"letter\": \"A\"", "\"letter\": \"X\"");
        let same = GcodeSettings {
            nosepiece: read(&same).nosepiece,
            ..read(XY)
        };
        assert!(same.checked().is_err());
    }
}

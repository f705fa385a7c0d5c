//! The stage: what moves, and how it is asked to.

use crate::{Axis, ScopeError, StagePose};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Which side moves, and in which order the axes are stacked. This decides how a move changes the image; the
/// equations are in CONVENTIONS.md.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kinematics {
    /// The stage carries the microscope over a resting specimen.
    MovesMicroscope,
    /// The stage carries the specimen; its rotation sits on top of x and y.
    SpecimenRotationOnTop,
    /// The stage carries the specimen; x and y sit on top of the rotation.
    SpecimenXyOnTop,
}

/// What positive z does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PositiveZ {
    /// Brings objective and specimen closer together.
    Closer,
    /// Takes them apart.
    Apart,
}

/// One axis of a stage, in SI units (m, rad).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AxisInfo {
    /// Which axis.
    pub axis: Axis,
    /// Lower end of travel.
    pub min: f64,
    /// Upper end of travel.
    pub max: f64,
    /// Half-width of the interval in which repeated arrivals at one place end.
    pub repeatability: f64,
    /// How far from its goal the axis may say that it has settled, where its driver states that.
    #[serde(default)]
    pub arrival_tolerance: Option<f64>,
}

/// What is nearer than this is the same place, whatever the axis repeats to: 1 um.
const LEAST_M: f64 = 1e-6;
/// The same for rotations: 0.005 deg.
const LEAST_RAD: f64 = 0.005 * std::f64::consts::PI / 180.0;
/// Arrivals that scatter by more are no stage's of a microscope, but a unit's that is wrong: 50 um.
const WORST_M: f64 = 50e-6;
/// The same for rotations: 1 deg.
const WORST_RAD: f64 = std::f64::consts::PI / 180.0;
/// The same as a share of the travel.
const WORST_SHARE: f64 = 0.1;
/// An arrival is judged by so many times the repeatability. A stepper states at least half a step, so this is two steps of it or more.
const SCATTERS: f64 = 4.0;

impl AxisInfo {
    /// Standard deviation of where an arrival ends, m or rad. Makers state an interval that holds all arrivals, without saying how they lie
    /// in it; taken as even there, it is the half-width over the square root of 3. (A unidirectional repeatability R by ISO 230-2 is four
    /// standard deviations wide, so that a half-width of R / 2 would be two; this is the more careful reading.)
    pub fn standard_deviation(&self) -> f64 {
        self.repeatability / 3f64.sqrt()
    }

    /// How far from a place the axis may say that it is and still be there, m or rad: what its driver states, or four times its
    /// repeatability, at least 1 um or 0.005 deg. Goals, limits and zones are all judged by it.
    pub fn tolerance(&self) -> f64 {
        let least = if self.axis.is_rotation() {
            LEAST_RAD
        } else {
            LEAST_M
        };
        self.arrival_tolerance
            .unwrap_or((SCATTERS * self.repeatability).max(least))
    }

    /// How far beyond a height a retreat goes, so that it ends beyond it whatever the axis scatters, m: four times its
    /// repeatability, at least 1 um.
    pub fn clearance(&self) -> f64 {
        (SCATTERS * self.repeatability).max(LEAST_M)
    }

    /// Whether the numbers of this axis are possible.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`].
    pub fn check(&self) -> Result<(), ScopeError> {
        let (axis, unit) = (self.axis, self.axis.display_unit());
        let bad = |what: String| Err(ScopeError::BadSetting { what });
        if !(self.min <= self.max && self.min.is_finite() && self.max.is_finite()) {
            return bad(format!("{axis} must have its min below its max"));
        }
        let worst = if axis.is_rotation() {
            WORST_RAD
        } else {
            WORST_M
        };
        let most = worst.min(WORST_SHARE * (self.max - self.min));
        let shown = |si: f64| format!("{} {unit}", (axis.to_display(si) * 1e6).round() / 1e6);
        // What is no number is not known to be small.
        if !(0.0..=most).contains(&self.repeatability) {
            return bad(format!(
                "the repeatability of {axis} is {}; it must not be negative, and {} is the most that is believed: {} or a tenth of the \
                 travel. Look at its unit: it is the half-width of the interval in which arrivals end, in {unit}",
                shown(self.repeatability),
                shown(most),
                shown(worst),
            ));
        }
        if let Some(tolerance) = self.arrival_tolerance
            && !(tolerance > 0.0 && tolerance <= SCATTERS * most)
        {
            return bad(format!(
                "the arrival tolerance of {axis} is {}; it must be above 0 and at most {}. Look at its unit: {unit}",
                shown(tolerance),
                shown(SCATTERS * most),
            ));
        }
        Ok(())
    }
}

/// What a stage is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageInfo {
    /// Maker and model, for people.
    pub name: String,
    /// The axes it has. Those not listed are missing.
    pub axes: Vec<AxisInfo>,
    /// Which side moves.
    pub kinematics: Kinematics,
    /// What positive z does.
    pub positive_z: PositiveZ,
}

impl StageInfo {
    /// The description of one axis, if the stage has it.
    pub fn axis(&self, axis: Axis) -> Option<&AxisInfo> {
        self.axes.iter().find(|info| info.axis == axis)
    }

    /// Whether a goal names axes that there are, with numbers.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchAxis`], [`ScopeError::NotFinite`].
    pub fn check_axes(&self, to: &StagePose) -> Result<(), ScopeError> {
        for axis in Axis::ALL {
            match (to.si(axis), self.axis(axis)) {
                (None, _) => {}
                (Some(_), None) => return Err(ScopeError::NoSuchAxis { axis }),
                (Some(asked), Some(_)) if !asked.is_finite() => {
                    return Err(ScopeError::NotFinite { axis });
                }
                (Some(_), Some(_)) => {}
            }
        }
        Ok(())
    }

    /// Whether a goal lies within the travel: what every stage refuses by itself, whatever its gate allows.
    ///
    /// # Errors
    /// Those of [`StageInfo::check_axes`]; [`ScopeError::OutsideLimits`].
    pub fn check_goal(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.check_axes(to)?;
        for AxisInfo { axis, min, max, .. } in &self.axes {
            if let Some(asked) = to.si(*axis)
                && (asked < *min || asked > *max)
            {
                return Err(ScopeError::OutsideLimits {
                    axis: *axis,
                    asked: axis.to_display(asked),
                    min: axis.to_display(*min),
                    max: axis.to_display(*max),
                });
            }
        }
        Ok(())
    }
}

/// What a moving device is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Motion {
    /// Under way, or settling.
    Moving,
    /// At its goal, settled.
    Settled,
    /// Ended before its goal, by `stop` or by itself.
    Stopped,
}

/// A motorised stage. A move is started and polled; `stop` works from any thread at any time.
pub trait Stage: Send + Sync {
    /// What this stage is.
    fn info(&self) -> &StageInfo;
    /// Where the stage says it is, all of its axes, also during motion.
    fn position(&self) -> Result<StagePose, ScopeError>;
    /// Starts a move of all given axes together and returns at once. Refused while another move runs.
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError>;
    /// The same at a speed along the way, m/s, where it is below the usual one, which is back for the next move. A stage that has one speed, or one
    /// speed for such a move, refuses, and nothing moves.
    fn start_move_at(&self, _to: &StagePose, _m_per_s: f64) -> Result<(), ScopeError> {
        Err(ScopeError::Refused {
            device: "stage",
            detail: "its speed cannot be chosen".into(),
        })
    }
    /// Whether it knows speeds at all, so that it is worth asking [`Stage::start_move_at`].
    fn knows_speeds(&self) -> bool {
        false
    }
    /// What the stage is doing.
    fn poll(&self) -> Result<Motion, ScopeError>;
    /// Stops at once, wherever it is. Harmless when nothing moves.
    fn stop(&self) -> Result<(), ScopeError>;
    /// Whether it knows where it is. While it does not, moves are refused with [`ScopeError::NotHomed`].
    fn is_homed(&self) -> Result<bool, ScopeError> {
        Ok(true)
    }
    /// Starts to find its reference, which may move anything anywhere, and returns at once; [`Stage::poll`] tells when it is over.
    fn start_homing(&self) -> Result<(), ScopeError> {
        Err(ScopeError::Refused {
            device: "stage",
            detail: "it has no reference to find".into(),
        })
    }
}

/// Whether a stage can go so fast, m/s.
///
/// # Errors
/// [`ScopeError::BadSetting`] unless it is a number above 0.
pub fn check_speed(m_per_s: f64) -> Result<(), ScopeError> {
    match m_per_s > 0.0 && m_per_s.is_finite() {
        true => Ok(()),
        false => Err(ScopeError::BadSetting {
            what: format!("a speed is above 0; {m_per_s} m/s was asked for"),
        }),
    }
}

/// A stage that is kept in two places: by its gate, and by what turns a nosepiece on the same controller.
impl<T: Stage + ?Sized> Stage for Arc<T> {
    fn info(&self) -> &StageInfo {
        (**self).info()
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        (**self).position()
    }
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        (**self).start_move(to)
    }
    fn start_move_at(&self, to: &StagePose, m_per_s: f64) -> Result<(), ScopeError> {
        (**self).start_move_at(to, m_per_s)
    }
    fn knows_speeds(&self) -> bool {
        (**self).knows_speeds()
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        (**self).poll()
    }
    fn stop(&self) -> Result<(), ScopeError> {
        (**self).stop()
    }
    fn is_homed(&self) -> Result<bool, ScopeError> {
        (**self).is_homed()
    }
    fn start_homing(&self) -> Result<(), ScopeError> {
        (**self).start_homing()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(repeatability_um: f64, travel_um: f64) -> AxisInfo {
        AxisInfo {
            axis: Axis::Z,
            min: 0.0,
            max: travel_um * 1e-6,
            repeatability: repeatability_um * 1e-6,
            arrival_tolerance: None,
        }
    }

    #[test]
    fn an_arrival_is_judged_by_four_scatters_and_a_micrometre_at_least() {
        assert_eq!(axis(0.0, 1e3).tolerance(), 1e-6);
        assert!((axis(5.0, 1e3).tolerance() - 20e-6).abs() < 1e-12);
        let stated = AxisInfo {
            arrival_tolerance: Some(3e-6),
            ..axis(5.0, 1e3)
        };
        assert_eq!(stated.tolerance(), 3e-6);
        // However little the axis claims to need, a retreat goes past what it scatters.
        assert!((stated.clearance() - 20e-6).abs() < 1e-12);
        let turns = AxisInfo {
            axis: Axis::Rz,
            ..axis(0.0, 1e6)
        };
        assert!((Axis::Rz.to_display(turns.tolerance()) - 0.005).abs() < 1e-12);
    }

    #[test]
    fn a_repeatability_above_50_um_or_a_tenth_of_the_travel_is_refused() {
        for (repeatability_um, travel_um, believed) in [
            (0.0, 1.0, true),
            (50.0, 1e4, true),
            (50.1, 1e4, false),
            (600.0, 4e4, false),
            (10.0, 100.0, true),
            (10.1, 100.0, false),
            (1.0, 1.0, false),
            (-1.0, 1e4, false),
            (f64::NAN, 1e4, false),
        ] {
            let answer = axis(repeatability_um, travel_um).check();
            assert_eq!(answer.is_ok(), believed, "{repeatability_um} {answer:?}");
        }
        for tolerance in [0.0, -1e-6, f64::NAN, 201e-6] {
            let stated = AxisInfo {
                arrival_tolerance: Some(tolerance),
                ..axis(5.0, 1e4)
            };
            assert!(stated.check().is_err(), "{tolerance}");
        }
    }

    #[test]
    fn people_read_micrometres_and_degrees() {
        assert!((Axis::X.to_display(1e-6) - 1.0).abs() < 1e-12);
        assert!((Axis::Rz.to_display(std::f64::consts::PI) - 180.0).abs() < 1e-12);
        for axis in Axis::ALL {
            assert!((axis.to_display(axis.from_display(0.3)) - 0.3).abs() < 1e-12);
        }
    }
}

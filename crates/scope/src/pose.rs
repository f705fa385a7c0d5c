//! Axes, and where a stage is on them.

use crate::{Angle, Length};
use serde::{Deserialize, Serialize};
use std::fmt;

/// One of six axes. Rotations are right-handed about the axis of the same letter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Axis {
    /// Translation along x.
    X,
    /// Translation along y.
    Y,
    /// Focus.
    Z,
    /// Rotation about x.
    Rx,
    /// Rotation about y.
    Ry,
    /// Rotation about z, in the specimen plane.
    Rz,
}

impl Axis {
    /// All six.
    pub const ALL: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::Rx, Axis::Ry, Axis::Rz];

    /// Whether the axis turns (radians) rather than shifts (metres).
    pub fn is_rotation(self) -> bool {
        matches!(self, Axis::Rx | Axis::Ry | Axis::Rz)
    }

    /// The unit people read for this axis: "um" or "deg".
    pub fn display_unit(self) -> &'static str {
        if self.is_rotation() { "deg" } else { "um" }
    }

    /// An SI value (m or rad) in the display unit (um or deg).
    pub fn to_display(self, si: f64) -> f64 {
        if self.is_rotation() {
            Angle::from_rad(si).deg()
        } else {
            Length::from_m(si).um()
        }
    }

    /// The SI value (m or rad) of one in the display unit (um or deg).
    pub fn from_display(self, shown: f64) -> f64 {
        if self.is_rotation() {
            Angle::from_deg(shown).rad()
        } else {
            Length::from_um(shown).m()
        }
    }
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Axis::X => "x",
            Axis::Y => "y",
            Axis::Z => "z",
            Axis::Rx => "rotation about x",
            Axis::Ry => "rotation about y",
            Axis::Rz => "rotation about z",
        })
    }
}

/// An absolute place of the stage, in the stage's own coordinates. A missing axis is one that the stage does not
/// have, or, in a request, one to leave where it is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct StagePose {
    /// x.
    pub x: Option<Length>,
    /// y.
    pub y: Option<Length>,
    /// Focus.
    pub z: Option<Length>,
    /// Rotation about x.
    pub rx: Option<Angle>,
    /// Rotation about y.
    pub ry: Option<Angle>,
    /// Rotation about z.
    pub rz: Option<Angle>,
}

impl StagePose {
    /// The value of one axis in SI units: metres or radians.
    pub fn si(&self, axis: Axis) -> Option<f64> {
        match axis {
            Axis::X => self.x.map(Length::m),
            Axis::Y => self.y.map(Length::m),
            Axis::Z => self.z.map(Length::m),
            Axis::Rx => self.rx.map(Angle::rad),
            Axis::Ry => self.ry.map(Angle::rad),
            Axis::Rz => self.rz.map(Angle::rad),
        }
    }

    /// This pose, with the axes that it lacks taken from another one.
    #[must_use]
    pub fn or(&self, other: &StagePose) -> Self {
        Self {
            x: self.x.or(other.x),
            y: self.y.or(other.y),
            z: self.z.or(other.z),
            rx: self.rx.or(other.rx),
            ry: self.ry.or(other.ry),
            rz: self.rz.or(other.rz),
        }
    }

    /// The same pose with one axis set, in SI units: metres or radians.
    #[must_use]
    pub fn with_si(mut self, axis: Axis, value: f64) -> Self {
        match axis {
            Axis::X => self.x = Some(Length::from_m(value)),
            Axis::Y => self.y = Some(Length::from_m(value)),
            Axis::Z => self.z = Some(Length::from_m(value)),
            Axis::Rx => self.rx = Some(Angle::from_rad(value)),
            Axis::Ry => self.ry = Some(Angle::from_rad(value)),
            Axis::Rz => self.rz = Some(Angle::from_rad(value)),
        }
        self
    }
}

impl fmt::Display for StagePose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut between = "";
        for axis in Axis::ALL {
            if let Some(si) = self.si(axis) {
                // Nothing has no sign.
                let shown = (axis.to_display(si) * 100.0).round() / 100.0 + 0.0;
                write!(f, "{between}{axis} = {shown:.2} {}", axis.display_unit())?;
                between = ", ";
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_that_is_nearly_nothing_is_shown_without_a_sign() {
        for (um, shown) in [
            (-0.001, "0.00"),
            (-0.0, "0.00"),
            (0.004, "0.00"),
            (-0.006, "-0.01"),
            (-3.1, "-3.10"),
        ] {
            let pose = StagePose::default().with_si(Axis::X, um * 1e-6);
            assert_eq!(pose.to_string(), format!("x = {shown} um"));
        }
    }

    #[test]
    fn every_axis_is_set_and_read_in_si_units() {
        let mut pose = StagePose::default();
        for (i, axis) in Axis::ALL.into_iter().enumerate() {
            assert_eq!(pose.si(axis), None);
            pose = pose.with_si(axis, i as f64 + 0.5);
        }
        for (i, axis) in Axis::ALL.into_iter().enumerate() {
            assert_eq!(pose.si(axis), Some(i as f64 + 0.5));
        }
    }
}

//! Lengths and angles. The unit is part of every constructor and every getter.

use serde::{Deserialize, Serialize};
use std::ops::{Add, Mul, Neg, Sub};

macro_rules! quantity {
    ($name:ident) => {
        impl Add for $name {
            type Output = Self;
            fn add(self, other: Self) -> Self {
                Self(self.0 + other.0)
            }
        }
        impl Sub for $name {
            type Output = Self;
            fn sub(self, other: Self) -> Self {
                Self(self.0 - other.0)
            }
        }
        impl Neg for $name {
            type Output = Self;
            fn neg(self) -> Self {
                Self(-self.0)
            }
        }
        impl Mul<f64> for $name {
            type Output = Self;
            fn mul(self, factor: f64) -> Self {
                Self(self.0 * factor)
            }
        }
    };
}

/// A length, stored in metres.
#[derive(Debug, Clone, Copy, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Length(f64);

impl Length {
    /// From metres.
    pub const fn from_m(m: f64) -> Self {
        Self(m)
    }
    /// From micrometres.
    pub fn from_um(um: f64) -> Self {
        Self(um * 1e-6)
    }
    /// In metres.
    pub const fn m(self) -> f64 {
        self.0
    }
    /// In micrometres.
    pub fn um(self) -> f64 {
        self.0 * 1e6
    }
}
quantity!(Length);

/// An angle, stored in radians. Nothing wraps it: a stage may turn more than once.
#[derive(Debug, Clone, Copy, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Angle(f64);

impl Angle {
    /// From radians.
    pub const fn from_rad(rad: f64) -> Self {
        Self(rad)
    }
    /// From degrees.
    pub fn from_deg(deg: f64) -> Self {
        Self(deg.to_radians())
    }
    /// In radians.
    pub const fn rad(self) -> f64 {
        self.0
    }
    /// In degrees.
    pub fn deg(self) -> f64 {
        self.0.to_degrees()
    }
}
quantity!(Angle);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_micrometre_is_a_millionth_of_a_metre() {
        assert_eq!(Length::from_um(2.0).m(), 2e-6);
        assert!((Length::from_m(0.125).um() - 125_000.0).abs() < 1e-9);
    }

    #[test]
    fn half_a_turn_is_pi() {
        assert!((Angle::from_deg(180.0).rad() - std::f64::consts::PI).abs() < 1e-15);
        assert!((Angle::from_rad(1.0).deg() - 57.295_779_513).abs() < 1e-6);
    }

    #[test]
    fn arithmetic_keeps_the_unit() {
        let sum = Length::from_um(3.0) + Length::from_um(4.0) * 2.0 - Length::from_um(1.0);
        assert!((sum.um() - 10.0).abs() < 1e-9);
        assert!(((-Angle::from_deg(5.0)).deg() + 5.0).abs() < 1e-12);
    }
}

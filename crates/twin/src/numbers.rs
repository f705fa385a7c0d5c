//! What the numbers of a description must be.

use crate::TwinError;

pub(crate) fn require(holds: bool, what: &str) -> Result<(), TwinError> {
    if holds {
        Ok(())
    } else {
        Err(TwinError::BadConfig { what: what.into() })
    }
}

pub(crate) fn finite(values: &[f64]) -> bool {
    values.iter().all(|v| v.is_finite())
}

pub(crate) fn positive(values: &[f64]) -> bool {
    finite(values) && values.iter().all(|&v| v > 0.0)
}

pub(crate) fn not_negative(values: &[f64]) -> bool {
    finite(values) && values.iter().all(|&v| v >= 0.0)
}

pub(crate) fn fraction(value: f64) -> bool {
    (0.0..=1.0).contains(&value)
}

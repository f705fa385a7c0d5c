//! The light: what makes the specimen bright.

use crate::ScopeError;

/// A light whose level can be set. Where an instrument has none, whoever sits at it sees to the light.
pub trait Light: Send + Sync {
    /// The level in force, 0 to 1.
    fn level(&self) -> Result<f64, ScopeError>;
    /// Sets the level, 0 to 1 ([`check_level`]), and returns the one in force.
    fn set_level(&self, level: f64) -> Result<f64, ScopeError>;
}

/// Whether a light can have this level.
///
/// # Errors
/// [`ScopeError::BadSetting`] outside 0 to 1.
pub fn check_level(level: f64) -> Result<(), ScopeError> {
    match (0.0..=1.0).contains(&level) {
        true => Ok(()),
        false => Err(ScopeError::BadSetting {
            what: format!("a light level is 0 to 1; {level} was asked for"),
        }),
    }
}

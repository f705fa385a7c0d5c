//! What a controller keeps and can be told: the pivot of a hexapod and its velocities.

use crate::gcs2::codec::{self, AxisName, Command};
use crate::gcs2::stage::Gcs2Stage;
use crate::gcs2::talk::{ask, error_number, read, refusal, values};
use crate::gcs2::unit::Unit;
use crate::session::bad_setting;
use scopeservo_scope::{Axis, Length, ScopeError};

impl Gcs2Stage {
    /// The point that the platform turns about.
    ///
    /// # Errors
    /// [`ScopeError::Timeout`] or [`ScopeError::Device`] when the controller does not answer as it should, and while a reference move
    /// runs [`ScopeError::Busy`].
    pub fn pivot(&self) -> Result<[Length; 3], ScopeError> {
        let mut ex = self.exchange_unless_homing()?;
        let names = ["X", "Y", "Z"].map(AxisName::new);
        let names: Result<Vec<_>, _> = names.into_iter().collect();
        let names = read(&ex, names)?;
        let at = values(&mut ex, &Command::Pivot, &names)?;
        let unit = self.length_unit();
        Ok([0, 1, 2].map(|i| Length::from_um(unit.si(at[i]) * 1e6)))
    }

    /// Sets the point that the platform turns about. The controller allows it only while all rotations are zero.
    ///
    /// # Errors
    /// [`ScopeError::Device`] with the controller's reason, and as [`Gcs2Stage::pivot`].
    pub fn set_pivot(&self, point: [Length; 3]) -> Result<(), ScopeError> {
        let unit = self.length_unit();
        self.set(&Command::SetPivot(point.map(|p| unit.of_si(p.m()))))
    }

    /// The velocity of a hexapod's platform.
    ///
    /// # Errors
    /// As [`Gcs2Stage::pivot`].
    pub fn platform_velocity_um_per_s(&self) -> Result<f64, ScopeError> {
        let mut ex = self.exchange_unless_homing()?;
        let lines = ask(&mut ex, &Command::PlatformVelocity)?;
        let velocity = read(&ex, codec::decode_number("VLS?", &lines))?;
        Ok(1e6 * self.length_unit().si(velocity))
    }

    /// Sets the velocity of a hexapod's platform.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] unless it is positive, [`ScopeError::Device`] with the controller's reason, and as
    /// [`Gcs2Stage::pivot`].
    pub fn set_platform_velocity_um_per_s(&self, velocity: f64) -> Result<(), ScopeError> {
        positive(velocity)?;
        let velocity = self.length_unit().of_si(velocity * 1e-6);
        self.set(&Command::SetPlatformVelocity(velocity))
    }

    /// The velocity of one axis of its own, m/s or rad/s.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchAxis`], and as [`Gcs2Stage::pivot`].
    pub fn velocity_si(&self, axis: Axis) -> Result<f64, ScopeError> {
        let plan = self.plan(axis)?;
        let mut ex = self.exchange_unless_homing()?;
        let names = [plan.name.clone()];
        let answer = values(&mut ex, &Command::Velocities(&names), &names)?;
        Ok(plan.si(answer[0]))
    }

    /// Sets the velocity of one axis of its own, m/s or rad/s.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchAxis`]; [`ScopeError::BadSetting`] unless the velocity is positive; [`ScopeError::Device`]
    /// with the controller's reason; and as [`Gcs2Stage::pivot`].
    pub fn set_velocity_si(&self, axis: Axis, velocity: f64) -> Result<(), ScopeError> {
        let plan = self.plan(axis)?;
        positive(velocity)?;
        self.set(&Command::SetVelocities(&[(
            plan.name.clone(),
            plan.wire(velocity),
        )]))
    }

    /// What the platform's lengths are counted in: as its first axis that shifts.
    fn length_unit(&self) -> Unit {
        let lengths = self.plans.iter().filter(|p| !p.axis.is_rotation());
        lengths.map(|p| p.unit).next().unwrap_or(Unit::MILLIMETRE)
    }

    /// A command without an answer, and how it went.
    fn set(&self, command: &Command<'_>) -> Result<(), ScopeError> {
        let bytes = command.encode().map_err(|e| bad_setting(e.to_string()))?;
        let mut ex = self.exchange_unless_homing()?;
        ex.send(&bytes)?;
        match error_number(&mut ex)? {
            0 => Ok(()),
            number => Err(refusal(number)),
        }
    }
}

fn positive(velocity: f64) -> Result<(), ScopeError> {
    if velocity.is_finite() && velocity > 0.0 {
        Ok(())
    } else {
        Err(bad_setting("a velocity must be positive"))
    }
}

//! What a controller keeps and can be told: the pivot of a hexapod and its velocities.

use crate::gcs2::codec::{self, AxisName, Command};
use crate::gcs2::stage::Gcs2Stage;
use crate::gcs2::talk::{ask, error_number, read, refusal, values};
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
        let mm = values(&mut ex, &Command::Pivot, &names)?;
        Ok([0, 1, 2].map(|i| Length::from_um(mm[i] * 1e3)))
    }

    /// Sets the point that the platform turns about. The controller allows it only while all rotations are zero.
    ///
    /// # Errors
    /// [`ScopeError::Device`] with the controller's reason, and as [`Gcs2Stage::pivot`].
    pub fn set_pivot(&self, point: [Length; 3]) -> Result<(), ScopeError> {
        self.set(&Command::SetPivot(point.map(|p| p.um() * 1e-3)))
    }

    /// The velocity of a hexapod's platform.
    ///
    /// # Errors
    /// As [`Gcs2Stage::pivot`].
    pub fn platform_velocity_um_per_s(&self) -> Result<f64, ScopeError> {
        let mut ex = self.exchange_unless_homing()?;
        let lines = ask(&mut ex, &Command::PlatformVelocity)?;
        Ok(1e3 * read(&ex, codec::decode_number("VLS?", &lines))?)
    }

    /// Sets the velocity of a hexapod's platform.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] unless it is positive, [`ScopeError::Device`] with the controller's reason, and as
    /// [`Gcs2Stage::pivot`].
    pub fn set_platform_velocity_um_per_s(&self, velocity: f64) -> Result<(), ScopeError> {
        positive(velocity)?;
        self.set(&Command::SetPlatformVelocity(velocity * 1e-3))
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

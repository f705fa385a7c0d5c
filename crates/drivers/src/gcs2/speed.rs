//! A move at a speed of its own: the velocity that the controller keeps is set for it, and put back when it has ended, however that was.

use crate::gcs2::codec::{self, Command};
use crate::gcs2::stage::{Gcs2Stage, Goal};
use crate::gcs2::talk::{STOPPED_BY_COMMAND, ask_if_known, error_number, number_if_known, read};
use crate::session::{Exchange, device, lock, refused};
use scopeservo_scope::ScopeError;

/// The least that can be sent, in the controller's unit a second: numbers have six decimals.
const LEAST: f64 = 1e-6;

/// A velocity of the controller's.
struct Velocity {
    /// In its unit a second.
    usual: f64,
    /// The line that puts it back, in the controller's own digits.
    back: Vec<u8>,
}

impl Gcs2Stage {
    /// Sets the velocity for the move that comes, where that is below the usual one.
    ///
    /// # Errors
    /// [`ScopeError::Refused`] for a move of several axes or of one that turns, and where the controller knows no velocities or not this one;
    /// and those of the link.
    pub(super) fn slow_down(
        &self,
        ex: &mut Exchange<'_>,
        goal: &[Goal],
        m_per_s: f64,
    ) -> Result<(), ScopeError> {
        let moved = self.plans.iter().find(|p| match goal {
            [goal] => p.name == goal.name && !p.axis.is_rotation(),
            _ => false,
        });
        let plan = moved.ok_or_else(|| {
            refused("its speed can be chosen for moves of one axis that shifts; nothing moved")
        })?;
        let wanted = plan.wire(m_per_s);
        if wanted < LEAST {
            return Err(refused(format!(
                "the controller cannot be told a velocity as low as {wanted} a second; nothing moved"
            )));
        }
        // The axes of a platform have one velocity.
        let velocity = match self.coupled {
            true => platform(ex)?,
            false => of_axis(ex, &plan.name)?,
        };
        let velocity = velocity.ok_or_else(|| {
            refused("the controller does not tell its velocities (VEL?, VLS?), so that none is set; nothing moved")
        })?;
        if wanted >= velocity.usual {
            return Ok(());
        }
        let slower = [(plan.name.clone(), wanted)];
        let set = match self.coupled {
            true => Command::SetPlatformVelocity(wanted),
            false => Command::SetVelocities(&slower),
        };
        let set = read(ex, set.encode())?;
        // Owed from here on, should the next answer not come.
        ex.at_close(&velocity.back);
        *lock(&self.velocity_owed) = Some(velocity.back);
        ex.send(&set)?;
        match error_number(ex)? {
            0 => Ok(()),
            STOPPED_BY_COMMAND => Err(ScopeError::Interrupted { at: None }),
            number => Err(refused(codec::error_in_words(number))),
        }
    }

    /// Puts the velocity back that a slow move has changed, if one has.
    ///
    /// # Errors
    /// [`ScopeError::Device`] with the controller's reason, and those of the link.
    pub(super) fn put_velocity_back(&self, ex: &mut Exchange<'_>) -> Result<(), ScopeError> {
        let Some(back) = lock(&self.velocity_owed).take() else {
            return Ok(());
        };
        ex.send(&back)?;
        let number = error_number(ex)?;
        ex.at_close(&[]);
        match number {
            // It may still speak of a stop before.
            0 | STOPPED_BY_COMMAND => Ok(()),
            number => Err(device(format!(
                "it did not take its usual velocity back ({}): {}. Set it with the maker's program",
                String::from_utf8_lossy(&back).trim(),
                codec::error_in_words(number)
            ))),
        }
    }
}

fn of_axis(ex: &mut Exchange<'_>, name: &codec::AxisName) -> Result<Option<Velocity>, ScopeError> {
    let names = std::slice::from_ref(name);
    let asked = Command::Velocities(names);
    let Some(lines) = ask_if_known(ex, &asked)? else {
        return Ok(None);
    };
    let words = read(ex, codec::decode_words(asked.name(), names, &lines))?;
    let said = words.concat();
    let usual = read(
        ex,
        codec::decode_number(asked.name(), std::slice::from_ref(&said)),
    )?;
    Ok(Some(Velocity {
        usual,
        back: format!("VEL {name} {}\n", plain(&said, usual)).into_bytes(),
    }))
}

fn platform(ex: &mut Exchange<'_>) -> Result<Option<Velocity>, ScopeError> {
    let Some((usual, said)) = number_if_known(ex, &Command::PlatformVelocity)? else {
        return Ok(None);
    };
    Ok(Some(Velocity {
        usual,
        back: format!("VLS {}\n", plain(&said, usual)).into_bytes(),
    }))
}

/// The digits that a controller said, where they are such as are sent: some say 5.0e+00, and nobody knows whether they read it.
fn plain(said: &str, value: f64) -> String {
    match said.bytes().all(|b| b.is_ascii_digit() || b == b'.') {
        true => said.to_string(),
        false => format!("{value:.6}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_velocity_is_put_back_in_digits_that_every_controller_reads() {
        for (said, sent) in [
            ("10.000000", "10.000000"),
            ("0.12345678", "0.12345678"),
            ("5", "5"),
            ("5.0000000e+00", "5.000000"),
            ("+1.2E-1", "0.120000"),
        ] {
            assert_eq!(plain(said, said.parse().unwrap()), sent, "{said}");
        }
    }
}

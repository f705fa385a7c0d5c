//! Reference moves, of the stage or of a nosepiece, and whether axes know where they are.

use crate::gcs2::codec::Command;
use crate::gcs2::stage::{Doing, Gcs2Stage};
use crate::gcs2::talk::{all_set, error_number, read, ready, refusal};
use crate::session::{Exchange, lock, refused};
use crate::turret::Part;
use scopeservo_scope::{Motion, ScopeError};

impl Gcs2Stage {
    pub(super) fn home_part(&self, part: Part) -> Result<(), ScopeError> {
        if !self.knows_reference {
            return Err(refused(
                "the controller knows no reference move (FRF?): its axes always know where they are, and nothing moved",
            ));
        }
        let stops = self.session.stops();
        let mut ex = self.session.exchange()?;
        if self.poll_in(&mut ex)? == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        let bytes = read(&ex, Command::Reference(self.names_of(part)).encode())?;
        ex.send_unless_stopped(&bytes, stops)?;
        if part == Part::Stage {
            *lock(&self.homed) = false;
        }
        *lock(&self.doing) = Doing::Homing(part);
        // A controller on a reference move may take no lines; how it began is asked when it does.
        if ready(&mut ex)? {
            let number = error_number(&mut ex)?;
            if number != 0 {
                *lock(&self.doing) = Doing::Stopped;
                return Err(refusal(number));
            }
        }
        Ok(())
    }

    /// Whether every axis of a part knows where it is. `false` while a reference move runs.
    pub(super) fn is_part_homed(&self, part: Part) -> Result<bool, ScopeError> {
        let mut ex = self.session.exchange()?;
        if self.is_homing() && self.poll_in(&mut ex)? == Motion::Moving {
            return Ok(false);
        }
        self.referenced(&mut ex, part)
    }

    pub(super) fn referenced(&self, ex: &mut Exchange<'_>, part: Part) -> Result<bool, ScopeError> {
        let names = self.names_of(part);
        let homed = !self.knows_reference || all_set(ex, &Command::Referenced(names), names)?;
        if part == Part::Stage {
            *lock(&self.homed) = homed;
        }
        Ok(homed)
    }
}

//! The work under way, whose wish to stop the gate obeys besides the instrument's own.

use super::MotionGate;
use crate::{CancelToken, ScopeError};

/// A piece of work under way, whose token the instrument obeys until this is dropped.
#[must_use]
pub struct Obeying<'a>(&'a MotionGate);

impl<'a> Obeying<'a> {
    pub(crate) fn begin(gate: &'a MotionGate, cancel: &CancelToken) -> Result<Self, ScopeError> {
        let mut job = gate.job_mut();
        if job.is_some() {
            return Err(ScopeError::Busy {
                device: "instrument",
            });
        }
        *job = Some(cancel.clone());
        Ok(Self(gate))
    }
}

impl Drop for Obeying<'_> {
    fn drop(&mut self) {
        *self.0.job_mut() = None;
    }
}

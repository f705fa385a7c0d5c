//! Waiting: for what moves to settle, for a stop to be seen, and never past a wish to stop.

use super::Instrument;
use crate::{Motion, ScopeError, StagePose, stand_still};
use std::time::Duration;

/// How often a running move is asked whether it has ended.
pub(super) const POLL: Duration = Duration::from_millis(5);

impl Instrument {
    /// Waits until the stage was seen to stand. Returns where.
    ///
    /// # Errors
    /// As [`stand_still`].
    pub fn stand_still(&self) -> Result<StagePose, ScopeError> {
        let (poll, position) = (|| self.gate.poll(), || self.gate.position());
        stand_still(self.gate.info(), self.clock(), &poll, &position)
    }

    /// Stops everything, and tells whether it was seen to stand.
    fn stopped(&self) -> ScopeError {
        let stood = self.gate.stop().and_then(|()| self.stand_still());
        match stood {
            Ok(at) => ScopeError::Interrupted { at: Some(at) },
            // One that was stopped on the way to its reference stands somewhere.
            Err(ScopeError::NotHomed { .. }) => ScopeError::Interrupted { at: None },
            Err(error) => error,
        }
    }

    /// An interruption that nobody has looked at, seen to.
    pub(super) fn seen(&self, error: ScopeError) -> ScopeError {
        match error {
            ScopeError::Interrupted { .. } => self.stopped(),
            error => error,
        }
    }

    /// An error when a stop was asked for.
    pub fn check_cancel(&self) -> Result<(), ScopeError> {
        match self.gate.is_cancelled() {
            true => Err(self.stopped()),
            false => Ok(()),
        }
    }

    pub(super) fn wait(
        &self,
        device: &'static str,
        limit: Duration,
        mut poll: impl FnMut() -> Result<Motion, ScopeError>,
    ) -> Result<Motion, ScopeError> {
        let start = self.clock.now();
        loop {
            self.check_cancel()?;
            match poll() {
                Ok(Motion::Moving) => {}
                // Stopped from the side that also asked for the stop: the next turn says so.
                Ok(Motion::Stopped) if self.gate.is_cancelled() => continue,
                Ok(ended) => return Ok(ended),
                Err(fault) => {
                    // A device that cannot say what it does must not go on doing it; its own fault is the news.
                    let _ = self.gate.stop();
                    return Err(fault);
                }
            }
            if self.clock.now().since(start) > limit {
                self.gate.stop()?;
                return Err(ScopeError::Timeout {
                    device,
                    seconds: limit.as_secs_f64(),
                });
            }
            self.clock.sleep(POLL);
        }
    }
}

//! Ways that are longer than one step may be, and the way back to where the stage has stood.

use super::Instrument;
use crate::{ScopeError, StagePose};

/// A way of more steps than this is gone in one, and refused.
const MOST_STEPS: u32 = 10_000;

impl Instrument {
    /// As [`Instrument::move_to`], in steps that are allowed, along the straight line. Each counts from where the stage says it is.
    ///
    /// # Errors
    /// As [`Instrument::move_to`]. A goal that is refused is so before anything moves.
    pub fn move_in_steps(&self, to: &StagePose) -> Result<StagePose, ScopeError> {
        for _ in 0..MOST_STEPS {
            let part = self.gate.first_part(to)?;
            if part == *to {
                break;
            }
            self.gate.check(to)?;
            self.move_to(&part)?;
        }
        self.move_to(to)
    }

    /// Goes back to where the stage has stood, in steps that are allowed. What stood beyond a limit by no more than it may miss goes to that limit.
    ///
    /// # Errors
    /// As [`Instrument::move_to`].
    pub fn return_to(&self, stood: &StagePose) -> Result<StagePose, ScopeError> {
        self.move_in_steps(&self.gate.as_goal(stood)?)
    }
}

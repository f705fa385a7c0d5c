//! Algorithm 1 whole: from wherever the microscope stands to the saved view, with the answer arrived, not found, refused or ambiguous.

mod ahead;
mod ladder;
mod outcome;
mod parcentric;
mod procedure;
mod words;

pub use ladder::{Ladder, Leg, LegPolicy, Shortest, SoFar};
pub use outcome::{MagnificationResult, Outcome, Reason, Verdict};
pub use procedure::{Reposition, RepositionOptions};

//! Algorithm 1 whole: from wherever the microscope stands to the saved view, with the answer arrived, not found, refused or ambiguous.

mod ahead;
mod ladder;
mod left;
mod light;
mod outcome;
mod parcentric;
mod places;
mod procedure;
mod sharpening;
mod words;
mod words_of_reach;

pub use ladder::{Ladder, Leg, LegPolicy, Shortest, SoFar};
pub(crate) use left::Left;
pub use outcome::{MagnificationResult, Outcome, Reason, Verdict};
pub use procedure::{Reposition, RepositionOptions};

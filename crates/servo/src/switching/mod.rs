//! What repeated switching between two objectives shows of the nosepiece: where the second one looks and focuses beside the first, and how far
//! each arrival scatters.
//!
//! The first objective's view is the reference. Then the stage steps aside once and stands there, so that dust on the camera, which stays,
//! is told from the specimen, which moved; and the objectives come in turn, each focused and found in the reference. What the step was
//! off by is common to all of them and falls out.

mod numbers;
mod procedure;

pub use numbers::{FocusSwitch, SwitchingReport};
pub use procedure::{Switching, SwitchingOptions};

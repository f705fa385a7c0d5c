//! How far a run has gone to make a view as sharp as its target.

use serde::{Deserialize, Serialize};

/// What was done so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Sharpening {
    /// Nothing, as the view was as sharp as the target.
    #[default]
    Not,
    /// From a height, where the view was as soft as so far from focus, the stage went as far away from the specimen.
    Away { from_um: f64, defocus_um: f64 },
    /// That was the wrong side; it went to the other one.
    Nearer,
    /// A step has made the view sharp; once more, and it is a sweep.
    Stepped,
    /// A sweep was made.
    Swept,
}

//! Whether a kept calibration still holds: two moves and, where the stage turns, a rotation about the view, seen beside what the calibration
//! says of them.
//!
//! `changes` makes numbers and a verdict of what was seen, `together` says of several objectives which one disagrees, and `procedure` moves and
//! looks.

mod changes;
mod procedure;
mod together;

pub use changes::{Broken, Change, Changing, SelfTestReport, SelfTestVerdict, changes_between};
pub use procedure::SelfTest;
pub use together::{Together, together};

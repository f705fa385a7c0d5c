//! Stages on boards with Marlin or firmware like it. Lengths are millimetres on the wire.
//!
//! The driver never lets the board wait inside a command while it moves, since many boards hear nothing then, not even a
//! stop: a move is sent, and where the steppers are is asked until they are at the goal.

pub mod codec;
mod connect;
mod factory;
mod homing;
mod motion;
mod nosepiece;
mod settings;
mod stage;
mod talk;

pub use factory::FACTORY;
pub use settings::{GcodeAxis, GcodeNosepiece, GcodeSettings};
pub use stage::GcodeStage;

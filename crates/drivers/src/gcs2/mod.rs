//! Controllers of Physik Instrumente that speak the General Command Set, version 2: hexapods, and stages of one or more
//! axes. Lengths are millimetres and angles degrees on the wire.

pub mod codec;
mod connect;
mod factory;
mod homing;
mod motion;
mod nosepiece;
mod parameters;
mod settings;
mod speed;
mod stage;
mod talk;
mod unit;

pub use factory::FACTORY;
pub use settings::{Gcs2Nosepiece, Gcs2Settings, LinearAxis, RotaryAxis};
pub use stage::Gcs2Stage;

//! Controllers of Physik Instrumente that speak the General Command Set, version 2: hexapods, and stages of one or more
//! axes. Lengths are millimetres and angles degrees on the wire.

pub mod codec;
mod factory;
mod settings;
mod stage;

pub use factory::FACTORY;
pub use settings::{Gcs2Nosepiece, Gcs2Settings, LinearAxis, RotaryAxis};
pub use stage::Gcs2Stage;

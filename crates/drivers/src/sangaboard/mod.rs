//! The Sangaboard, the motor board of the OpenFlexure microscope, with firmware that moves without blocking and knows
//! "stop". Older firmware hears nothing while it moves and is refused.

pub mod codec;
mod factory;
mod settings;
mod stage;

pub use factory::FACTORY;
pub use settings::{SangaAxis, SangaSettings};
pub use stage::SangaStage;

//! `scopeservo.toml`: what an instrument is made of, and what it may do.
//!
//! [`Config::read`] reads and checks the file, [`open`] makes an [`scopeservo_scope::Instrument`] of it. Nothing moves because of
//! either, unless the user agreed to homing.

#![warn(clippy::too_many_lines)]

mod by_hand;
mod check;
mod config;
mod error;
mod held;
mod open;
mod reading;
mod rules;
mod simulated;
mod spelled;
mod tables;
mod template;

pub use by_hand::Ask;
pub use config::{Config, DeviceName, DriverConfig, ObjectiveConfig};
pub use error::SetupError;
pub use held::Held;
pub use open::{Consent, Opened, connect, home_if_needed, open};
pub use simulated::{TwinConfig, TwinStage};
pub use template::{TEMPLATE, TWIN_TEMPLATE, schema};

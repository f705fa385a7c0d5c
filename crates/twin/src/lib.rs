//! A simulated microscope that knows the truth. Shares no code with what it tests.
//!
//! A [`Twin`] is a stage, a camera and a nosepiece over a [`Specimen`], all on one [`Clock`]: on a virtual clock
//! minutes pass in seconds, and the same seed with the same calls gives the same frames, bit for bit, on any number of
//! threads. [`Twin::truth`] tells where each frame really was taken; nothing that is tested may ask it.
//!
//! ```
//! use scopeservo_scope::VirtualClock;
//! use scopeservo_twin::{Blank, Config, Twin};
//! use std::sync::Arc;
//!
//! let twin = Twin::new(Config::realistic(), Arc::new(Blank), 1, Arc::new(VirtualClock::new()))?;
//! twin.centre_specimen([1000.0, -500.0], 30.0);
//! let frame = twin.camera().grab()?;
//! let truth = twin.truth(frame.sequence).expect("every grabbed frame has one");
//! assert!((truth.centre_um[0] - 1000.0).abs() < 1.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`Clock`]: scopeservo_scope::Clock

#![warn(clippy::too_many_lines)]

mod adapted;
mod affine;
mod blur;
mod camera;
mod camera_config;
mod config;
mod devices;
mod distortion;
mod error;
mod faults;
mod font;
mod inner;
mod nosepiece;
mod numbers;
mod optics;
mod render;
mod sampling;
mod scene;
mod seeds;
mod sensor;
mod shown;
mod slide;
pub mod specimen;
mod stage;
mod stage_config;
mod truth;
mod twin;

pub use camera_config::{AutoExposureConfig, CameraConfig, DustConfig, Mark, PatternConfig};
pub use config::{Config, MountConfig, NosepieceConfig, ObjectiveConfig, SlideConfig};
pub use error::TwinError;
pub use faults::{DriftingHair, StageFault};
pub use slide::SpecimenEvent;
pub use specimen::{
    Blank, CellKind, FileSpecimen, Lattice, LatticeConfig, LatticeKind, MadeSpecimen, Patch,
    Sparse, SparseConfig, Specimen, SpecimenError, Tissue, Twice, TwiceConfig,
};
pub use stage_config::{AxisConfig, StageConfig};
pub use truth::{TrueCalibration, Truth};
pub use twin::Twin;

//! The instrument contract: what a microscope must do for scopeservo to drive it.
//!
//! This crate holds newtypes, traits and errors, and deliberately **no pose composition**: it does not know how a
//! stage move changes a picture. The simulated microscope and the servo each write those equations themselves, so
//! that they cannot share a sign error.
//!
//! - [`Length`], [`Angle`], [`Timestamp`]: SI inside, micrometres and degrees at the edges.
//! - [`Stage`], [`Camera`], [`Nosepiece`], [`Clock`]: the device contracts. All methods take `&self`, so that
//!   [`Stage::stop`] works from another thread while a move runs.
//! - [`CheckedStage`]: the only stage an [`Instrument`] accepts. It refuses what is outside the limits, never clips.
//! - [`conformance`]: one suite that every implementation must pass.

mod camera;
mod clock;
pub mod conformance;
mod error;
mod instrument;
mod limits;
mod nosepiece;
mod stage;
mod units;

pub use camera::{Camera, CameraInfo, Channels, Frame, Samples};
pub use clock::{Clock, SystemClock, Timestamp, VirtualClock};
pub use error::{ErrorKind, ScopeError};
pub use instrument::{CancelToken, Counters, Instrument};
pub use limits::{AxisRange, CheckedStage, Limits};
pub use nosepiece::{Nosepiece, Objective, ObjectiveId};
pub use stage::{Axis, AxisInfo, Kinematics, Motion, PositiveZ, Stage, StageInfo, StagePose};
pub use units::{Angle, Length};

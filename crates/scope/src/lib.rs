//! The instrument contract: what a microscope must do for scopeservo to drive it.
//!
//! This crate holds newtypes, traits and errors, and deliberately **no pose composition**: it does not know how a
//! stage move changes an image. The simulated microscope and the servo each write those equations themselves, so
//! that they cannot share a sign error.
//!
//! - [`Length`], [`Angle`], [`Timestamp`]: SI inside, micrometres and degrees at the edges.
//! - [`Stage`], [`Camera`], [`Nosepiece`], [`Light`], [`Clock`]: the device contracts, and [`Devices`], all of them. All methods take `&self`, so that
//!   [`Stage::stop`] works from another thread while a move runs.
//! - [`MotionGate`]: the only way to move an [`Instrument`]. It refuses what its [`Rules`] do not allow, and never clips.
//! - [`conformance`]: one suite that every implementation must pass.

#![warn(clippy::too_many_lines)]

mod absent;
mod breach;
mod camera;
mod cancel;
mod clock;
pub mod conformance;
mod devices;
mod error;
mod flat_field;
mod gate;
mod immersion;
mod instrument;
mod judge;
mod knowledge;
mod light;
mod nosepiece;
mod objective_id;
mod observe;
mod pose;
mod reported;
mod rules;
mod spoken;
mod stage;
mod still;
mod units;
mod visible;

pub use absent::Absent;
pub use breach::Breach;
pub use camera::{Camera, CameraInfo, Channels, Frame, Samples};
pub use cancel::CancelToken;
pub use clock::{Clock, SystemClock, Timestamp, VirtualClock};
pub use devices::Devices;
pub use error::{ErrorKind, Remedy, ScopeError};
pub use flat_field::FlatField;
pub use gate::{AtWork, Goals, MotionGate, Obeying};
pub use immersion::{AskImmersion, Immersion, ImmersionChange};
pub use instrument::{Counters, Instrument, ObjectiveChange};
pub use light::{Light, check_level};
pub use nosepiece::{KnownBy, Nosepiece, Objective, by_immersion};
pub use objective_id::ObjectiveId;
pub use observe::{GateEvent, Observer};
pub use pose::{Axis, StagePose};
pub use rules::{AxisRange, ChangeRule, LargestStep, Limits, Rules, Workspace, Zone};
pub use spoken::{deg_in_words, um_in_words};
pub use stage::{AxisInfo, Kinematics, Motion, PositiveZ, Stage, StageInfo, check_speed};
pub use still::stand_still;
pub use units::{Angle, Length};
pub use visible::visible;

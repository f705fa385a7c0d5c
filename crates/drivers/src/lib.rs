//! Drivers for real stages, nosepieces and [cameras](camera). Each driver of a stage is three things that share no code: a pure codec (typed commands to bytes, bytes to
//! typed replies, no input or output), a driver that implements [`scopeservo_scope::Stage`] over any [`link::Transport`],
//! and an [`emulator`] on a TCP port of this machine to test the driver against.
//!
//! Each maker's folder also has its [`factory`], by which a description of an instrument finds the driver: a new maker is a folder and a
//! line of [`factory::FACTORIES`].
//!
//! What every driver keeps to:
//!
//! - Nothing moves on connecting. Homing happens only on an explicit call.
//! - A request is carried out whole or refused whole, never clipped.
//! - `stop` sends its bytes at once from any thread, also while another thread waits for a reply, and no move that was
//!   being prepared at that moment starts afterwards.
//! - After a time-out, an interruption or an answer that cannot be read, nobody knows which reply belongs to which
//!   question. The driver then sends the stop command, closes the link, and every later call says so.

#![warn(clippy::too_many_lines)]

mod board;
pub mod camera;
pub mod emulator;
pub mod factory;
pub mod gcode;
pub mod gcs2;
pub mod link;
pub mod sangaboard;
mod session;
pub mod turret;

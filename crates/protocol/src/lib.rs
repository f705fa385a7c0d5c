//! The driver protocol (docs/driver-protocol.md): a stage, camera, nosepiece or light in another program, behind the same contracts
//! as any other, and ours for other programs.
//!
//! - [`Driver::spawn`] and [`Driver::connect`] start or find a driver; [`Driver::devices`] are what it speaks for. One that is silent,
//!   dies or talks nonsense is stopped and every later call says so: nothing waits longer than the page's times. One that is slow with a
//!   frame and still there is waited for ([`Patience`]).
//! - [`serve`] speaks for devices of ours on any pair of streams, [`listen`] on a TCP port.
//! - [`wire`] is the framing, with its limits; it reads and writes streams and knows no devices.

#![warn(clippy::too_many_lines)]

mod child;
mod client;
mod hello;
mod link;
mod listen;
mod message;
mod patience;
mod remote;
mod secret;
mod server;
mod visible;
pub mod wire;

pub use client::{Driver, DriverError};
pub use hello::{
    AxisHello, CameraHello, Hello, LightHello, Moves, NosepieceHello, ObjectiveHello, StageHello,
};
pub use listen::{bind, listen};
pub use message::{Call, Code, Go, PROTOCOL, Place};
pub use patience::Patience;
pub use secret::Secret;
pub use server::{Offer, serve};

//! Emulated controllers and cameras on TCP ports of this machine, with faults to order. They share no code with the codecs.

pub mod camera;
pub mod gcode;
pub mod gcs2;
pub mod sangaboard;
mod server;

pub use server::{Fault, Server};

//! Emulated controllers on a TCP port of this machine, with faults to order. They share no code with the codecs.

pub mod gcode;
pub mod gcs2;
pub mod sangaboard;
mod server;

pub use server::{Fault, Server};

//! A simulated microscope. Shares no code with what it tests.

pub mod specimen;

//! The devices of an instrument, or of a driver that speaks for some of them.

use crate::{Camera, Clock, Light, Nosepiece, Stage};
use std::sync::Arc;

/// What is there. [`crate::Instrument::new`] takes it whole, and puts [`crate::Absent`] where one is missing.
pub struct Devices {
    /// The stage.
    pub stage: Option<Box<dyn Stage>>,
    /// The camera.
    pub camera: Option<Box<dyn Camera>>,
    /// The nosepiece.
    pub nosepiece: Option<Box<dyn Nosepiece>>,
    /// The light, where it can be set.
    pub light: Option<Box<dyn Light>>,
    /// The clock that they share.
    pub clock: Arc<dyn Clock>,
}

impl Devices {
    /// No device yet.
    pub fn none(clock: Arc<dyn Clock>) -> Self {
        Self {
            stage: None,
            camera: None,
            nosepiece: None,
            light: None,
            clock,
        }
    }
}

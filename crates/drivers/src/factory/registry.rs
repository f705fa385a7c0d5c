//! The registry.

use super::contract::Factory;
use crate::{camera, gcode, gcs2, sangaboard};

/// The drivers of this crate.
pub const FACTORIES: &[Factory] = &[
    gcs2::FACTORY,
    gcode::FACTORY,
    sangaboard::FACTORY,
    camera::MJPEG,
    camera::SNAPSHOT,
    camera::FOLDER,
    camera::V4L,
];

//! Cameras: over the web, in a folder, and on a video device of this machine with the feature `v4l`.
//!
//! None of them says when an image was exposed. So each is told how long an image may take from the start of its exposure
//! until it is here (`latency_ms`), and takes only images that came later than that after they were asked for: however much
//! lies in buffers on the way, an image from before a move never passes for one after it. Time stamps are the earliest
//! moment at which the exposure can have begun.

mod exposing;
mod factory;
mod folder;
pub mod http;
mod mjpeg;
pub mod multipart;
pub mod picture;
mod picture_error;
pub mod raw;
mod snapshot;
mod stream;
#[cfg(all(feature = "v4l", target_os = "linux"))]
mod v4l;
mod v4l_settings;

pub use exposing::ExposureSettings;
pub use factory::{FOLDER, MJPEG, SNAPSHOT, V4L};
pub use folder::{FolderCamera, FolderOrder, FolderSettings};
pub use mjpeg::{MjpegSettings, mjpeg_camera};
pub use snapshot::{SnapshotCamera, SnapshotSettings};
pub use stream::{Packed, Source, StreamCamera};
#[cfg(all(feature = "v4l", target_os = "linux"))]
pub use v4l::v4l_camera;
pub use v4l_settings::{PixelFormat, V4lSettings};

use picture::Picture;
use scopeservo_scope::{CameraInfo, Frame, ScopeError, Timestamp};
use std::time::Duration;

/// A fault of the camera in its own words.
fn device(detail: impl Into<String>) -> ScopeError {
    ScopeError::Device {
        device: "camera",
        detail: detail.into(),
    }
}

fn lost(detail: impl Into<String>) -> ScopeError {
    ScopeError::Lost {
        device: "camera",
        detail: detail.into(),
    }
}

fn bad_setting(what: impl Into<String>) -> ScopeError {
    ScopeError::BadSetting { what: what.into() }
}

/// No image takes longer on its way, and nobody waits longer for one.
const LONGEST_MS: f64 = 60_000.0;

/// A setting in milliseconds as a time.
fn duration(what: &str, ms: f64) -> Result<Duration, ScopeError> {
    match (0.0..=LONGEST_MS).contains(&ms) {
        true => Ok(Duration::from_secs_f64(ms * 1e-3)),
        false => Err(bad_setting(format!(
            "{what} is {ms} and must be from 0 to {LONGEST_MS}"
        ))),
    }
}

/// Refuses a latency that is shorter than the exposure, which it includes.
fn check_latency(what: &str, latency: Duration, exposure: Duration) -> Result<(), ScopeError> {
    match latency >= exposure {
        true => Ok(()),
        false => Err(bad_setting(format!(
            "{what} is {latency:?}, shorter than the exposure of {exposure:?}, which it includes: from the start of an exposure until \
             its image is here"
        ))),
    }
}

/// What a camera is, from its first image.
fn info(name: String, first: &Picture, [shortest, longest]: [Duration; 2]) -> CameraInfo {
    CameraInfo {
        name,
        width: first.width,
        height: first.height,
        channels: first.channels,
        bit_depth: first.bit_depth,
        min_exposure: shortest,
        max_exposure: longest,
    }
}

/// An image as a frame of this camera.
fn frame(
    info: &CameraInfo,
    picture: Picture,
    sequence: u64,
    exposure_start: Timestamp,
    exposure: Duration,
) -> Result<Frame, ScopeError> {
    let shape = (
        picture.width,
        picture.height,
        picture.channels,
        picture.bit_depth,
    );
    if shape != (info.width, info.height, info.channels, info.bit_depth) {
        return Err(device(format!(
            "its images were {} x {} ({:?}, {} bits) and now are {} x {} ({:?}, {} bits): set it back, or start again",
            info.width,
            info.height,
            info.channels,
            info.bit_depth,
            shape.0,
            shape.1,
            shape.2,
            shape.3
        )));
    }
    Ok(Frame {
        width: picture.width,
        height: picture.height,
        channels: picture.channels,
        bit_depth: picture.bit_depth,
        samples: picture.samples,
        sequence,
        exposure_start,
        exposure,
    })
}

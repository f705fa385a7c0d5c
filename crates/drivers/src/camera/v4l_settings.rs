//! How a video device of this machine is set up. Read also by a build that cannot open one, which then says so.

use serde::Deserialize;
use std::path::PathBuf;

/// How pixels are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PixelFormat {
    /// One JPEG after another.
    Mjpg,
    /// Colour at half the columns.
    Yuyv,
    /// The same in another order.
    Uyvy,
    /// Colour at half the columns and rows.
    Nv12,
    /// Red, green, blue.
    Rgb3,
    /// Blue, green, red.
    Bgr3,
    /// Grey, 8 bits.
    Grey,
    /// Grey, 10 bits.
    Y10,
    /// Grey, 12 bits.
    Y12,
    /// Grey, 16 bits.
    Y16,
}

/// A camera or a capture card on a video device (V4L2; USB cameras are UVC).
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct V4lSettings {
    /// Which one: best a path of `/dev/v4l/by-id`, which stays the same when other devices come.
    pub device: PathBuf,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// How pixels are sent. Not `mjpg` where there is a choice: its blocks are taken for structure.
    pub format: PixelFormat,
    /// The longest time from the start of an exposure until the image is here: three frames for most. Too short a time lets old
    /// images pass; `doctor --allow-motion` finds that out.
    pub latency_ms: f64,
    /// How long after that an image is waited for.
    #[serde(default = "three_seconds")]
    pub timeout_ms: f64,
    /// For a device whose exposure cannot be set, such as a capture card: how long it exposes.
    pub fixed_exposure_ms: Option<f64>,
}

fn three_seconds() -> f64 {
    3000.0
}

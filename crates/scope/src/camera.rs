//! The camera and its frames.

use crate::{ScopeError, Timestamp};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Colour channels of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Channels {
    /// One grey sample per pixel.
    Gray,
    /// Red, green, blue, interleaved.
    Rgb,
}

impl Channels {
    /// Samples per pixel.
    pub fn count(self) -> usize {
        match self {
            Channels::Gray => 1,
            Channels::Rgb => 3,
        }
    }
}

/// What a camera is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// Maker and model, for people.
    pub name: String,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Colour channels.
    pub channels: Channels,
    /// Significant bits per sample, 8 to 16.
    pub bit_depth: u8,
    /// Shortest exposure it takes.
    pub min_exposure: Duration,
    /// Longest exposure it takes.
    pub max_exposure: Duration,
}

impl CameraInfo {
    /// Whether the camera can expose for so long.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`].
    pub fn check_exposure(&self, exposure: Duration) -> Result<(), ScopeError> {
        match (self.min_exposure..=self.max_exposure).contains(&exposure) {
            true => Ok(()),
            false => Err(ScopeError::BadSetting {
                what: format!(
                    "the camera exposes for {:?} to {:?}; {exposure:?} was asked for",
                    self.min_exposure, self.max_exposure
                ),
            }),
        }
    }
}

/// Pixel samples, row-major, interleaved.
#[derive(Debug, Clone, PartialEq)]
pub enum Samples {
    /// Up to 8 bits.
    U8(Vec<u8>),
    /// 9 to 16 bits, in the low bits.
    U16(Vec<u16>),
}

/// One image. Integer pixel coordinates are pixel centres; row 0 is the top row.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Colour channels.
    pub channels: Channels,
    /// Significant bits per sample.
    pub bit_depth: u8,
    /// `width * height * channels` samples.
    pub samples: Samples,
    /// Counts the frames of this camera; gaps are dropped frames.
    pub sequence: u64,
    /// When the exposure began.
    pub exposure_start: Timestamp,
    /// How long it lasted.
    pub exposure: Duration,
}

impl Frame {
    /// Luminance in 0..=1, row-major: Rec. 601 weights for colour, full precision kept.
    pub fn luminance(&self) -> Vec<f32> {
        let full = f32::from(((1u32 << self.bit_depth) - 1) as u16);
        match &self.samples {
            Samples::U8(s) => luminance(s.iter().map(|&v| f32::from(v)), self.channels, full),
            Samples::U16(s) => luminance(s.iter().map(|&v| f32::from(v)), self.channels, full),
        }
    }

    /// 8-bit RGB, row-major, for looking at and for writing files.
    pub fn rgb8(&self) -> Vec<u8> {
        let shift = u32::from(self.bit_depth.saturating_sub(8));
        let bytes: Vec<u8> = match &self.samples {
            Samples::U8(s) => s.clone(),
            Samples::U16(s) => s.iter().map(|&v| (v >> shift).min(255) as u8).collect(),
        };
        match self.channels {
            Channels::Rgb => bytes,
            Channels::Gray => bytes.iter().flat_map(|&v| [v, v, v]).collect(),
        }
    }
}

fn luminance(samples: impl Iterator<Item = f32>, channels: Channels, full: f32) -> Vec<f32> {
    let samples: Vec<f32> = samples.collect();
    match channels {
        Channels::Gray => samples.iter().map(|v| v / full).collect(),
        Channels::Rgb => samples
            .chunks_exact(3)
            .map(|p| (0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2]) / full)
            .collect(),
    }
}

/// A camera. Frames may be grabbed while the stage moves.
pub trait Camera: Send + Sync {
    /// What this camera is.
    fn info(&self) -> &CameraInfo;
    /// The exposure in force.
    fn exposure(&self) -> Result<Duration, ScopeError>;
    /// Sets the exposure and returns what was really set. Outside the camera's range is refused.
    fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError>;
    /// The next frame whose exposure began at or after this call: never one from a buffer.
    fn grab(&self) -> Result<Frame, ScopeError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(channels: Channels, bit_depth: u8, samples: Samples) -> Frame {
        Frame {
            width: 2,
            height: 1,
            channels,
            bit_depth,
            samples,
            sequence: 0,
            exposure_start: Timestamp::default(),
            exposure: Duration::from_millis(10),
        }
    }

    #[test]
    fn full_scale_is_one_at_every_bit_depth() {
        let eight = frame(
            Channels::Rgb,
            8,
            Samples::U8(vec![255, 255, 255, 0, 255, 0]),
        );
        let grey = eight.luminance();
        assert!((grey[0] - 1.0).abs() < 1e-6 && (grey[1] - 0.587).abs() < 1e-6);
        let twelve = frame(Channels::Gray, 12, Samples::U16(vec![4095, 0]));
        assert_eq!(twelve.luminance(), vec![1.0, 0.0]);
        assert_eq!(twelve.rgb8(), vec![255, 255, 255, 0, 0, 0]);
    }
}

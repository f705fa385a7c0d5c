//! A frame as browsers take it: a head in JSON and a JPEG.

use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use scopeservo_protocol::Place;
use scopeservo_scope::Frame;
use scopeservo_servo::sharpness;
use serde::Serialize;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// No side that is sent is longer, pixels: a larger frame is halved until it fits.
const LONGEST: usize = 1600;
const QUALITY: u8 = 82;
/// From this level on of 255 a sample is saturated, and up to the other it is black.
const SATURATED: u8 = 254;
const BLACK: u8 = 1;

/// What is told with each frame.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Head {
    pub(crate) seq: u64,
    pub(crate) time_s: f64,
    /// Since it was grabbed, when it is sent.
    pub(crate) age_ms: f64,
    /// When it is sent, ms since 1970 by the clock of the server's computer.
    pub(crate) sent_ms: f64,
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) full_width: usize,
    pub(crate) full_height: usize,
    pub(crate) um_per_px: Option<f64>,
    pub(crate) objective: Option<String>,
    pub(crate) at: Option<Place>,
    pub(crate) role: String,
    pub(crate) sharpness: f64,
    pub(crate) saturated: f64,
    pub(crate) dark: f64,
}

/// What is known of a frame beside what it shows.
pub(crate) struct About {
    pub(crate) seq: u64,
    pub(crate) role: String,
    /// Of the full frame.
    pub(crate) um_per_px: Option<f64>,
    pub(crate) objective: Option<String>,
    pub(crate) at: Option<Place>,
}

/// A frame, encoded.
pub(crate) struct Encoded {
    pub(crate) head: Head,
    pub(crate) jpeg: Vec<u8>,
    /// When it was grabbed.
    pub(crate) since: Instant,
}

impl Encoded {
    /// Encodes a frame that was there at `since`.
    ///
    /// # Errors
    /// A sentence, for an image that no JPEG holds.
    pub(crate) fn of(frame: &Frame, about: About, since: Instant) -> Result<Self, String> {
        let mut rgb = frame.rgb8();
        let count = rgb.len().max(1) as f64;
        let share = |is: fn(u8) -> bool| rgb.iter().filter(|v| is(**v)).count() as f64 / count;
        let (saturated, dark) = (share(|v| v >= SATURATED), share(|v| v <= BLACK));
        let (mut width, mut height) = (frame.width, frame.height);
        while width.max(height) > LONGEST {
            rgb = halved(&rgb, width, height);
            (width, height) = (width / 2, height / 2);
        }
        let jpeg = jpeg(&rgb, [width, height])?;
        let head = Head {
            seq: about.seq,
            time_s: frame.exposure_start.seconds(),
            age_ms: 0.0,
            sent_ms: 0.0,
            width,
            height,
            full_width: frame.width,
            full_height: frame.height,
            um_per_px: about.um_per_px,
            objective: about.objective,
            at: about.at,
            role: about.role,
            sharpness: sharpness(frame),
            saturated,
            dark,
        };
        Ok(Self { head, jpeg, since })
    }

    /// As one message: length of the head, the head, the JPEG.
    pub(crate) fn message(&self) -> Vec<u8> {
        let head = Head {
            age_ms: self.since.elapsed().as_secs_f64() * 1e3,
            sent_ms: SystemTime::now()
                .duration_since(UNIX_EPOCH)
                .map_or(0.0, |t| t.as_secs_f64() * 1e3),
            ..self.head.clone()
        };
        let head = serde_json::to_vec(&head).unwrap_or_default();
        let mut message = Vec::with_capacity(4 + head.len() + self.jpeg.len());
        message.extend((head.len() as u32).to_le_bytes());
        message.extend(head);
        message.extend(&self.jpeg);
        message
    }
}

/// Colours of 8 bits as a JPEG.
///
/// # Errors
/// A sentence, for an image that no JPEG holds.
pub(crate) fn jpeg(rgb: &[u8], [width, height]: [usize; 2]) -> Result<Vec<u8>, String> {
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, QUALITY)
        .encode(rgb, width as u32, height as u32, ExtendedColorType::Rgb8)
        .map_err(|e| format!("an image of {width} x {height} pixels cannot be sent: {e}"))?;
    Ok(jpeg)
}

/// Each pixel the mean of four.
fn halved(rgb: &[u8], width: usize, height: usize) -> Vec<u8> {
    let (w, h) = (width / 2, height / 2);
    let mut half = Vec::with_capacity(w * h * 3);
    for y in 0..h {
        for x in 0..w {
            for c in 0..3 {
                let at = |dx: usize, dy: usize| {
                    u16::from(rgb[((2 * y + dy) * width + 2 * x + dx) * 3 + c])
                };
                half.push(((at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1) + 2) / 4) as u8);
            }
        }
    }
    half
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_large_image_is_halved_by_means() {
        // 3 x 2 pixels: the column without a partner goes.
        let pixel = |v: u8| [v, v / 2, 255];
        let rgb: Vec<u8> = [10, 20, 99, 30, 40, 99]
            .into_iter()
            .flat_map(pixel)
            .collect();
        assert_eq!(halved(&rgb, 3, 2), [25, 13, 255]);
    }
}

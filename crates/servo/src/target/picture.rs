//! A target's image for people, and for telling places that look alike from each other.

use base64::Engine as _;
use scopeservo_features::GrayImage;
use serde::{Deserialize, Serialize};

/// A grey image in 8 bits, from its darkest to its brightest place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height` bytes, row by row, in base64.
    gray: String,
}

impl Picture {
    /// Of a grey image.
    pub fn of(image: &GrayImage) -> Self {
        // Single hot and dead pixels must not set the range.
        let mut sorted = image.data().to_vec();
        let end = sorted.len() / 1000;
        let low = *sorted.select_nth_unstable_by(end, f32::total_cmp).1;
        let last = sorted.len() - 1 - end;
        let high = *sorted.select_nth_unstable_by(last, f32::total_cmp).1;
        let scale = 255.0 / (high - low).max(f32::MIN_POSITIVE);
        let level = |v: &f32| ((v - low) * scale + 0.5).clamp(0.0, 255.0) as u8;
        let bytes: Vec<u8> = image.data().iter().map(level).collect();
        Self {
            width: image.width(),
            height: image.height(),
            gray: base64::engine::general_purpose::STANDARD.encode(bytes),
        }
    }

    /// The image, 0 to 1; `None` when it was damaged.
    pub fn image(&self) -> Option<GrayImage> {
        let bytes = base64::engine::general_purpose::STANDARD
            .decode(&self.gray)
            .ok()?;
        let data = bytes.into_iter().map(|v| f32::from(v) / 255.0).collect();
        GrayImage::new(self.width, self.height, data).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_comes_back_from_json_and_a_hot_pixel_does_not_set_its_range() {
        let image = GrayImage::from_fn(50, 40, |x, y| match (x, y) {
            (7, 7) => 90.0,
            _ => 0.2 + 0.001 * (x + y) as f32,
        })
        .unwrap();
        let picture = Picture::of(&image);
        let json = serde_json::to_string(&picture).unwrap();
        let back: Picture = serde_json::from_str(&json).unwrap();
        assert_eq!(back, picture);
        let shown = back.image().unwrap();
        assert!(shown.get(40, 30) - shown.get(5, 5) > 0.5);
        let damaged: Picture =
            serde_json::from_str(&json.replace("\"width\":50", "\"width\":51")).unwrap();
        assert_eq!(damaged.image(), None);
    }
}

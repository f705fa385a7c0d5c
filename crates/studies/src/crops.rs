//! Windows of slides, with what is needed to know whether two of them overlap.

use crate::warp::{SIZE, Source};
use scopeservo_features::{Engine, FeatureError, Features, GrayImage};
use scopeservo_geometry::{Affine2, Mat2, SplitMix64};

/// One window of one slide.
pub struct Crop {
    /// Which slide.
    pub slide: usize,
    /// Its place: x, y of the corner and size, source pixels.
    pub place: [f64; 4],
    /// Source pixels per pixel.
    pub pitch: f64,
    /// Its features.
    pub features: Features,
    /// Features of its mirror image.
    pub mirrored: Features,
}

impl Crop {
    /// A random window at `pitch` source pixels per pixel with independent noise; `None` when the slide is too small.
    ///
    /// # Errors
    /// Those of the engine.
    pub fn draw(
        slide: usize,
        source: &Source,
        pitch: f64,
        max_features: usize,
        seed: u64,
    ) -> Result<Option<Self>, FeatureError> {
        let mut rng = SplitMix64::new(seed);
        let size = SIZE.map(|n| n as f64 * pitch);
        let room = [
            source.width as f64 - size[0],
            source.height as f64 - size[1],
        ];
        if room.iter().any(|r| *r < 0.0) {
            return Ok(None);
        }
        let at = room.map(|r| r * rng.uniform());
        let source_from_pixel = Affine2 {
            linear: Mat2::diagonal(pitch, pitch),
            offset: at.map(|v| v + (pitch - 1.0) / 2.0),
        };
        let image = source.render(&source_from_pixel, 0.008, rng.next_u64());
        let engine = Engine::default();
        Ok(Some(Self {
            slide,
            place: [at[0], at[1], size[0], size[1]],
            pitch,
            features: engine.features(&image, max_features)?,
            mirrored: engine.features(&mirror(&image)?, max_features)?,
        }))
    }

    /// Whether both show some of the same tissue.
    pub fn overlaps(&self, other: &Crop) -> bool {
        let apart = |k: usize| {
            let (a, b) = (self, other);
            a.place[k] + a.place[k + 2] <= b.place[k] || b.place[k] + b.place[k + 2] <= a.place[k]
        };
        self.slide == other.slide && !apart(0) && !apart(1)
    }
}

/// The image seen from behind.
fn mirror(image: &GrayImage) -> Result<GrayImage, FeatureError> {
    let w = image.width();
    Ok(GrayImage::from_fn(w, image.height(), |x, y| {
        image.get(w - 1 - x, y)
    })?)
}

//! The one image type: grey, f32, row-major, integer coordinates at pixel centres.

use crate::SiftError;

/// Grey image in f32, nominal range 0..=1, row-major, without padding.
///
/// Integer coordinates are pixel centres: the first pixel is the unit square around (0, 0), x runs along a row, y runs down.
/// Every value is finite.
#[derive(Debug, Clone, PartialEq)]
pub struct GrayImage {
    width: usize,
    height: usize,
    data: Vec<f32>,
}

impl GrayImage {
    /// Takes `width * height` values, row by row.
    ///
    /// # Errors
    /// [`SiftError::EmptyImage`] for a size of zero, [`SiftError::DataLength`] when the length disagrees,
    /// [`SiftError::NotFinite`] for a NaN or infinite value.
    pub fn new(width: usize, height: usize, data: Vec<f32>) -> Result<Self, SiftError> {
        if width == 0 || height == 0 {
            return Err(SiftError::EmptyImage { width, height });
        }
        if width.checked_mul(height) != Some(data.len()) {
            return Err(SiftError::DataLength {
                width,
                height,
                found: data.len(),
            });
        }
        if let Some(i) = data.iter().position(|v| !v.is_finite()) {
            return Err(SiftError::NotFinite {
                x: i % width,
                y: i / width,
                value: data[i],
            });
        }
        Ok(Self {
            width,
            height,
            data,
        })
    }

    /// Evaluates `f(x, y)` at each pixel centre, row by row.
    ///
    /// # Errors
    /// As [`GrayImage::new`].
    pub fn from_fn(
        width: usize,
        height: usize,
        mut f: impl FnMut(usize, usize) -> f32,
    ) -> Result<Self, SiftError> {
        let mut data = Vec::with_capacity(width.saturating_mul(height));
        for y in 0..height {
            data.extend((0..width).map(|x| f(x, y)));
        }
        Self::new(width, height, data)
    }

    /// Number of columns, at least 1.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows, at least 1.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// All values, row by row; `data()[y * width() + x]` is the pixel at (x, y).
    #[must_use]
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// The value at column `x`, row `y`.
    ///
    /// # Panics
    /// When the pixel is outside the image.
    #[must_use]
    pub fn get(&self, x: usize, y: usize) -> f32 {
        assert!(
            x < self.width && y < self.height,
            "pixel ({x}, {y}) is outside {} x {}",
            self.width,
            self.height
        );
        self.data[y * self.width + x]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuses_what_is_not_an_image() {
        assert!(matches!(
            GrayImage::new(0, 3, vec![]),
            Err(SiftError::EmptyImage {
                width: 0,
                height: 3
            })
        ));
        assert!(matches!(
            GrayImage::new(2, 2, vec![0.0; 3]),
            Err(SiftError::DataLength { found: 3, .. })
        ));
        assert!(matches!(
            GrayImage::new(usize::MAX, 2, vec![0.0; 3]),
            Err(SiftError::DataLength { .. })
        ));
        let nan = GrayImage::from_fn(3, 2, |x, y| if (x, y) == (2, 1) { f32::NAN } else { 0.0 });
        assert!(matches!(nan, Err(SiftError::NotFinite { x: 2, y: 1, .. })));
    }

    #[test]
    fn x_runs_along_the_row() {
        let image = GrayImage::from_fn(3, 2, |x, y| (10 * y + x) as f32).unwrap();
        assert_eq!(image.data(), [0.0, 1.0, 2.0, 10.0, 11.0, 12.0]);
        assert_eq!(image.get(2, 1), 12.0);
    }
}

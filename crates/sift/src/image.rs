//! The one image type: grey, f32, row-major, integer coordinates at pixel centres.

use crate::SiftError;

/// Grey image in f32, nominal range 0..=1, row-major, without padding.
///
/// Integer coordinates are pixel centres: the first pixel is the unit square around (0, 0), x runs along a row, y runs down.
/// Every value is finite and at most [`GREATEST`](Self::GREATEST) in size, so that no sum of squares overflows later.
#[derive(Debug, Clone, PartialEq)]
pub struct GrayImage {
    width: usize,
    height: usize,
    data: Vec<f32>,
}

impl GrayImage {
    /// Greatest magnitude of a value: above any count of photons, and far enough from the greatest f32 for all that is computed.
    pub const GREATEST: f32 = 1e12;

    /// Takes `width * height` values, row by row.
    ///
    /// # Errors
    /// [`SiftError::EmptyImage`] for a size of zero, [`SiftError::DataLength`] when the length disagrees,
    /// [`SiftError::NotFinite`] for a NaN or infinite value, [`SiftError::TooGreat`] for one beyond [`GREATEST`](Self::GREATEST).
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
        let good = |v: &f32| v.abs() <= Self::GREATEST; // not of NaN
        if let Some(i) = data.iter().position(|v| !good(v)) {
            let (x, y, value) = (i % width, i / width, data[i]);
            return Err(if value.is_finite() {
                SiftError::TooGreat { x, y, value }
            } else {
                SiftError::NotFinite { x, y, value }
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
    /// As [`GrayImage::new`], and [`SiftError::TooLarge`] when there is no memory for the image.
    pub fn from_fn(
        width: usize,
        height: usize,
        mut f: impl FnMut(usize, usize) -> f32,
    ) -> Result<Self, SiftError> {
        let mut data = room(width, height)?;
        for y in 0..height {
            data.extend((0..width).map(|x| f(x, y)));
        }
        Self::new(width, height, data)
    }

    /// Copies rows that lie in a larger buffer: row y is `data[y * stride..][..width]`, each value through `value`. Lengths count
    /// values, not bytes. What follows a row is not read, and nothing need follow the last one.
    ///
    /// A window of a larger image is its rows from the window's first value on, with the stride of the whole:
    ///
    /// ```
    /// # use scopeservo_sift::GrayImage;
    /// let sensor: Vec<u16> = (0..640 * 480).map(|i| (i % 4096) as u16).collect(); // 12 bits
    /// let (x, y) = (100, 50);
    /// let window = GrayImage::from_rows(200, 80, 640, &sensor[y * 640 + x..], |v| f32::from(v) / 4095.0)?;
    /// assert_eq!(window.get(3, 2), f32::from(sensor[52 * 640 + 103]) / 4095.0);
    /// # Ok::<(), scopeservo_sift::SiftError>(())
    /// ```
    ///
    /// # Errors
    /// [`SiftError::EmptyImage`] for a size of zero, [`SiftError::Stride`] when a row is longer than the way to the next,
    /// [`SiftError::DataTooShort`] when the last row does not end within `data`, [`SiftError::NotFinite`] and
    /// [`SiftError::TooGreat`] for what `value` gives, [`SiftError::TooLarge`] when there is no memory for the image.
    pub fn from_rows<T: Copy>(
        width: usize,
        height: usize,
        stride: usize,
        data: &[T],
        mut value: impl FnMut(T) -> f32,
    ) -> Result<Self, SiftError> {
        if width == 0 || height == 0 {
            return Err(SiftError::EmptyImage { width, height });
        }
        if stride < width {
            return Err(SiftError::Stride { width, stride });
        }
        let needed = (height - 1)
            .checked_mul(stride)
            .and_then(|start| start.checked_add(width));
        if needed.is_none_or(|needed| needed > data.len()) {
            return Err(SiftError::DataTooShort {
                width,
                height,
                stride,
                found: data.len(),
            });
        }
        let mut pixels = room(width, height)?;
        for row in data.chunks(stride).take(height) {
            pixels.extend(row[..width].iter().map(|&v| value(v)));
        }
        Self::new(width, height, pixels)
    }

    /// An 8-bit image with rows `stride` bytes apart; 255 becomes 1. As [`from_rows`](Self::from_rows) otherwise.
    ///
    /// # Errors
    /// [`SiftError::EmptyImage`], [`SiftError::Stride`], [`SiftError::DataTooShort`] and [`SiftError::TooLarge`] as
    /// [`from_rows`](Self::from_rows).
    pub fn from_u8(
        width: usize,
        height: usize,
        stride: usize,
        data: &[u8],
    ) -> Result<Self, SiftError> {
        Self::from_rows(width, height, stride, data, |v| f32::from(v) / 255.0)
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

/// An empty vector with room for an image of this size.
fn room(width: usize, height: usize) -> Result<Vec<f32>, SiftError> {
    if width == 0 || height == 0 {
        return Err(SiftError::EmptyImage { width, height });
    }
    let mut data = Vec::new();
    data.try_reserve_exact(width.saturating_mul(height))
        .map_err(|_| SiftError::TooLarge { width, height })?;
    Ok(data)
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

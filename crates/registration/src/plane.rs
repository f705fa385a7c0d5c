//! An image that can be asked for its value anywhere: blurred, so that sampling between pixels changes little.

use scopeservo_features::GrayImage;
use scopeservo_geometry::Vec2;

/// How much wider the blur is whose result is taken away.
const BAND: f64 = 6.0;

/// An image made ready for comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane {
    width: usize,
    height: usize,
    data: Vec<f32>,
}

impl Plane {
    /// `image`, blurred by a Gaussian of `sigma_px`.
    pub fn new(image: &GrayImage, sigma_px: f64) -> Self {
        let (width, height) = (image.width(), image.height());
        let reach = (3.0 * sigma_px).ceil().max(1.0) as usize;
        let weight = |d: f64| (-0.5 * (d / sigma_px.max(1e-3)).powi(2)).exp();
        let taps: Vec<f64> = (0..=reach).map(|d| weight(d as f64)).collect();
        let sum = 2.0 * taps.iter().sum::<f64>() - taps[0];
        let taps: Vec<f32> = taps.iter().map(|t| (t / sum) as f32).collect();
        let data = image.data();
        let mut along = vec![0.0f32; width * height];
        for (out, row) in along.chunks_exact_mut(width).zip(data.chunks_exact(width)) {
            blur_line(&taps, width, |x| row[x], |x, v| out[x] = v);
        }
        // Down the columns, a row of sums at a time.
        let mut blurred = vec![0.0f32; width * height];
        for (y, out) in blurred.chunks_exact_mut(width).enumerate() {
            let mut add = |row: usize, tap: f32| {
                let row = &along[row * width..][..width];
                out.iter_mut().zip(row).for_each(|(o, v)| *o += tap * v);
            };
            add(y, taps[0]);
            for (d, &tap) in taps.iter().enumerate().skip(1) {
                add(y.saturating_sub(d), tap);
                add((y + d).min(height - 1), tap);
            }
        }
        Self {
            width,
            height,
            data: blurred,
        }
    }

    /// Without what is wider than [`BAND`] times the blur: shading and wide soft shadows.
    pub(crate) fn band(image: &GrayImage, sigma_px: f64) -> Self {
        let (mut fine, wide) = (
            Self::new(image, sigma_px),
            Self::new(image, BAND * sigma_px),
        );
        fine.data
            .iter_mut()
            .zip(&wide.data)
            .for_each(|(f, w)| *f -= w);
        fine
    }

    /// The same of every so many pixels along both axes, and blurred by as many.
    pub(crate) fn thinned(image: &GrayImage, every: usize) -> Self {
        let fine = Self::band(image, every as f64);
        let (width, height) = (image.width() / every, image.height() / every);
        let at = |i: usize| fine.data[(i / width) * every * fine.width + (i % width) * every];
        Self {
            width,
            height,
            data: (0..width * height).map(at).collect(),
        }
    }

    /// Of its values, row by row; `None` when they are not as many.
    pub(crate) fn from_values([width, height]: [usize; 2], data: Vec<f32>) -> Option<Self> {
        (data.len() == width * height).then_some(Self {
            width,
            height,
            data,
        })
    }

    /// Columns.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub(crate) fn height(&self) -> usize {
        self.height
    }

    /// The values, row by row.
    pub(crate) fn values(&self) -> &[f32] {
        &self.data
    }

    /// Its values, row by row.
    pub(crate) fn into_values(self) -> Vec<f32> {
        self.data
    }

    /// The value between pixels; `None` outside.
    pub fn at(&self, p: Vec2) -> Option<f64> {
        let inside = p[0] >= 0.0 && p[1] >= 0.0;
        let (x, y) = (p[0] as usize, p[1] as usize);
        if !inside || x + 1 >= self.width || y + 1 >= self.height {
            return None;
        }
        let (u, v) = (p[0] - x as f64, p[1] - y as f64);
        let k = y * self.width + x;
        let [a, b, c, d] =
            [k, k + 1, k + self.width, k + self.width + 1].map(|k| f64::from(self.data[k]));
        Some((1.0 - v) * ((1.0 - u) * a + u * b) + v * ((1.0 - u) * c + u * d))
    }
}

/// One line, mirrored at nothing: beyond an end its last value goes on.
fn blur_line(
    taps: &[f32],
    length: usize,
    value: impl Fn(usize) -> f32,
    mut put: impl FnMut(usize, f32),
) {
    for x in 0..length {
        let mut sum = taps[0] * value(x);
        for (d, tap) in taps.iter().enumerate().skip(1) {
            sum += tap * (value(x.saturating_sub(d)) + value((x + d).min(length - 1)));
        }
        put(x, sum);
    }
}

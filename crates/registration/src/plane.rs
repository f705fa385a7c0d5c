//! An image that can be asked for its value anywhere: blurred, so that sampling between pixels changes little.

use rayon::prelude::*;
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
        let lines = along.par_chunks_exact_mut(width);
        lines
            .zip(data.par_chunks_exact(width))
            .for_each_init(Vec::new, |padded, (out, row)| {
                blur_line(&taps, row, out, padded);
            });
        // Down the columns, a row of sums at a time.
        let mut blurred = vec![0.0f32; width * height];
        let lines = blurred.par_chunks_exact_mut(width).enumerate();
        lines.for_each(|(y, out)| {
            let mut add = |row: usize, tap: f32| {
                let row = &along[row * width..][..width];
                out.iter_mut().zip(row).for_each(|(o, v)| *o += tap * v);
            };
            add(y, taps[0]);
            for (d, &tap) in taps.iter().enumerate().skip(1) {
                add(y.saturating_sub(d), tap);
                add((y + d).min(height - 1), tap);
            }
        });
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

/// One line into another, a sum for each pixel, a distance at a time: beyond an end its last value goes on.
fn blur_line(taps: &[f32], line: &[f32], out: &mut [f32], padded: &mut Vec<f32>) {
    let (reach, length) = (taps.len() - 1, line.len());
    padded.clear();
    padded.resize(reach, line[0]);
    padded.extend_from_slice(line);
    padded.resize(length + 2 * reach, line[length - 1]);
    for (o, v) in out.iter_mut().zip(line) {
        *o = taps[0] * v;
    }
    for (d, tap) in taps.iter().enumerate().skip(1) {
        let (before, after) = (&padded[reach - d..], &padded[reach + d..]);
        for ((o, b), a) in out.iter_mut().zip(before).zip(after) {
            *o += tap * (b + a);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::SplitMix64;

    /// Pixel by pixel, to the last bit: also where the blur reaches farther than the image does.
    #[test]
    fn a_blur_is_the_sum_over_its_taps_along_both_axes() {
        let mut rng = SplitMix64::new(3);
        for (width, height, sigma_px) in [(37, 23, 1.0), (9, 40, 6.0), (1, 1, 2.0)] {
            let image = GrayImage::from_fn(width, height, |_, _| rng.uniform() as f32).unwrap();
            let reach = (3.0f64 * sigma_px).ceil() as usize;
            let weight = |d: usize| (-0.5 * (d as f64 / sigma_px).powi(2)).exp();
            let all = 2.0 * (0..=reach).map(weight).sum::<f64>() - 1.0;
            let tap = |d: usize| (weight(d) / all) as f32;
            let along = |x: usize, y: usize| {
                let value = |x: usize| image.get(x, y);
                let first = tap(0) * value(x);
                (1..=reach).fold(first, |sum, d| {
                    sum + tap(d) * (value(x.saturating_sub(d)) + value((x + d).min(width - 1)))
                })
            };
            let plane = Plane::new(&image, sigma_px);
            for (i, value) in plane.values().iter().enumerate() {
                let (x, y) = (i % width, i / width);
                let sum = (1..=reach).fold(tap(0) * along(x, y), |sum, d| {
                    let sum = sum + tap(d) * along(x, y.saturating_sub(d));
                    sum + tap(d) * along(x, (y + d).min(height - 1))
                });
                assert_eq!(
                    value.to_bits(),
                    sum.to_bits(),
                    "{x} {y} of {width} x {height}"
                );
            }
        }
    }
}

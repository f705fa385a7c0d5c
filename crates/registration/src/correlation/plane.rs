//! An image made ready to be correlated: thinned out, without noise and shading, and with the same contrast everywhere that it has any.

use scopeservo_features::GrayImage;
use scopeservo_geometry::{Affine2, Mat2, Vec2};

/// Whether a pixel counts: not where something is fixed to the camera.
pub type Counts<'a> = dyn Fn(Vec2) -> bool + Sync + 'a;

/// An image, and what of it counts.
#[derive(Clone, Copy)]
pub struct Picture<'a> {
    /// The image.
    pub image: &'a GrayImage,
    /// Which pixels count; `None` for all.
    pub counts: Option<&'a Counts<'a>>,
}

/// Half side of the square whose mean is taken for shading, twice in a row, samples.
const WIDE: usize = 5;
/// The same for the local contrast.
const LOCAL: usize = 10;
/// Contrast below this share of the mean one, in squares, is not made equal: what is nearly blank stays nearly blank.
const LEAST_CONTRAST: f32 = 0.25;
/// and below so many standard deviations of the noise.
const NOISE_SIGMAS: f32 = 2.0;
/// How much of the noise of a sample is left after the narrow blur: (70 / 256) along both axes.
const NOISE_LEFT: f32 = 70.0 / 256.0;
/// What a value is clipped to, in local standard deviations: an edge of something on top says no more than one of the specimen.
const CLIP: f32 = 2.5;

/// Band-passed, of equal local contrast; 0 where nothing counts.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plane {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Pixels of the image, along both axes, that make a sample.
    pub(super) every: usize,
    pub(super) values: Vec<f32>,
}

impl Plane {
    /// `None` for an image with fewer than 16 samples across, or nothing in it.
    pub(super) fn of(picture: &Picture<'_>, every: usize) -> Option<Self> {
        let (width, height) = (
            picture.image.width() / every,
            picture.image.height() / every,
        );
        if width < 16 || height < 16 {
            return None;
        }
        let mut plane = Self {
            width,
            height,
            every,
            values: reduced(picture, every, width, height),
        };
        let counts = plane.counts(picture);
        let noise = noise(&plane.values, width) * NOISE_LEFT;
        plane.without_shading(counts.as_deref());
        plane.evened(noise, counts.as_deref()).then_some(plane)
    }

    /// Sample from pixel of the image.
    pub(super) fn sample_from_pixel(&self) -> Affine2 {
        let f = self.every as f64;
        Affine2 {
            linear: Mat2::diagonal(1.0 / f, 1.0 / f),
            offset: [-(f - 1.0) / (2.0 * f); 2],
        }
    }

    /// Pixel of the image from sample.
    pub(super) fn pixel_from_sample(&self) -> Affine2 {
        let f = self.every as f64;
        Affine2 {
            linear: Mat2::diagonal(f, f),
            offset: [(f - 1.0) / 2.0; 2],
        }
    }

    /// 1 for each sample that counts, 0 for others; `None` where all do.
    fn counts(&self, picture: &Picture<'_>) -> Option<Vec<f32>> {
        let counts = picture.counts?;
        let pixel = self.pixel_from_sample();
        let all = (0..self.values.len()).map(|i| {
            let p = pixel.apply([(i % self.width) as f64, (i / self.width) as f64]);
            f32::from(u8::from(counts(p)))
        });
        Some(all.collect())
    }

    /// Takes away the mean around each sample, of what counts, and blurs a little.
    fn without_shading(&mut self, counts: Option<&[f32]>) {
        let (w, h) = (self.width, self.height);
        let mut mean = self.values.clone();
        match counts {
            None => smooth(&mut mean, w, h, WIDE),
            Some(counts) => {
                let mut share = counts.to_vec();
                multiply(&mut mean, counts);
                smooth(&mut mean, w, h, WIDE);
                smooth(&mut share, w, h, WIDE);
                let each = mean.iter_mut().zip(&share);
                each.for_each(|(m, s)| *m /= s.max(1e-6));
            }
        }
        let each = self.values.iter_mut().zip(&mean);
        each.for_each(|(v, m)| *v -= m);
        if let Some(counts) = counts {
            multiply(&mut self.values, counts);
        }
        blur(&mut self.values, w);
    }

    /// Divides by the local contrast. `false` when there is none at all.
    fn evened(&mut self, noise: f32, counts: Option<&[f32]>) -> bool {
        let mut energy: Vec<f32> = self.values.iter().map(|v| v * v).collect();
        let mean = energy.iter().sum::<f32>() / energy.len() as f32;
        smooth(&mut energy, self.width, self.height, LOCAL);
        let least = LEAST_CONTRAST * mean + (NOISE_SIGMAS * noise).powi(2);
        if least <= 1e-12 {
            return false;
        }
        for (v, e) in self.values.iter_mut().zip(&energy) {
            *v = (*v / (e + least).sqrt()).clamp(-CLIP, CLIP);
        }
        if let Some(counts) = counts {
            multiply(&mut self.values, counts);
        }
        true
    }

    /// The value between samples; 0 outside.
    pub(super) fn at(&self, [x, y]: Vec2) -> f32 {
        let inside = x >= 0.0 && y >= 0.0;
        let (column, row) = (x as usize, y as usize);
        if !inside || column + 1 >= self.width || row + 1 >= self.height {
            return 0.0;
        }
        let (u, v) = ((x - column as f64) as f32, (y - row as f64) as f32);
        let k = row * self.width + column;
        let [a, b] = [self.values[k], self.values[k + 1]];
        let [c, d] = [self.values[k + self.width], self.values[k + self.width + 1]];
        (1.0 - v) * (a + u * (b - a)) + v * (c + u * (d - c))
    }
}

/// The means of squares of pixels.
fn reduced(picture: &Picture<'_>, every: usize, width: usize, height: usize) -> Vec<f32> {
    let image = picture.image;
    let mut values = vec![0.0f32; width * height];
    for (y, out) in values.chunks_exact_mut(width).enumerate() {
        for row in image.data()[y * every * image.width()..]
            .chunks_exact(image.width())
            .take(every)
        {
            for (o, pixels) in out.iter_mut().zip(row.chunks_exact(every)) {
                *o += pixels.iter().sum::<f32>();
            }
        }
    }
    let share = 1.0 / (every * every) as f32;
    values.iter_mut().for_each(|v| *v *= share);
    values
}

fn multiply(values: &mut [f32], by: &[f32]) {
    values.iter_mut().zip(by).for_each(|(v, b)| *v *= b);
}

/// Standard deviation of the noise of samples, from the differences that no plane explains (Immerkaer, CVIU 1996), in the median.
fn noise(values: &[f32], width: usize) -> f32 {
    let rows: Vec<&[f32]> = values.chunks_exact(width).collect();
    let mut sizes: Vec<f32> = Vec::new();
    for three in rows.windows(3).step_by(3) {
        for x in (1..width - 1).step_by(3) {
            let along = |r: &[f32]| r[x - 1] - 2.0 * r[x] + r[x + 1];
            let both = along(three[0]) - 2.0 * along(three[1]) + along(three[2]);
            sizes.push(both.abs());
        }
    }
    let middle = sizes.len() / 2;
    let median = *sizes.select_nth_unstable_by(middle, f32::total_cmp).1;
    // The mask's own gain is 6, the median of a normal size 0.6745 sigma.
    median / (6.0 * 0.6745)
}

/// The binomial blur of five samples, along both axes: a sigma of one.
fn blur(values: &mut [f32], width: usize) {
    let height = values.len() / width;
    let mut line = vec![0.0f32; width];
    for row in values.chunks_exact_mut(width) {
        line.copy_from_slice(row);
        for (x, out) in row.iter_mut().enumerate() {
            let at = |d: usize, back: bool| match back {
                true => line[x.saturating_sub(d)],
                false => line[(x + d).min(width - 1)],
            };
            let near = at(1, true) + at(1, false);
            let far = at(2, true) + at(2, false);
            *out = (6.0 * line[x] + 4.0 * near + far) / 16.0;
        }
    }
    let along = values.to_vec();
    let row = |y: usize| &along[y * width..][..width];
    for (y, out) in values.chunks_exact_mut(width).enumerate() {
        let (a, b) = (row(y.saturating_sub(2)), row(y.saturating_sub(1)));
        let (d, e) = (row((y + 1).min(height - 1)), row((y + 2).min(height - 1)));
        let c = row(y);
        for x in 0..width {
            out[x] = (6.0 * c[x] + 4.0 * (b[x] + d[x]) + a[x] + e[x]) / 16.0;
        }
    }
}

/// The mean over a square of half side `reach`, as far as it lies in the plane, twice in a row.
pub(super) fn smooth(values: &mut [f32], width: usize, height: usize, reach: usize) {
    for _ in 0..2 {
        box_mean(values, width, height, reach);
    }
}

/// The mean over a square of half side `reach`, as far as it lies in the plane: running sums.
pub(super) fn box_mean(values: &mut [f32], width: usize, height: usize, reach: usize) {
    let mut line = vec![0.0f32; width];
    for row in values.chunks_exact_mut(width) {
        line.copy_from_slice(row);
        let mut sum: f32 = line[..reach.min(width)].iter().sum();
        for (x, out) in row.iter_mut().enumerate() {
            if x + reach < width {
                sum += line[x + reach];
            }
            if x > reach {
                sum -= line[x - reach - 1];
            }
            let count = (x + reach + 1).min(width) - x.saturating_sub(reach);
            *out = sum / count as f32;
        }
    }
    let along = values.to_vec();
    let row = |y: usize| &along[y * width..][..width];
    let mut sums = vec![0.0f32; width];
    for y in 0..reach.min(height) {
        sums.iter_mut().zip(row(y)).for_each(|(s, v)| *s += v);
    }
    for (y, out) in values.chunks_exact_mut(width).enumerate() {
        if y + reach < height {
            let next = row(y + reach);
            sums.iter_mut().zip(next).for_each(|(s, v)| *s += v);
        }
        if y > reach {
            let last = row(y - reach - 1);
            sums.iter_mut().zip(last).for_each(|(s, v)| *s -= v);
        }
        let count = (y + reach + 1).min(height) - y.saturating_sub(reach);
        let share = 1.0 / count as f32;
        out.iter_mut().zip(&sums).for_each(|(o, s)| *o = s * share);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::SplitMix64;

    #[test]
    fn a_mean_is_that_of_the_square_as_far_as_it_lies_in_the_plane() {
        let (w, h, reach) = (9, 7, 2);
        let mut rng = SplitMix64::new(1);
        let given: Vec<f32> = (0..w * h).map(|_| rng.uniform() as f32).collect();
        let mut means = given.clone();
        box_mean(&mut means, w, h, reach);
        for y in 0..h {
            for x in 0..w {
                let rows = y.saturating_sub(reach)..(y + reach + 1).min(h);
                let all: Vec<f32> = rows
                    .flat_map(|j| {
                        let columns = x.saturating_sub(reach)..(x + reach + 1).min(w);
                        columns.map(move |i| (i, j))
                    })
                    .map(|(i, j)| given[j * w + i])
                    .collect();
                let mean = all.iter().sum::<f32>() / all.len() as f32;
                assert!((means[y * w + x] - mean).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn the_noise_is_what_it_is() {
        let mut rng = SplitMix64::new(1);
        let values: Vec<f32> = (0..200 * 150)
            .map(|i| 0.01 * (i % 200) as f32 + 0.02 * rng.normal() as f32)
            .collect();
        assert!((noise(&values, 200) / 0.02 - 1.0).abs() < 0.05);
    }

    fn tissue(gain: f32, offset: f32) -> GrayImage {
        let mut rng = SplitMix64::new(7);
        let spots: Vec<[f64; 2]> = (0..400)
            .map(|_| [320.0 * rng.uniform(), 240.0 * rng.uniform()])
            .collect();
        let of = |x: usize, y: usize| {
            let near = |s: &[f64; 2]| {
                let d = (x as f64 - s[0]).powi(2) + (y as f64 - s[1]).powi(2);
                (-d / 18.0).exp()
            };
            spots.iter().map(near).sum::<f64>() as f32
        };
        GrayImage::from_fn(320, 240, |x, y| offset + gain * of(x, y)).unwrap()
    }

    #[test]
    fn gain_and_offset_change_nothing_and_what_does_not_count_is_nothing() {
        let plane = |image: &GrayImage, counts: Option<&super::Counts<'_>>| {
            Plane::of(&Picture { image, counts }, 2).unwrap()
        };
        let (one, other) = (tissue(0.2, 0.1), tissue(0.05, 0.6));
        let (a, b) = (plane(&one, None), plane(&other, None));
        let apart = |(x, y): (&f32, &f32)| (x - y).abs();
        let most = a
            .values
            .iter()
            .zip(&b.values)
            .map(apart)
            .fold(0.0, f32::max);
        assert!(most < 0.02, "{most}");
        let left = |p: Vec2| p[0] < 160.0;
        let masked = plane(&one, Some(&left));
        for (i, v) in masked.values.iter().enumerate() {
            match i % 160 {
                80.. => assert_eq!(*v, 0.0),
                // Far from the border all is as before, but for the contrast to which it is compared.
                20..60 => assert!((v - a.values[i]).abs() < 0.35, "{i}"),
                _ => {}
            }
        }
        let blank = GrayImage::from_fn(320, 240, |_, _| 0.5).unwrap();
        let picture = Picture {
            image: &blank,
            counts: None,
        };
        assert_eq!(Plane::of(&picture, 2), None);
    }
}

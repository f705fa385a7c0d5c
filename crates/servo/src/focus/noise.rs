//! The noise of a sensor from the frames at hand: photon transfer.

use super::levels::Plane;
use serde::{Deserialize, Serialize};

/// Side of the blocks that are looked at, pixels.
const BLOCK: usize = 16;
/// So many blocks, in order of their light, make one point of the photon transfer.
const POINTS: usize = 8;
/// Of each point the quietest quarter of the blocks tells: the others have structure. What a quartile of noise is of its mean.
const QUARTILE: f64 = 0.88;
/// Squares of the mask that sees noise and hardly any structure (J. Immerkaer, CVIU 64, 1996).
const MASK_GAIN: f64 = 36.0;

/// Variance of the luminance of a pixel: `read + gain * light`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Noise {
    /// Variance without light.
    read: f64,
    /// Variance per light.
    gain: f64,
}

impl Noise {
    /// What one image shows. Structure can only make it seem larger: of several images the one with the least is right.
    pub(crate) fn of(image: &Plane) -> Self {
        let mut blocks = blocks(image);
        blocks.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let size = blocks.len().div_ceil(POINTS).max(1);
        let points: Vec<[f64; 2]> = blocks.chunks_mut(size).map(point).collect();
        let [light, variance] = mean(&points);
        let spread: f64 = points.iter().map(|p| (p[0] - light).powi(2)).sum();
        let slope: f64 = points
            .iter()
            .map(|p| (p[0] - light) * (p[1] - variance))
            .sum();
        // Where all is of one light, or darker parts seem noisier, all of it is put to the light or to the read-out.
        let most = variance / light.max(f64::MIN_POSITIVE);
        let even = spread < (0.05 * light).powi(2) * points.len() as f64;
        let gain = if even { most } else { slope / spread };
        let gain = if gain.is_finite() {
            gain.clamp(0.0, most)
        } else {
            0.0
        };
        Self {
            read: (variance - gain * light).max(0.0),
            gain,
        }
    }

    /// The variance at a mean light.
    pub(crate) fn variance(&self, light: f64) -> f64 {
        self.read + self.gain * light
    }

    /// The quieter of the two at a light.
    pub(crate) fn least(self, other: Self, light: f64) -> Self {
        match other.variance(light) < self.variance(light) {
            true => other,
            false => self,
        }
    }
}

/// Mean light and variance of the noise in each block.
fn blocks(image: &Plane) -> Vec<[f64; 2]> {
    let (w, h) = (image.width, image.height);
    if w < 3 || h < 3 {
        return Vec::new();
    }
    let [across, down] = [w - 2, h - 2].map(|side| (side / BLOCK).max(1));
    let mut sums = vec![[0.0f64; 3]; across * down];
    for y in 0..h - 2 {
        let row = |k: usize| &image.data[(y + k) * w..(y + k + 1) * w];
        let (a, b, c) = (row(0), row(1), row(2));
        for x in 0..w - 2 {
            let corners = a[x] + a[x + 2] + c[x] + c[x + 2];
            let sides = a[x + 1] + c[x + 1] + b[x] + b[x + 2];
            let seen = f64::from(corners - 2.0 * sides + 4.0 * b[x + 1]);
            let block = (y * down / (h - 2)) * across + x * across / (w - 2);
            let sum = &mut sums[block];
            sum[0] += f64::from(b[x + 1]);
            sum[1] += seen * seen;
            sum[2] += 1.0;
        }
    }
    let of = |[light, square, count]: [f64; 3]| [light / count, square / count / MASK_GAIN];
    sums.into_iter().map(of).collect()
}

/// The light of some blocks and the variance of the quietest of them.
fn point(blocks: &mut [[f64; 2]]) -> [f64; 2] {
    let light = mean(blocks)[0];
    blocks.sort_by(|a, b| a[1].total_cmp(&b[1]));
    [light, blocks[(blocks.len() - 1) / 4][1] / QUARTILE]
}

fn mean(points: &[[f64; 2]]) -> [f64; 2] {
    let n = points.len().max(1) as f64;
    [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::SplitMix64;

    /// A slope from dark to bright with shot and read noise, and coarse structure on the right half.
    fn noisy(electrons: f64, read_e: f64, seed: u64) -> Plane {
        let mut rng = SplitMix64::new(seed);
        let value = |i: usize, rng: &mut SplitMix64| {
            let (x, y) = ((i % 320) as f64, (i / 320) as f64);
            let structure = match x > 160.0 {
                true => 0.1 * (0.2 * x).sin() * (0.17 * y).cos(),
                false => 0.0,
            };
            let light = 0.15 + 0.6 * x / 320.0 + structure;
            let sigma = (light * electrons + read_e * read_e).sqrt() / electrons;
            (light + sigma * rng.normal()) as f32
        };
        Plane {
            width: 320,
            height: 240,
            data: (0..320 * 240).map(|i| value(i, &mut rng)).collect(),
        }
    }

    #[test]
    fn gain_and_read_noise_come_out_of_one_image() {
        for (electrons, read_e) in [(5_000.0, 8.0), (20_000.0, 50.0), (80_000.0, 10.0)] {
            let noise = Noise::of(&noisy(electrons, read_e, 3));
            for light in [0.2, 0.45, 0.7] {
                let truth = (light * electrons + read_e * read_e) / (electrons * electrons);
                let off = noise.variance(light) / truth;
                assert!(
                    (off - 1.0).abs() < 0.12,
                    "{electrons} {read_e} {light}: {off}"
                );
            }
        }
    }

    #[test]
    fn a_black_and_a_tiny_image_have_none() {
        let black = Plane {
            width: 40,
            height: 30,
            data: vec![0.0; 1200],
        };
        assert_eq!(Noise::of(&black).variance(0.5), 0.0);
        let tiny = Plane {
            width: 2,
            height: 2,
            data: vec![0.5; 4],
        };
        assert_eq!(Noise::of(&tiny).variance(0.5), 0.0);
    }
}

//! The least |DoG| that counts as a feature, fitted to the image.
//!
//! Lowe's fixed threshold (IJCV 2004, section 4) is meant for images that fill 0..=1. A dim or washed-out image has the same
//! structures with less amplitude, so the threshold here is in units of the image's own spread, and at least a multiple of what
//! its noise gives in the same DoG layer. Multiplying an image by a constant or adding one changes nothing.

use crate::{GrayImage, Options};

/// Extrema must exceed the standard deviation of the noise in their DoG layer by this factor.
const NOISE_FACTOR: f32 = 3.0;

/// Where the 1-99 % range is no more than so many standard deviations of the noise (white noise alone gives 4.7), the image is flat but for a
/// few places,
const FLAT: f32 = 6.0;

/// and its spread is at least the full range divided by this: a few bright spots on black.
const FLAT_DIVISOR: f32 = 16.0;

/// Else the spots may be beads or a scale bar beside tissue, which has its own range; what they leave around themselves has less.
const RANGE_DIVISOR: f32 = 64.0;

/// Rounding in the blurs reaches about 2e-7 of the values; the threshold stays well above it.
const ROUNDING: f32 = 4e-6;

/// Samples from which percentiles are estimated.
const SAMPLES: usize = 1 << 14;

/// Threshold on |DoG| for any layer of any octave.
#[derive(Debug, Clone)]
pub(crate) struct Contrast {
    /// Without noise, the same in all layers.
    base: f32,
    /// Standard deviation of white noise per input pixel.
    noise: f32,
}

impl Contrast {
    /// `None` for an image without any structure above rounding.
    pub(crate) fn of(image: &GrayImage, options: &Options) -> Option<Self> {
        let data = image.data();
        let measured = || {
            let ((percentiles, range), noise) = rayon::join(
                || (percentile_range(data), range(data)),
                || noise_sigma(image),
            );
            // One extreme pixel, dead or hot, must not set the threshold for all others, nor a scale bar.
            let divisor = match percentiles > FLAT * noise {
                true => RANGE_DIVISOR,
                false => FLAT_DIVISOR,
            };
            let spread = percentiles.max(supported_range(image) / divisor);
            (range, Some((spread, noise)))
        };
        let ((low, high), adapted) = if options.adapt_contrast {
            measured()
        } else {
            (range(data), None)
        };
        let rounding = ROUNDING * high.abs().max(low.abs());
        if high - low <= rounding {
            return None;
        }
        let (spread, noise) = adapted.unwrap_or((1.0, 0.0));
        let threshold = options.contrast_threshold / options.intervals as f32;
        Some(Self {
            base: (threshold * spread).max(rounding),
            noise,
        })
    }

    /// The threshold in DoG layer `layer` of octave `octave`.
    pub(crate) fn threshold(&self, options: &Options, octave: i32, layer: usize) -> f32 {
        let scale = (octave as f32).exp2();
        let filter_variance = |s: usize| {
            let sigma = scale * options.sigma_at(s as f32);
            (sigma * sigma - options.assumed_blur * options.assumed_blur).max(0.01)
        };
        let gain = dog_noise_gain(filter_variance(layer), filter_variance(layer + 1));
        self.base.max(NOISE_FACTOR * gain * self.noise)
    }
}

/// Standard deviation of unit white noise after the difference of two Gaussians with variances `a` and `b` (in pixels squared):
/// the L2 norm of that difference, `sqrt((1/a + 1/b - 4/(a + b)) / (4 pi))`.
fn dog_noise_gain(a: f32, b: f32) -> f32 {
    ((1.0 / a + 1.0 / b - 4.0 / (a + b)).max(0.0) / (4.0 * std::f32::consts::PI)).sqrt()
}

/// Least and greatest value, of sixteen columns side by side: so the compiler can take vectors.
fn range(data: &[f32]) -> (f32, f32) {
    let (mut low, mut high) = ([f32::MAX; 16], [f32::MIN; 16]);
    for values in data.chunks(16) {
        for ((low, high), &v) in low.iter_mut().zip(&mut high).zip(values) {
            *low = if v < *low { v } else { *low };
            *high = if v > *high { v } else { *high };
        }
    }
    (
        low.into_iter().fold(f32::MAX, f32::min),
        high.into_iter().fold(f32::MIN, f32::max),
    )
}

/// The range of what at least two by two pixels reach: a single one reaches nothing.
fn supported_range(image: &GrayImage) -> f32 {
    let (w, data) = (image.width(), image.data());
    if w < 2 || image.height() < 2 {
        return 0.0;
    }
    let (mut low, mut high) = (f32::MAX, f32::MIN);
    for (above, below) in data.chunks_exact(w).zip(data.chunks_exact(w).skip(1)) {
        for (a, b) in above.windows(2).zip(below.windows(2)) {
            let (most, least) = (
                a[0].max(a[1]).max(b[0].max(b[1])),
                a[0].min(a[1]).min(b[0].min(b[1])),
            );
            low = low.min(most);
            high = high.max(least);
        }
    }
    (high - low).max(0.0)
}

/// 99th minus 1st percentile of a regular sample.
fn percentile_range(data: &[f32]) -> f32 {
    let mut sample: Vec<i32> = data
        .iter()
        .step_by(data.len().div_ceil(SAMPLES))
        .map(|v| ordered(*v))
        .collect();
    let last = sample.len() - 1;
    let rank = last / 100;
    let low = *sample.select_nth_unstable(rank).1;
    let high = *sample.select_nth_unstable(last - rank).1;
    value(high) - value(low)
}

/// A number that is to others as the value is to theirs: integers are compared at once.
fn ordered(value: f32) -> i32 {
    let bits = value.to_bits() as i32;
    bits ^ (bits >> 31 & i32::MAX)
}

/// The value of such a number.
fn value(ordered: i32) -> f32 {
    f32::from_bits((ordered ^ (ordered >> 31 & i32::MAX)) as u32)
}

/// Standard deviation of white noise: median absolute response of the mask `[1 -2 1] x [1 -2 1]`, which has gain 6 for noise and
/// next to none for anything that optics have blurred (Immerkaer, CVIU 1996; the median ignores the edges that remain).
#[must_use]
pub fn noise_sigma(image: &GrayImage) -> f32 {
    let (w, h) = (image.width(), image.height());
    if w < 3 || h < 3 {
        return 0.0;
    }
    let count = (w - 2) * (h - 2);
    let mut response: Vec<i32> = (0..count)
        .step_by(count.div_ceil(SAMPLES))
        .map(|i| {
            let (x, y) = (i % (w - 2), i / (w - 2));
            let second = |y: usize| {
                let row = &image.data()[y * w + x..][..3];
                row[0] - 2.0 * row[1] + row[2]
            };
            ordered((second(y) - 2.0 * second(y + 1) + second(y + 2)).abs())
        })
        .collect();
    let middle = response.len() / 2;
    value(*response.select_nth_unstable(middle).1) / (6.0 * 0.6745)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scale_space::oracle;

    /// Hash noise with mean 0 and variance 1 (sum of twelve uniforms).
    fn noise(i: usize) -> f32 {
        let mut state = (i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0xD1B5_4A32_D192_ED03;
        (0..12)
            .map(|_| {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (state >> 40) as f32 / (1_u64 << 24) as f32 - 0.5
            })
            .sum()
    }

    #[test]
    fn ordered_numbers_are_those_of_the_values() {
        let values = [f32::MIN, -2.5, -1e-40, -0.0, 0.0, 1e-40, 0.3, f32::MAX];
        assert!(values.map(ordered).is_sorted());
        assert_eq!(values.map(|v| value(ordered(v))), values);
    }

    #[test]
    fn noise_is_measured_under_structure() {
        let image = GrayImage::from_fn(200, 150, |x, y| {
            0.5 + 0.3 * (x as f32 * 0.2).sin() * (y as f32 * 0.15).cos() + 0.01 * noise(y * 200 + x)
        });
        let sigma = noise_sigma(&image.unwrap());
        assert!((0.0095..0.0115).contains(&sigma), "{sigma}");
    }

    #[test]
    fn predicted_noise_in_each_dog_layer_is_what_the_scale_space_has() {
        let options = Options::default();
        let image = GrayImage::from_fn(200, 200, |x, y| noise(y * 200 + x)).unwrap();
        let contrast = Contrast {
            base: 0.0,
            noise: 1.0,
        };
        for (octave, layers) in oracle::octaves(&image, &options, 3).iter().enumerate() {
            for layer in 0..3 {
                let (fine, coarse) = (&layers[layer].data, &layers[layer + 1].data);
                let sum_sq: f64 = fine.iter().zip(coarse).map(|(a, b)| (a - b).powi(2)).sum();
                let std = (sum_sq / fine.len() as f64).sqrt() as f32;
                let predicted =
                    contrast.threshold(&options, octave as i32 - 1, layer) / NOISE_FACTOR;
                assert!(
                    (0.7..1.3).contains(&(predicted / std)) || (octave, layer) == (0, 0),
                    "{octave} {layer}: {predicted} {std}",
                );
            }
        }
    }

    #[test]
    fn threshold_follows_gain_and_ignores_offset() {
        let options = Options::default();
        let render = |gain: f32, offset: f32| {
            let image = GrayImage::from_fn(64, 64, |x, y| {
                offset + gain * (x as f32 * 0.3).sin() * (y as f32 * 0.2).cos()
            });
            Contrast::of(&image.unwrap(), &options)
                .unwrap()
                .threshold(&options, 0, 1)
        };
        assert!((render(0.1, 0.4) / render(1.0, 0.0) - 0.1).abs() < 1e-3);
    }

    #[test]
    fn one_extreme_pixel_a_bead_or_a_scale_bar_sets_no_threshold() {
        let options = Options::default();
        let of = |extreme: &dyn Fn(usize, usize) -> Option<f32>| {
            let image = GrayImage::from_fn(200, 160, |x, y| {
                let tissue = 0.02 + 0.01 * (x as f32 * 0.3).sin() * (y as f32 * 0.2).cos();
                extreme(x, y).unwrap_or(tissue)
            });
            Contrast::of(&image.unwrap(), &options)
                .unwrap()
                .threshold(&options, 0, 1)
        };
        let clean = of(&|_, _| None);
        let hot = of(&|x, y| ((x, y) == (70, 33)).then_some(1.0));
        let dead = of(&|x, y| ((x, y) == (71, 90)).then_some(0.0));
        let bead = of(&|x, y| (x.abs_diff(100) + y.abs_diff(80) < 6).then_some(1.0));
        let bar = of(&|x, y| ((150..190).contains(&x) && (150..154).contains(&y)).then_some(1.0));
        for (name, with) in [("hot", hot), ("dead", dead), ("bead", bead), ("bar", bar)] {
            assert!(
                (0.9..1.1).contains(&(with / clean)),
                "{name}: {with} {clean}"
            );
        }
    }

    #[test]
    fn a_few_bright_spots_on_black_are_measured_by_themselves_and_not_by_a_hot_pixel() {
        let options = Options::default();
        let of = |hot: f32| {
            let image = GrayImage::from_fn(200, 160, |x, y| {
                let spot = |u: f32, v: f32| {
                    (-((x as f32 - u).powi(2) + (y as f32 - v).powi(2)) / 8.0).exp()
                };
                if (x, y) == (10, 10) {
                    hot
                } else {
                    0.1 * (spot(60.0, 50.0) + spot(120.0, 100.0))
                }
            });
            Contrast::of(&image.unwrap(), &options)
                .unwrap()
                .threshold(&options, 0, 1)
        };
        let clean = of(0.0);
        assert!(clean > 0.0);
        for hot in [0.2, 1.0, 3.0] {
            assert!(
                (of(hot) / clean - 1.0).abs() < 0.1,
                "{hot}: {} {clean}",
                of(hot)
            );
        }
    }

    #[test]
    fn a_constant_image_has_no_contrast() {
        for v in [0.0, 0.7, -3.0] {
            let image = GrayImage::new(20, 20, vec![v; 400]).unwrap();
            assert!(Contrast::of(&image, &Options::default()).is_none());
        }
    }
}
